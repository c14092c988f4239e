"""People who stand still: detectors with a background model lose them, the tracker does not."""

from pathlib import Path

import numpy as np
import pytest
from fusion_world import frame, make_view

from services.fusion.positions.anonymous import AnonymousLayer, AnonymousSettings

RATE = 10.0


@pytest.fixture
def layer(tmp_path: Path) -> AnonymousLayer:
    return AnonymousLayer(make_view(tmp_path))


def told(layer: AnonymousLayer) -> list[int]:
    found: list[int] = layer.tracks.ids[layer.told()].tolist()
    return found


def walk_and_stand(layer: AnonymousLayer, stop: float = 12.0) -> float:
    """One person walks east to (``stop``, 7) and stands there for four seconds; returns the time."""
    t = 100.0
    for number in range(80):
        t = 100.0 + number / RATE
        layer.observe(frame(t, [(min(stop - 4.0 + number / RATE, stop), 7.0)]))
    return t


def wait(layer: AnonymousLayer, t: float, seconds: float) -> float:
    for number in range(round(seconds * RATE)):
        layer.observe(frame(t + (number + 1) / RATE))
    return t + seconds


def test_who_stood_still_when_the_detector_lost_them_is_still_there_and_keeps_the_id(layer: AnonymousLayer) -> None:
    t = wait(layer, walk_and_stand(layer), 4.0)
    assert told(layer) == [1]
    assert layer.tracks.resting.tolist() == [True]
    t = wait(layer, t, 8.0)
    assert told(layer) == []
    for number in range(20):
        t += 1.0 / RATE
        layer.observe(frame(t, [(12.3 + number / RATE, 7.0)]))
    assert told(layer) == [1]
    assert layer.tracks.mean[0, 0] == pytest.approx(14.2, abs=0.3)


def test_belief_in_a_resting_person_falls_and_its_covariance_grows_slowly(layer: AnonymousLayer) -> None:
    t = walk_and_stand(layer)
    existence, spread = [], []
    for _ in range(10):
        t = wait(layer, t, 1.0)
        assert layer.tracks.mean[0, :2] == pytest.approx([12.0, 7.0], abs=0.1)
        existence.append(float(layer.tracks.existence[0]))
        spread.append(float(np.trace(layer.tracks.spread()[0])))
    assert (np.diff(existence) < 0.0).all()
    assert (np.diff(spread) > 0.0).all()
    assert spread[-1] < 0.2


def test_nobody_rests_for_ever(layer: AnonymousLayer) -> None:
    wait(layer, walk_and_stand(layer), layer.settings.rest + 1.0)
    assert len(layer.tracks.ids) == 0


def test_who_was_moving_when_lost_does_not_rest(layer: AnonymousLayer) -> None:
    for number in range(40):
        layer.observe(frame(100.0 + number / RATE, [(8.0 + number / RATE, 7.0)]))
    wait(layer, 103.9, layer.settings.coast + 0.2)
    assert len(layer.tracks.ids) == 0


def test_who_stands_at_the_border_of_the_view_does_not_rest(layer: AnonymousLayer) -> None:
    border = 22.0
    while layer.view.everywhere.depth_at(np.array([[border, 7.0]]))[0] > 0.2:
        border += 0.05
    t = walk_and_stand(layer, border)
    assert told(layer) == [1]
    wait(layer, t, layer.settings.coast + 0.2)
    assert len(layer.tracks.ids) == 0


def test_a_reflection_that_never_moved_does_not_rest(layer: AnonymousLayer) -> None:
    for number in range(40):
        layer.observe(frame(100.0 + number / RATE, [(12.0, 7.0)]))
    wait(layer, 103.9, layer.settings.coast + 0.2)
    assert len(layer.tracks.ids) == 0


def test_a_resting_track_does_not_take_a_passer_by(layer: AnonymousLayer) -> None:
    """Somebody else comes in, passes half a metre from the resting person, and is another person all the way."""
    t = walk_and_stand(layer)
    for number in range(70):
        t += 1.0 / RATE
        layer.observe(frame(t, [(8.0 + 0.13 * number, 7.5)]))
    assert layer.tracks.ids.tolist() == [1, 2]
    assert layer.tracks.mean[0, :2] == pytest.approx([12.0, 7.0], abs=0.1)
    assert layer.tracks.mean[1, 0] == pytest.approx(16.97, abs=0.2)


def test_the_place_a_person_left_is_not_taken_for_the_person(layer: AnonymousLayer) -> None:
    """The background learned them: on the floor they leave it sees a ghost for a while. Their id goes with them."""
    t = wait(layer, walk_and_stand(layer), 3.0)
    for number in range(60):
        t += 1.0 / RATE
        places = [(12.0 + 1.2 * (number + 1) / RATE, 7.0)] if number > 6 else []
        layer.observe(frame(t, [(12.0, 7.0), *places] if number < 30 else places))
    t = wait(layer, t, 0.3)
    assert told(layer) == [1]
    assert layer.tracks.mean[layer.tracks.ids == 1, 0] > 18.0


def test_ids_for_devices_that_no_camera_sees_are_never_those_of_tracks(layer: AnonymousLayer) -> None:
    first = layer.new_id()
    walk_and_stand(layer)
    assert told(layer) == [first + 1]
    assert layer.new_id() == first + 2


def test_settings_may_make_people_rest_for_minutes(tmp_path: Path) -> None:
    layer = AnonymousLayer(make_view(tmp_path), AnonymousSettings(rest_report=60.0, rest=300.0))
    t = wait(layer, walk_and_stand(layer), 55.0)
    assert told(layer) == [1]
    wait(layer, t, 180.0)
    assert layer.tracks.ids.tolist() == [1]
