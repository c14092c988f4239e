"""The rendered hall: people stand where geometry says, and nothing else changes."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from services.simulator.people import Snapshot
from services.simulator.seeds import generator
from services.simulator.video.rendering import HallRenderer, VideoParameters
from services.simulator.video.video_light import Light
from shared.site import CameraGeometry, Floor, Site, load_site

PERSONS = ("a", "b", "c")


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def still(hall: Site) -> HallRenderer:
    """A camera without noise and light change: what differs is people."""
    geometry = hall.cameras[0].geometry.build()
    return HallRenderer(
        hall.floor("ground"), geometry, PERSONS, seed=5, video=VideoParameters(noise=0.0, light_change=0.0)
    )


def standing(*places: tuple[float, float], heading: float = -1.57) -> Snapshot:
    n = len(places)
    return Snapshot(
        person=PERSONS[:n],
        index=np.arange(n),
        position=np.array(places, float).reshape(-1, 2),
        heading=np.full(n, heading),
        speed=np.zeros(n),
        walked=np.zeros(n),
    )


def silhouette(renderer: HallRenderer, people: Snapshot) -> np.ndarray:
    """Where the picture differs from the empty hall by more than a shadow does: a boolean (height, width)."""
    picture, empty = renderer.frame(people, 0.0, 0).astype(float), renderer.empty.astype(float)
    ratio = (picture.sum(axis=2) + 1) / (empty.sum(axis=2) + 1)
    hue = np.abs(picture / (picture.sum(axis=2, keepdims=True) + 1) - empty / (empty.sum(axis=2, keepdims=True) + 1))
    return (hue.sum(axis=2) > 0.06) | (ratio < 0.5) | (ratio > 1.1)


@pytest.mark.parametrize("place", [(7.0, 2.0), (10.0, 5.0), (12.5, 9.5), (2.5, 6.0), (17.0, 6.5)])
def test_a_person_stands_and_ends_where_projection_says(still: HallRenderer, place: tuple[float, float]) -> None:
    v, u = np.nonzero(silhouette(still, standing(place)))
    tall = still.height_of(0)
    foot, head = still.camera.to_image(np.array([[*place, 0.0], [*place, tall]]))
    upright = np.linalg.norm(foot - head)
    assert v.max() == pytest.approx(foot[1], abs=0.14 * upright)
    assert v.min() == pytest.approx(head[1], abs=0.12 * upright)
    assert u.mean() == pytest.approx((foot[0] + head[0]) / 2, abs=0.15 * upright)


def test_only_where_somebody_is_the_picture_changes(still: HallRenderer) -> None:
    people = standing((7.0, 2.0), (12.5, 9.5))
    changed = np.abs(still.frame(people, 0.0, 0).astype(int) - still.empty).max(axis=2) > 0
    allowed = np.zeros(changed.shape, bool)
    for x, y in people.position:
        around = [[x + dx, y + dy, z] for dx in (-0.7, 0.7) for dy in (-0.7, 0.7) for z in (0.0, 2.1)]
        u, v = still.camera.to_image(np.array(around)).T
        allowed[int(v.min()) : int(v.max()) + 1, int(u.min()) : int(u.max()) + 1] = True
    assert changed.any()
    assert not (changed & ~allowed).any()


def test_an_exhibit_hides_the_legs_of_who_stands_behind_it_and_not_of_who_stands_before(still: HallRenderer) -> None:
    table = np.array([10.0, 8.0])
    behind, before = silhouette(still, standing((10.0, 9.0))), silhouette(still, standing((10.0, 7.0)))
    foot_behind, foot_before = still.camera.to_image(np.array([[10.0, 9.0, 0.1], [10.0, 7.0, 0.1]]))
    assert still.camera.position[1] < table[1]
    assert np.nonzero(behind)[0].max() < foot_behind[1] - 5
    assert np.nonzero(before)[0].max() > foot_before[1] - 4


def test_the_nearer_of_two_people_covers_the_farther(still: HallRenderer) -> None:
    both = still.frame(standing((10.0, 4.0), (10.0, 3.6)), 0.0, 0)
    other = Snapshot(["b"], np.array([1]), np.array([[10.0, 3.6]]), np.array([-1.57]), np.zeros(1), np.zeros(1))
    chest = still.camera.to_image(np.array([[10.0, 3.6, 1.25]]))[0].round().astype(int)
    np.testing.assert_array_equal(both[chest[1], chest[0]], still.frame(other, 0.0, 0)[chest[1], chest[0]])


def test_legs_swing_while_walking(still: HallRenderer) -> None:
    def walking(walked: float) -> np.ndarray:
        people = Snapshot(["a"], np.array([0]), np.array([[10.0, 4.0]]), np.zeros(1), np.ones(1), np.array([walked]))
        return still.frame(people, 0.0, 0)

    assert np.abs(walking(0.0).astype(int) - walking(0.33)).max() > 40


def test_same_seed_and_frame_number_give_the_same_noise_and_another_number_other_noise(hall: Site) -> None:
    geometry = hall.cameras[0].geometry.build().scaled_to(320, 240)
    first, second = (HallRenderer(hall.floor("ground"), geometry, PERSONS, seed=5) for _ in range(2))
    people = standing((10.0, 5.0))
    frame = first.frame(people, 1.0, 7)
    assert frame.tobytes() == second.frame(people, 1.0, 7).tobytes()
    difference = frame.astype(int) - first.frame(people, 1.0, 8)
    assert difference.std() == pytest.approx(2.5 * np.sqrt(2), rel=0.15)


def test_light_changes_slowly(hall: Site) -> None:
    geometry = hall.cameras[0].geometry.build().scaled_to(320, 240)
    renderer = HallRenderer(hall.floor("ground"), geometry, PERSONS, seed=5, video=VideoParameters(noise=0.0))
    nobody = standing()
    level = np.array([renderer.frame(nobody, t, 0).mean() for t in np.arange(0.0, 70.0, 1.0)])
    assert 0.03 < np.ptp(level) / level.mean() < 0.12
    assert np.abs(np.diff(level)).max() / level.mean() < 0.012


def test_a_foreground_detector_finds_a_walker_in_the_noise(hall: Site) -> None:
    geometry = hall.cameras[0].geometry.build()
    renderer = HallRenderer(hall.floor("ground"), geometry, PERSONS, seed=5)
    background = cv2.createBackgroundSubtractorMOG2(history=200, varThreshold=24)
    for number in range(30):
        background.apply(renderer.frame(standing(), number / 15, number))
    place = np.array([9.0, 5.0])
    mask = background.apply(renderer.frame(standing((9.0, 5.0)), 2.0, 30), learningRate=0.0)
    mask = cv2.medianBlur((mask == 255).astype(np.uint8), 3)
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask)
    largest = stats[1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())]
    foot, head = geometry.to_image(np.array([[*place, 0.0], [*place, 1.65]]))
    assert count < 30
    assert largest[cv2.CC_STAT_AREA] > 0.4 * (foot[1] - head[1]) * 0.27 * (foot[1] - head[1])
    assert largest[cv2.CC_STAT_TOP] + largest[cv2.CC_STAT_HEIGHT] == pytest.approx(foot[1], abs=8)


def test_light_jumps_as_often_as_asked_whatever_was_asked_before(hall: Site) -> None:
    video = VideoParameters(noise=0.0, light_change=0.0, light_steps=6.0, light_step=0.2)
    first, second = (Light(video, generator(5, "light")) for _ in range(2))
    levels = [first.at(t) for t in np.arange(0.0, 600.0, 0.2)]
    assert np.count_nonzero(np.diff(levels)) == pytest.approx(60, abs=20)
    assert 0.1 < np.std(levels) < 0.3
    backwards = [second.at(t) for t in np.arange(0.0, 600.0, 0.2)[::-1]]
    assert backwards[::-1] == levels


def test_a_wall_within_the_floor_hides_who_stands_behind_it(hall: Site) -> None:
    floor = hall.floor("ground")
    floor = floor.model_copy(update={"obstacles": [], "walls": [*floor.walls, [(8.0, 6.0), (12.0, 6.0)]]})
    geometry = hall.cameras[0].geometry.build().scaled_to(320, 240)
    renderer = HallRenderer(floor, geometry, PERSONS, seed=5, video=VideoParameters(noise=0.0, light_change=0.0))
    empty = renderer.empty.astype(int)
    behind = np.abs(renderer.frame(standing((10.0, 6.6)), 0.0, 0).astype(int) - empty).max(axis=2) > 0
    before = np.abs(renderer.frame(standing((10.0, 5.0)), 0.0, 0).astype(int) - empty).max(axis=2) > 0
    assert behind.sum() < 0.1 * before.sum()


@pytest.mark.parametrize("place", [(3.0, 3.0), (5.5, 6.2), (9.0, 10.0)])
def test_seen_from_above_a_person_covers_the_floor_between_feet_and_head(place: tuple[float, float]) -> None:
    floor = Floor(id="ground", outline=[(0, 0), (11, 0), (11, 12), (0, 12)])
    camera = CameraGeometry.from_pose((480, 360), (5.5, 4.0, 10.0), (5.5, 6.0, 0.0), math.radians(76))
    video = VideoParameters(noise=0.0, light_change=0.0, shadows=0.0)
    renderer = HallRenderer(floor, camera, PERSONS, seed=5, video=video)
    difference = np.abs(renderer.frame(standing(place), 0.0, 0).astype(int) - renderer.empty).max(axis=2)
    v, u = np.nonzero(difference > 8)
    foot, head = camera.to_image(np.array([[*place, 0.0], [*place, renderer.height_of(0)]]))
    low, high = np.minimum(foot, head), np.maximum(foot, head)
    body = 0.35 * camera.focal[0] / 10.0
    assert low[0] - body < u.min() < u.max() < high[0] + body
    assert low[1] - body < v.min() < v.max() < high[1] + body
    assert difference[round((0.3 * foot + 0.7 * head)[1]), round((0.3 * foot + 0.7 * head)[0])] > 8
