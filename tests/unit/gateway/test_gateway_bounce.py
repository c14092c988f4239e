"""How much a phone bounces: only what has the rhythm of steps counts."""

import numpy as np
import pytest

from services.gateway.reckoning.bounce import bounce
from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.reckoning.recent import RECENT, remember
from services.gateway.steps.detector import Steps


@pytest.mark.parametrize("cadence", [1.5, 1.85, 2.2])
def test_bounce_is_the_peak_to_peak_at_the_rhythm_of_steps(cadence: float) -> None:
    state = np.zeros(1, RECENT)
    for second in range(5):
        t = second + np.arange(HOP) / RATE
        up = 9.81 + 4.0 * np.cos(2.0 * np.pi * cadence * t) + 3.0 * np.cos(2.0 * np.pi * 10.0 * t)
        acceleration = np.stack([np.zeros(HOP), np.zeros(HOP), up], axis=1)[None]
        none = np.zeros((1, HOP, 3))
        hop = Hops(np.array([float(second)]), np.array([HOP]), np.zeros(1, bool), acceleration, none, none)
        recent = remember(state, hop, none, np.zeros((1, HOP, 3, 3)))
    steps = Steps(np.array([0]), np.array([3.2]), np.array([True]), np.array([1.0 / cadence]))
    assert bounce(recent, steps)[0] == pytest.approx(8.0, rel=0.1)


def test_a_phone_at_rest_does_not_bounce() -> None:
    state = np.zeros(1, RECENT)
    acceleration = np.tile([0.0, 0.0, 9.81], (1, HOP, 1))
    none = np.zeros((1, HOP, 3))
    hop = Hops(np.zeros(1), np.array([HOP]), np.ones(1, bool), acceleration, none, none)
    recent = remember(state, hop, none, np.zeros((1, HOP, 3, 3)))
    steps = Steps(np.array([0]), np.array([0.1]), np.array([False]), np.array([0.0]))
    assert bounce(recent, steps)[0] == pytest.approx(0.0, abs=1e-4)
