"""Rest, walking, and the short acts that are neither (Fig. 3.6 of the thesis)."""

import numpy as np
import pytest

from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.reckoning.walking_detection import WalkingDetection


def since(norm: np.ndarray, count: int = HOP) -> np.ndarray:
    """When walking began, told after each second of ``norm`` (n,), NaN while there is none."""
    state, told = np.zeros(1, WalkingDetection.STATE), []
    for begin in range(0, len(norm), HOP):
        acceleration = np.zeros((1, HOP, 3))
        acceleration[0, :, 2] = norm[begin : begin + HOP]
        hop = Hops(
            np.array([begin / RATE]), np.array([count]), np.zeros(1, bool), acceleration, acceleration, acceleration
        )
        told.append(WalkingDetection().advance(state, hop)[0])
    return np.array(told)


def bounce(seconds: float, amplitude: float = 2.0, frequency: float = 1.8) -> np.ndarray:
    t = np.arange(int(seconds * RATE)) / RATE
    return 9.81 + amplitude * np.sin(2 * np.pi * frequency * t)


REST = np.full(3 * HOP, 9.81)


def test_two_seconds_confirm_a_walk_and_release_the_first() -> None:
    told = since(np.concatenate([REST, bounce(10.0), REST]))
    assert np.isnan(told[:4]).all()
    np.testing.assert_array_equal(told[4:13], 3.0)
    assert np.isnan(told[13:]).all()


def test_a_second_of_handling_is_no_walk() -> None:
    assert np.isnan(since(np.concatenate([REST, bounce(1.0, 6.0), REST]))).all()


@pytest.mark.parametrize(("amplitude", "walks"), [(0.7, False), (0.9, True)])
def test_the_threshold_is_eight_tenths_at_a_bin_centre(amplitude: float, walks: bool) -> None:
    assert np.isfinite(since(bounce(4.0, amplitude, 2.0))[-1]) == walks


@pytest.mark.parametrize("frequency", [0.0, 8.0, 12.0])
def test_neither_gravity_nor_shaking_is_walking(frequency: float) -> None:
    assert np.isnan(since(bounce(6.0, 3.0, frequency))).all()


def test_a_second_with_a_hole_ends_the_run() -> None:
    assert np.isnan(since(bounce(6.0), count=30)).all()
