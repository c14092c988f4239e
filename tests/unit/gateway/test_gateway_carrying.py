"""Hand or pocket, of a phone of which nobody has told."""

import numpy as np
import pytest
from turned_phone import held, hops_of

from services.gateway.reckoning.carrying import CarryingDetection
from services.gateway.reckoning.hops import HOP, RATE

T = np.arange(10 * HOP) / RATE


def in_pocket(pitch: float, swing: float, walking: bool = True, turning: float = 0.0) -> bool:
    """After ten seconds; ``swing`` degrees of nodding a stride, ``turning`` degrees a second."""
    attitude = held(np.radians(turning) * T, pitch + np.radians(swing) * np.sin(2 * np.pi * 0.9 * T))
    state, pocket = np.zeros(1, CarryingDetection.STATE), np.zeros(1, bool)
    for number, hop in enumerate(hops_of(attitude)):
        part = attitude[None, number * HOP : (number + 1) * HOP]
        pocket = CarryingDetection().advance(state, hop.rotation, part, np.array([walking]))
    return bool(pocket[0])


@pytest.mark.parametrize("pitch", [1.4, -1.4])
def test_a_phone_that_swings_on_its_edge_is_in_a_pocket(pitch: float) -> None:
    assert in_pocket(pitch, 20.0)


@pytest.mark.parametrize(("pitch", "swing", "turning"), [(0.0, 3.0, 0.0), (0.6, 8.0, 0.0), (0.3, 3.0, 90.0)])
def test_a_phone_one_looks_at_is_in_the_hand_even_if_it_bounces_or_turns(
    pitch: float, swing: float, turning: float
) -> None:
    assert not in_pocket(pitch, swing, turning=turning)


def test_a_phone_held_upright_and_calmly_is_in_the_hand() -> None:
    assert not in_pocket(1.4, 2.0)


def test_only_walking_tells() -> None:
    assert not in_pocket(1.4, 20.0, walking=False)
