"""Corners are told once, when they have been turned, with time, size and side."""

import numpy as np
import pytest
from turned_phone import held, hops_of

from services.gateway.reckoning.hops import HOP, RATE
from services.gateway.reckoning.turns import TurnDetection

START = 1000.0


def turns(
    compass: np.ndarray, walking: bool = True, pitch: float = 0.4, roll: float = 0.0
) -> list[tuple[float, float]]:
    """Times since the beginning, s, and angles, degrees, of the turns of a phone that sways with its walker."""
    t = np.arange(len(compass)) / RATE
    attitude = held(compass + 0.1 * np.sin(2 * np.pi * 0.93 * t), pitch, roll)
    state, told = np.zeros(1, TurnDetection.STATE), []
    for number, hop in enumerate(hops_of(attitude)):
        part = attitude[None, number * HOP : (number + 1) * HOP]
        found = TurnDetection().advance(state, hop, part, np.array([walking]))
        told += [(t - START, np.degrees(angle)) for t, angle in zip(found.t, found.angle, strict=True)]
    return told


def ramp(*legs: tuple[float, float]) -> np.ndarray:
    """Compass headings, rad: each leg (degrees clockwise at the end, seconds) is reached evenly."""
    parts, before = [], 0.0
    for end, seconds in legs:
        parts.append(np.linspace(before, np.radians(end), int(seconds * RATE), endpoint=False))
        before = np.radians(end)
    return np.concatenate(parts)


@pytest.mark.parametrize("roll", [0.0, 1.5])
@pytest.mark.parametrize("pitch", [0.0, 0.7, -1.5])
@pytest.mark.parametrize(("clockwise", "left"), [(90.0, -90.0), (-90.0, 90.0), (45.0, -45.0), (175.0, -175.0)])
def test_a_corner_is_told_once_with_its_side(clockwise: float, left: float, pitch: float, roll: float) -> None:
    ((t, angle),) = turns(ramp((0, 6), (clockwise, 1.5), (clockwise, 6.5)), pitch=pitch, roll=roll)
    assert angle == pytest.approx(left, abs=8.0)
    assert t == pytest.approx(6.75, abs=0.5)


def test_two_corners_are_two() -> None:
    angles = [angle for _, angle in turns(ramp((0, 6), (90, 1), (90, 6), (0, 1), (0, 6)))]
    assert angles == pytest.approx([-90.0, 90.0], abs=8.0)


def test_a_slight_bend_is_no_corner() -> None:
    assert turns(ramp((0, 6), (20, 1), (20, 6))) == []


def test_a_drift_of_the_gyroscope_is_no_corner() -> None:
    assert turns(ramp((120, 60))) == []


def test_turning_the_whole_way_round_leads_on() -> None:
    assert turns(ramp((0, 6), (360, 4), (360, 6))) == []


def test_who_turns_while_standing_turns_no_corner() -> None:
    assert turns(ramp((0, 6), (90, 1), (90, 7)), walking=False) == []
