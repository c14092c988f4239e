"""Anonymous tracks: births, misses and deaths at the frame rates real cameras have."""

from pathlib import Path

import numpy as np
import pytest
from fusion_world import World, frame, make_site, make_view
from msgspec.structs import replace

from services.fusion.area_view import AreaView
from services.fusion.positions.anonymous import AnonymousLayer


@pytest.fixture
def layer(tmp_path: Path) -> AnonymousLayer:
    return AnonymousLayer(make_view(tmp_path))


def confirmed(layer: AnonymousLayer) -> list[int]:
    found: list[int] = layer.tracks.ids[layer.tracks.confirmed].tolist()
    return found


@pytest.mark.parametrize("rate", [2.0, 5.0, 7.0, 15.0, 30.0])
def test_people_keep_their_ids_at_any_frame_rate(tmp_path: Path, rate: float) -> None:
    site = make_site(tmp_path)
    world = World(site, seed=3, people=4, seconds=20.0, rate=rate)
    layer = AnonymousLayer(AreaView.of(site, "hall"))
    errors, ids = [], set()
    for seen in world.frames():
        layer.begin_chunk()
        layer.observe(seen)
        if seen.t > world.t0 + 3.0:
            told = layer.tracks.mean[layer.tracks.confirmed, :2]
            apart = np.linalg.norm(world.places(seen.t)[:, None] - told[None], axis=2)
            errors.append(apart.min(axis=1))
            ids |= set(confirmed(layer))
    assert np.mean(np.array(errors) < 0.5) > 0.97
    assert len(ids) <= 6


def test_a_flickering_false_detection_never_becomes_a_person(layer: AnonymousLayer) -> None:
    rng = np.random.default_rng(0)
    for number in range(300):
        t = 100.0 + number / 15
        layer.observe(frame(t, rng.uniform([4, 3], [20, 11], (int(rng.integers(0, 2)), 2)), confidence=0.5))
        assert confirmed(layer) == []


def test_faint_detections_are_not_enough_for_a_birth_but_keep_a_track_alive(layer: AnonymousLayer) -> None:
    for number in range(30):
        layer.observe(frame(100.0 + number / 10, [(12.0, 7.0)], confidence=0.2))
    assert len(layer.tracks.ids) == 0
    for number in range(30, 60):
        layer.observe(frame(100.0 + number / 10, [(12.0, 7.0)], confidence=0.8))
    (track,) = confirmed(layer)
    for number in range(60, 120):
        layer.observe(frame(100.0 + number / 10, [(12.0, 7.0)], confidence=0.2))
    assert confirmed(layer) == [track]


def test_a_track_coasts_through_an_occlusion_and_keeps_its_id(layer: AnonymousLayer) -> None:
    for number in range(80):
        t = 100.0 + number / 10
        hidden = 40 <= number < 55
        layer.observe(frame(t, [] if hidden else [(6.0 + 0.1 * number, 7.0)]))
    assert confirmed(layer) == [1]


def test_who_is_hidden_is_expected_to_slow_down(layer: AnonymousLayer) -> None:
    """People who walk out of sight stop more often than they walk on for ever."""
    for number in range(40):
        layer.observe(frame(100.0 + number / 10, [(6.0 + 0.1 * number, 7.0)]))
    speed = layer.tracks.mean[0, 2]
    for number in range(40, 50):
        layer.observe(frame(100.0 + number / 10, []))
    assert speed == pytest.approx(1.0, abs=0.1)
    # The first frame is missed only once it has come.
    assert layer.tracks.mean[0, 2] == pytest.approx(speed * np.exp(-0.9 / layer.settings.slow_down), rel=1e-6)


@pytest.mark.parametrize("silence", [1.5, 5.0, 9.0])
def test_of_a_silence_only_so_much_is_missed_as_an_interval_may_last(layer: AnonymousLayer, silence: float) -> None:
    for number in range(30):
        layer.observe(frame(100.0 + number / 10, [(12.0, 7.0)]))
    layer.observe(frame(102.9 + silence, []))
    assert layer.tracks.missed.tolist() == pytest.approx([layer.settings.longest_interval])


@pytest.mark.parametrize("flat", [1.0 - 1e-10, float(np.nextafter(1.0, 0.0)), 1.0, float("nan")])
def test_a_covariance_that_is_a_line_is_counted_and_left_out(layer: AnonymousLayer, flat: float) -> None:
    layer.observe(replace(frame(100.0, [(12.0, 7.0)]), covariance=[(1.0, flat, 1.0)]))
    assert not len(layer.tracks.ids)
    assert layer.ignored == {"detection off the floor or without an extent": 1}


def test_what_cannot_be_reckoned_is_never_assigned(layer: AnonymousLayer) -> None:
    """A filter gone bad may lose its person, but not stop everybody's tracking."""
    for number in range(10):
        layer.observe(frame(100.0 + number / 10, [(8.0, 7.0), (14.0, 7.0)]))
    layer.tracks.covariance[0, :2, :2] = [[1.0, 9.0], [9.0, 1.0]]
    with np.errstate(invalid="ignore"):
        layer.observe(frame(101.0, [(8.0, 7.0), (14.0, 7.0)]))
    assert layer.tracks.hits[layer.tracks.ids == 2] == 11


def test_who_leaves_the_view_is_let_go_sooner_than_who_is_hidden(layer: AnonymousLayer) -> None:
    """One walks out of the picture, another vanishes in its middle."""
    depth = layer.view.everywhere
    for number in range(40):
        t = 100.0 + number / 10
        layer.observe(frame(t, [(12.0, 7.0), (20.0 + 0.1 * number, 7.0)]))
    assert len(confirmed(layer)) == 2
    assert depth.depth_at(np.array([[24.5, 7.0]]))[0] < 0.3
    for number in range(40, 50):
        layer.observe(frame(100.0 + number / 10, []))
    (left,) = layer.tracks.mean[layer.tracks.confirmed, 0]
    assert left == pytest.approx(12.0, abs=0.5)


def test_no_second_person_is_born_beside_a_track_from_a_split_blob(layer: AnonymousLayer) -> None:
    for number in range(60):
        places = [(12.0, 7.0)] if number < 20 else [(12.0, 7.0), (12.4, 7.2)]
        layer.observe(frame(100.0 + number / 10, places))
    assert len(layer.tracks.ids) == 1


def test_two_people_who_come_in_together_are_two(layer: AnonymousLayer) -> None:
    for number in range(40):
        layer.observe(frame(100.0 + number / 10, [(6.0 + 0.1 * number, 7.0), (6.0 + 0.1 * number, 8.2)]))
    assert len(confirmed(layer)) == 2


def test_two_cameras_confirm_no_faster_than_a_person_must_be_seen(layer: AnonymousLayer) -> None:
    for number in range(4):
        for camera in ("west", "east"):
            layer.observe(frame(100.0 + number / 15, [(12.0, 7.0)], camera))
    assert confirmed(layer) == []


def test_quality_tells_how_much_of_a_track_was_really_seen(layer: AnonymousLayer) -> None:
    rng = np.random.default_rng(1)
    for number in range(200):
        places = [(8.0, 7.0)] + ([(16.0, 7.0)] if rng.random() < 0.5 else [])
        layer.observe(frame(100.0 + number / 10, places))
    order = layer.tracks.mean[:, 0].argsort()
    good, poor = layer.tracks.quality[order][[0, -1]]
    assert good > 0.9 > 0.8 > poor


def test_after_a_long_silence_nobody_is_taken_for_who_stood_there_before(layer: AnonymousLayer) -> None:
    for number in range(30):
        layer.observe(frame(100.0 + number / 10, [(12.0, 7.0)]))
    for number in range(30):
        layer.observe(frame(3700.0 + number / 10, [(12.0, 7.0)]))
    assert confirmed(layer) == [2]


@pytest.mark.parametrize("step", [2.5, 5.0, 9.5])
def test_a_clock_set_back_leaves_no_track_behind_that_the_person_walked_away_from(
    layer: AnonymousLayer, step: float
) -> None:
    for number in range(200):
        t = 100.0 + number / 10 - (step if number >= 100 else 0.0)
        place = (12.0 + 4.0 * np.sin(number / 15.0), 7.0)
        layer.observe(frame(t, [place]))
        if number > 30 and not 100 <= number < 110:
            found = layer.tracks.mean[layer.tracks.confirmed, :2]
            assert len(found) == 1
            assert np.hypot(*(found[0] - place)) < 0.4
    assert layer.t == pytest.approx(119.9 - step)


def test_a_late_frame_of_another_camera_is_no_clock_set_back(layer: AnonymousLayer) -> None:
    for number in range(60):
        layer.observe(frame(100.0 + number / 10, [(8.0, 7.0)]))
        layer.observe(frame(99.5 + number / 10, [(8.0, 7.0)], "east"))
    assert confirmed(layer) == [1]
