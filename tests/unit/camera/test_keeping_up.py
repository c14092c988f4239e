"""A camera that throws most pictures away says so, and is well again when it keeps up."""

from __future__ import annotations

import pytest

from services.camera.keeping_up import KeepingUp


def watched(
    keeping_up: KeepingUp, begin: float, seconds: float, rate: float, left_out_each: int, before: int = 0
) -> int:
    """Work on pictures at ``rate`` 1/s for so long, leaving out so many with each; return how many were left out."""
    for number in range(1, int(seconds * rate) + 1):
        keeping_up.take(begin + number / rate, before + number * left_out_each)
    return before + int(seconds * rate) * left_out_each


def test_most_pictures_left_out_and_too_few_worked_on_is_trouble_until_it_keeps_up() -> None:
    camera = KeepingUp()
    lost = watched(camera, 0.0, 15.0, 4.2, 8)
    assert not camera.doubt, "a busy moment is no trouble"
    lost = watched(camera, 15.0, 20.0, 4.2, 8, lost)
    assert "fewer than 5 pictures a second" in camera.doubt
    lost = watched(camera, 35.0, 35.0, 5.5, 8, lost)
    assert camera.doubt, "on the edge it does not come and go"
    watched(camera, 70.0, 35.0, 10.0, 0, lost)
    assert not camera.doubt


@pytest.mark.parametrize(("rate", "left_out_each"), [(4.0, 0), (1.0, 0), (12.0, 3)])
def test_slow_cameras_and_fast_ones_that_are_thinned_are_well(rate: float, left_out_each: int) -> None:
    camera = KeepingUp()
    watched(camera, 0.0, 60.0, rate, left_out_each)
    assert not camera.doubt


def test_time_without_pictures_is_not_taken_for_slowness() -> None:
    camera = KeepingUp()
    lost = watched(camera, 0.0, 35.0, 4.0, 8)
    camera.reset()
    assert not camera.doubt
    watched(camera, 300.0, 15.0, 4.0, 8, lost)
    assert not camera.doubt
