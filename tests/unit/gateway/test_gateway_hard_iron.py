"""The phone's own iron: told from the Earth's field by turning, and its doubt until then; and the bounce of steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.bounce import bounce
from services.gateway.reckoning.hard_iron import HardIron
from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.reckoning.recent import RECENT, remember
from services.gateway.steps.detector import Steps

EARTH = np.array([0.0, 30.0, -38.0])
IRON = np.array([-9.0, -7.0, 0.0])


def hops_of_a_turning_phone(heading: np.ndarray, pitch: float = 0.0, iron: np.ndarray = IRON) -> list[Hops]:
    """Of one phone that is turned to ``heading`` (n,) rad counter-clockwise, its top raised by ``pitch``."""
    attitude = Rotation.from_euler("z", heading[:, None]) * Rotation.from_euler("x", pitch)
    rate = np.vstack([(attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE, np.zeros(3)])
    rate = np.vstack([np.zeros(3), rate[:-1]])
    acceleration, field = attitude.inv().apply([0.0, 0.0, 9.81]), attitude.inv().apply(EARTH) + iron
    return [
        Hops(
            np.array([begin / RATE]),
            np.array([HOP]),
            np.array([begin == 0]),
            *(values[None, begin : begin + HOP] for values in (acceleration, rate, field)),
        )
        for begin in range(0, len(heading), HOP)
    ]


def there_and_back(seconds: int = 60) -> np.ndarray:
    """Straight, then a quarter turn every ten seconds."""
    t = np.arange(seconds * HOP) / RATE
    return np.interp(t, [9, 10, 19, 20, 29, 30, 39, 40], np.pi / 2 * np.array([0, 1, 1, 2, 2, 3, 3, 4]))


@pytest.mark.parametrize("pitch", [0.0, 0.6])
def test_corners_tell_the_iron_but_for_what_is_upright_and_turns_no_compass(pitch: float) -> None:
    iron = HardIron()
    state = np.zeros(1, iron.STATE)
    for hop in hops_of_a_turning_phone(there_and_back(), pitch):
        cleaned = iron.advance(state, hop, hop.rotation)
    upright = np.array([0.0, np.sin(pitch), np.cos(pitch)])
    for wrong in (iron.iron(state)[0] - IRON, cleaned.field[0, 0] - (hop.field[0, 0] - IRON)):
        assert np.linalg.norm(wrong - upright * (wrong @ upright)) < 1.5


def test_who_walks_straight_learns_nothing_and_says_so() -> None:
    iron = HardIron()
    state = np.zeros(1, iron.STATE)
    for hop in hops_of_a_turning_phone(np.zeros(30 * HOP)):
        iron.advance(state, hop, hop.rotation)
    assert np.abs(iron.iron(state)).max() < 0.1
    straight = iron.heading_variance(state)[0]
    for hop in hops_of_a_turning_phone(there_and_back())[1:]:
        iron.advance(state, hop, hop.rotation)
    assert straight == pytest.approx((HardIron.SIGMA / np.hypot(*(EARTH + IRON)[:2])) ** 2, rel=0.1)
    assert iron.heading_variance(state)[0] < 0.15 * straight


def test_a_phone_without_iron_keeps_its_field() -> None:
    iron = HardIron()
    state = np.zeros(1, iron.STATE)
    for hop in hops_of_a_turning_phone(there_and_back(), iron=np.zeros(3)):
        assert iron.advance(state, hop, hop.rotation).field == pytest.approx(hop.field, abs=0.1)


def test_the_iron_is_kept_over_a_hole() -> None:
    iron = HardIron()
    state = np.zeros(1, iron.STATE)
    for hop in hops_of_a_turning_phone(there_and_back()):
        iron.advance(state, hop, hop.rotation)
    before = iron.iron(state)
    first = hops_of_a_turning_phone(np.full(HOP, 1.0))[0]
    cleaned = iron.advance(state, first, first.rotation)
    assert iron.iron(state)[0, :2] == pytest.approx(before[0, :2], abs=2.0)
    assert np.abs(cleaned.field[..., :2] - (first.field - IRON)[..., :2]).max() < 3.0


def test_missing_and_impossible_fields_teach_nothing() -> None:
    iron = HardIron()
    state = np.zeros(1, iron.STATE)
    for value in (np.nan, 500.0):
        for hop in hops_of_a_turning_phone(there_and_back()):
            blind = replace(hop, field=np.full_like(hop.field, value))
            assert np.array_equal(iron.advance(state, blind, hop.rotation).field, blind.field, equal_nan=True)
    assert np.isfinite(iron.heading_variance(state)).all()


def test_phones_do_not_disturb_each_other() -> None:
    iron = HardIron()
    one, two = hops_of_a_turning_phone(there_and_back()), hops_of_a_turning_phone(np.zeros(60 * HOP))
    both, alone = np.zeros(2, iron.STATE), np.zeros(1, iron.STATE)
    for a, b in zip(one, two, strict=True):
        joined = Hops(*(np.concatenate([getattr(a, n), getattr(b, n)]) for n in Hops.__dataclass_fields__))
        iron.advance(both, joined, joined.rotation)
        iron.advance(alone, a, a.rotation)
    assert iron.iron(both)[0] == pytest.approx(iron.iron(alone)[0])


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
