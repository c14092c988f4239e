"""The cameras of the twin: who is found, hidden, faded or lost in another, and how errors hang together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from services.simulator.cameras.detections import DetectionModel, DetectionParameters
from services.simulator.cameras.fading import FITTED
from services.simulator.people import Movement
from shared.messages import DetectionFrame, covariances, positions
from shared.site import Camera, Floor, Source
from shared.site.site_file import Obstacle, PoseGeometry

Array = NDArray[np.float64]

FLOOR = Floor(id="ground", outline=[(0, 0), (20, 0), (20, 60), (0, 60)])
SOURCE = Source(url="http://camera.invalid/")
OBLIQUE = Camera(
    id="oblique",
    area="hall",
    source=SOURCE,
    geometry=PoseGeometry(
        kind="pose", image_size=(960, 720), position=(10, -3, 6), look_at=(10, 8, 0), horizontal_fov=70
    ),
)
STEEP = OBLIQUE.model_copy(
    update={
        "id": "steep",
        "geometry": PoseGeometry(
            kind="pose", image_size=(960, 720), position=(10, 8, 10), look_at=(10, 9, 0), horizontal_fov=75
        ),
    }
)
CLEAN = DetectionParameters(
    detection_probability=0.999,
    half_distance=500,
    learning_rate=0,
    merge_distance=0,
    merge_spread=0,
    split_rate=0,
    clutter=0,
    clutter_episodes=0,
    foot_noise=0,
    floor_noise=0,
    foot_bias=0,
)
"""A camera without errors, to which tests add one."""


class Crowd:
    """People who are at ``path(t)`` (n, p, 2); NaN where they are not present."""

    floors = ("ground",)

    def __init__(self, count: int, path: Callable[[Array], Array], floor: int = 0) -> None:
        self.persons = [f"person-{k}" for k in range(count)]
        self._path, self._floor = path, floor

    def movement(self, times: Array, persons: Sequence[int] | NDArray[np.int64] | None = None) -> Movement:
        position = np.array(self._path(np.asarray(times)[:, None]), float)
        present = np.isfinite(position[..., 0])
        nothing = np.zeros(present.shape)
        floor = np.where(present, self._floor, -1).astype(np.int16)
        return Movement(position, nothing, nothing, nothing, floor, present)

    def instants(self, after: float, until: float) -> Array:
        return np.zeros(0)


def standing(*places: tuple[float, float]) -> Crowd:
    """People who stay where they are (a camera that learns no background does not mind)."""
    there = np.array(places)
    return Crowd(len(places), lambda t: there + 0.0 * t[..., None])


def pacing(x: Array, y: float, speed: float = 1.0) -> Crowd:
    """People who walk to and fro along x, 1 m to each side of their place."""

    def path(t: Array) -> Array:
        swing = 2.0 / math.pi * np.arcsin(np.sin(0.5 * math.pi * speed * t + np.arange(len(x))))
        return np.stack([x + swing, np.full(swing.shape, y)], axis=-1)

    return Crowd(len(x), path)


def seen(
    parameters: DetectionParameters,
    crowd: Crowd,
    seconds: float,
    camera: Camera = OBLIQUE,
    fps: float = 10.0,
    seed: int = 3,
) -> list[DetectionFrame]:
    return DetectionModel(camera, FLOOR, parameters, fps, seed).frames(crowd, 0.0, seconds)


def count(frames: Sequence[DetectionFrame]) -> Array:
    return np.array([len(frame.x) for frame in frames])


def test_a_clean_camera_finds_everybody_where_they_are() -> None:
    crowd = pacing(np.array([5.0, 10.0, 15.0]), 9.0)
    frames = seen(CLEAN, crowd, 20.0)
    assert count(frames).mean() > 2.95
    for frame in frames:
        truth = crowd.movement(np.array([frame.t])).position[0]
        nearest = np.linalg.norm(positions(frame)[:, None] - truth, axis=2).min(axis=1)
        assert nearest.max(initial=0.0) < 1e-6


def test_empty_frames_are_there_and_numbers_go_on_from_block_to_block() -> None:
    nobody = Crowd(1, lambda t: np.full((len(t), 1, 2), np.nan))
    model = DetectionModel(OBLIQUE, FLOOR, DetectionParameters(), 7.0, 1)
    frames = [*model.frames(nobody, 0.0, 5.0), *model.frames(nobody, 5.0, 10.0), *model.frames(nobody, 10.0, 12.5)]
    assert [frame.seq for frame in frames] == list(range(88))
    np.testing.assert_allclose([frame.t for frame in frames], np.arange(88) / 7.0)
    assert (count(frames) == 0).sum() > 60
    assert {(frame.camera, frame.floor) for frame in frames} == {("oblique", "ground")}


@pytest.mark.parametrize("fps", [10.0, 2.5, 7.0])
def test_same_seed_same_detections_however_they_are_asked_for_and_another_seed_others(fps: float) -> None:
    crowd = pacing(np.array([5.0, 10.0, 15.0]), 9.0)
    whole = seen(DetectionParameters(), crowd, 15.0, fps=fps)
    model = DetectionModel(OBLIQUE, FLOOR, DetectionParameters(), fps, 3)
    parts = [frame for k in range(3) for frame in model.frames(crowd, 5.0 * k, 5.0 * k + 5.0)]
    assert parts == whole
    assert seen(DetectionParameters(), crowd, 15.0, fps=fps, seed=4) != whole


def test_who_is_not_present_or_on_another_floor_is_unseen() -> None:
    upstairs = Crowd(1, lambda t: np.broadcast_to([10.0, 9.0], (len(t), 1, 2)), floor=1)
    upstairs.floors = ("ground", "first")  # type: ignore[assignment]
    assert count(seen(CLEAN, upstairs, 5.0)).sum() == 0


def test_detection_falls_with_distance_as_the_parameters_say() -> None:
    parameters = CLEAN.model_copy(
        update={"detection_probability": 0.9, "half_distance": 25.0, "distance_width": 5.0, "miss_time": 0.2}
    )
    for y in (6.0, 20.0, 27.0):
        distance = math.hypot(y + 3.0, 6.0)
        logistic = [1.0 / (1.0 + math.exp(-(25.0 - d) / 5.0)) for d in (distance, 0.0)]
        found = count(seen(parameters, pacing(np.array([6.0, 10.0, 14.0]), y), 150.0)).mean() / 3.0
        assert found == pytest.approx(0.9 * logistic[0] / logistic[1], abs=0.05)


def test_misses_come_in_episodes() -> None:
    parameters = CLEAN.model_copy(update={"detection_probability": 0.8, "miss_time": 1.0, "miss_lasting": 0.9})
    lasting = count(seen(parameters, pacing(np.array([10.0]), 9.0), 300.0)).astype(float)
    white = count(seen(parameters.model_copy(update={"miss_lasting": 0.0}), pacing(np.array([10.0]), 9.0), 300.0))
    assert lasting.mean() == pytest.approx(0.8, abs=0.06)
    assert white.mean() == pytest.approx(0.8, abs=0.03)
    assert np.corrcoef(lasting[:-1], lasting[1:])[0, 1] > 0.35
    assert abs(np.corrcoef(white[:-1], white[1:])[0, 1]) < 0.06


def test_who_stands_behind_somebody_is_hidden_and_comes_out_again() -> None:
    # Seen from (10, -3) at 6 m, the second is right behind the first, the third beside them.
    frames = seen(CLEAN, standing((10.0, 14.0), (10.0, 14.55), (12.0, 14.55)), 10.0)
    ys = np.concatenate([positions(frame) for frame in frames])
    assert np.isclose(ys, [10.0, 14.55], atol=0.01).all(axis=1).mean() < 0.1
    assert np.isclose(ys, [12.0, 14.55], atol=0.01).all(axis=1).sum() > 95
    apart = seen(CLEAN, standing((10.0, 14.0), (10.0, 19.0)), 10.0)
    assert count(apart).mean() > 1.9


def test_seen_from_above_nobody_is_hidden_by_a_neighbour() -> None:
    assert count(seen(CLEAN, standing((10.0, 9.0), (10.0, 9.55)), 10.0, STEEP)).mean() > 1.9


def test_an_obstacle_hides_who_stands_close_behind_it_and_a_low_one_does_not() -> None:
    box = Obstacle(id="box", polygon=[(8.0, 12.0), (12.0, 12.0), (12.0, 13.0), (8.0, 13.0)])
    floor = FLOOR.model_copy(update={"obstacles": [box]})
    behind = standing((10.0, 13.4))

    def share(height: float) -> float:
        parameters = CLEAN.model_copy(update={"obstacle_height": height})
        return float(count(DetectionModel(OBLIQUE, floor, parameters, 10.0, 1).frames(behind, 0.0, 10.0)).mean())

    assert share(2.2) == 0.0
    assert share(0.3) > 0.95


def test_a_wall_between_hides_and_the_glass_front_before_the_camera_does_not() -> None:
    front: list[tuple[float, float]] = [(0, 0), (20, 0)]
    inner: list[tuple[float, float]] = [(6, 10), (14, 10)]
    behind = standing((10.0, 10.8))
    for walls, expected in (([front], 1.0), ([front, inner], 0.0)):
        floor = FLOOR.model_copy(update={"walls": walls})
        found = count(DetectionModel(OBLIQUE, floor, CLEAN, 10.0, 1).frames(behind, 0.0, 10.0)).mean()
        assert found == pytest.approx(expected, abs=0.05)


def test_half_in_the_picture_is_found_less_and_feet_outside_never() -> None:
    geometry = OBLIQUE.geometry.build()
    edge = float(geometry.to_ground(np.array([[0.0, 360.0]]))[0, 0])
    y = float(geometry.to_ground(np.array([[0.0, 360.0]]))[0, 1])
    inside, outside = (count(seen(CLEAN, standing((edge + dx, y)), 10.0)).mean() for dx in (0.6, -0.1))
    assert inside > 0.95
    assert outside == 0.0


def test_feet_outside_the_area_of_interest_are_dropped() -> None:
    left = OBLIQUE.model_copy(update={"area_of_interest": [(0, 0), (480, 0), (480, 720), (0, 720)]})
    crowd = standing((8.0, 9.0), (12.0, 9.0))
    frames = seen(CLEAN, crowd, 5.0, left)
    assert {round(x) for frame in frames for x in frame.x} == {8}


@pytest.mark.parametrize("rate", [0.02, 0.1])
def test_a_still_person_fades_at_the_pace_of_the_learning_rate_and_leaves_a_ghost(rate: float) -> None:
    start, stay = 1.0 / rate, 2.5 / rate
    end = start + stay + 1.0 / rate

    def path(t: Array) -> Array:
        x = np.where(t < start, 10.0 - (start - t), np.where(t < start + stay, 10.0, 10.0 + (t - start - stay)))
        return np.stack([np.where((x > 4.0) & (x < 16.0), x, np.nan), np.full(t.shape, 9.0)], axis=-1)

    parameters = CLEAN.model_copy(update={"learning_rate": rate, "miss_time": 0.1})
    found = np.zeros(0)
    for seed in range(6):
        frames = seen(parameters, Crowd(1, path), end, seed=seed)
        at_place = [bool((np.linalg.norm(positions(frame) - [10.0, 9.0], axis=1) < 0.3).any()) for frame in frames]
        found = np.array(at_place, float) / 6 + (found if found.size else 0.0)
    t = np.arange(len(found)) / 10.0 - start
    half = FITTED.fade_at + FITTED.fade_delay / (1.0 + rate * FITTED.fidget_time)
    half_time = -math.log(1.0 - half) / rate
    assert found[(t > 0.5) & (t < 0.6 * half_time)].mean() > 0.9
    assert found[(t > 1.6 * half_time) & (t < stay)].mean() < 0.3
    faded = int(np.argmax((found < 0.5) & (t > 0.6)))
    assert t[faded] == pytest.approx(half_time, rel=0.25, abs=1.0)
    ghost_time = math.log((1.0 - math.exp(-2.5)) / FITTED.ghost_at) / rate
    after = t - stay
    assert found[(after > 1.5) & (after < 0.5 * ghost_time + 1.0)].mean() > 0.6
    assert found[after > 2.2 * ghost_time + 1.0].mean() < 0.1


def test_who_keeps_moving_neither_fades_nor_leaves_ghosts() -> None:
    parameters = CLEAN.model_copy(update={"learning_rate": 0.3})
    assert count(seen(parameters, pacing(np.array([10.0]), 9.0), 60.0)).mean() == pytest.approx(1.0, abs=0.02)


def test_people_close_in_the_picture_become_one_detection_between_them() -> None:
    parameters = CLEAN.model_copy(update={"merge_distance": 0.6})
    near = seen(parameters, standing((10.0, 9.0), (10.2, 9.1)), 20.0)
    assert count(near).mean() == pytest.approx(1.0, abs=0.02)
    x = np.concatenate([positions(frame) for frame in near])[:, 0]
    assert 10.01 < np.median(x) < 10.19
    assert count(seen(parameters, standing((10.0, 9.0), (11.0, 9.1)), 20.0)).mean() > 1.95


def test_at_the_border_of_merging_people_merge_for_a_while_and_part_again() -> None:
    parameters = CLEAN.model_copy(update={"merge_distance": 0.75, "merge_spread": 0.2, "merge_time": 1.5})
    merged = count(seen(parameters, standing((10.0, 9.0), (10.36, 9.0)), 300.0)) < 2
    assert 0.15 < merged.mean() < 0.85
    changes = np.count_nonzero(np.diff(merged.astype(int)))
    assert 20 < changes < 0.5 * 2 * merged.mean() * (1 - merged.mean()) * len(merged)


def test_a_row_of_people_does_not_become_one_blob() -> None:
    parameters = CLEAN.model_copy(update={"merge_distance": 1.2})
    row = standing(*((8.0 + 0.4 * k, 9.0) for k in range(8)))
    assert 3.0 <= count(seen(parameters, row, 5.0)).mean() <= 6.0


def test_people_fall_into_two_as_often_and_as_long_as_asked() -> None:
    parameters = CLEAN.model_copy(update={"split_rate": 6.0, "split_time": 1.0})
    split = count(seen(parameters, pacing(np.array([10.0]), 9.0), 900.0)) == 2
    begins = np.count_nonzero(np.diff(split.astype(int)) == 1)
    assert begins == pytest.approx(6.0 * 15 / 1.1, rel=0.3)
    assert split.mean() == pytest.approx(0.1 / 1.1, rel=0.4)


def test_errors_grow_with_distance_and_last() -> None:
    parameters = CLEAN.model_copy(update={"foot_noise": 0.05, "noise_time": 1.0, "noise_lasting": 0.8})
    spreads = []
    for y in (6.0, 25.0):
        frames = seen(parameters, standing((10.0, y)), 200.0)
        error = np.array([frame.y[0] - y for frame in frames if frame.x])
        spreads.append(error.std())
        assert np.corrcoef(error[:-1], error[1:])[0, 1] == pytest.approx(0.8 * math.exp(-0.1), abs=0.1)
        claimed = np.array([covariances(frame)[0, 1, 1] for frame in frames if frame.x])
        assert error.std() == pytest.approx(math.sqrt(claimed.mean() - 0.01), rel=0.3)
    assert spreads[1] > 2.0 * spreads[0]


def test_feet_are_seen_too_near_by_the_bias() -> None:
    parameters = CLEAN.model_copy(update={"foot_bias": 0.1})
    frames = seen(parameters, standing((10.0, 9.0)), 5.0)
    assert np.mean([frame.y[0] for frame in frames if frame.x]) == pytest.approx(8.9, abs=0.01)


def test_clutter_flickers_at_its_rate_on_the_floor_and_comes_back_where_it_was() -> None:
    nobody = Crowd(1, lambda t: np.full((len(t), 1, 2), np.nan))
    frames = seen(CLEAN.model_copy(update={"clutter": 0.3}), nobody, 300.0)
    assert count(frames).mean() == pytest.approx(0.3, abs=0.03)
    places = np.concatenate([positions(frame) for frame in frames])
    assert ((places > -0.2) & (places < [20.2, 60.2])).all()
    lasting = CLEAN.model_copy(update={"clutter_places": 2, "clutter_episodes": 10.0, "clutter_time": 2.0})
    frames = seen(lasting, nobody, 600.0)
    assert count(frames).mean() == pytest.approx(10 / 60 * 2.0 * 0.8, rel=0.35)
    places = np.concatenate([positions(frame) for frame in frames])
    centres = places[[0, int(np.argmax(np.linalg.norm(places - places[0], axis=1)))]]
    assert (np.linalg.norm(places[:, None] - centres, axis=2).min(axis=1) < 1.2).all()


def test_confidence_falls_with_what_is_hidden() -> None:
    low = standing((10.0, 14.0), (10.0, 17.0))
    frames = seen(CLEAN, low, 20.0)
    front, behind = (
        np.mean([c for f in frames for y, c in zip(f.y, f.confidence, strict=True) if abs(y - at) < 1.4])
        for at in (14.0, 17.0)
    )
    assert behind < front - 0.05


def test_boxes_hold_the_body() -> None:
    for camera in (OBLIQUE, STEEP):
        frames = seen(CLEAN, standing((9.0, 10.0)), 2.0, camera)
        left, top, width, height = frames[-1].box[0]
        for u, v in camera.geometry.build().to_image(np.array([[9.0, 10.0, 0.02], [9.0, 10.0, 1.5]])):
            assert left <= u <= left + width
            assert top <= v <= top + height


def test_nonsense_is_refused_with_the_field_named() -> None:
    with pytest.raises(ValidationError, match="clutter"):
        DetectionParameters(clutter=-1.0)
    with pytest.raises(ValidationError, match="detection_probability"):
        DetectionParameters(detection_probability=1.5)
    with pytest.raises(ValueError, match="frames_per_s"):
        DetectionModel(OBLIQUE, FLOOR, CLEAN, 0.0, 1)
