"""The phone-to-walking offset of [self-calibrating-rss-thesis §3.5], on waves that are known and on the twin's gait."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from benchmarks.gait_walks import Walk, replay, twin_walk
from benchmarks.offset_signs import POINTING_AHEAD, error_modes, turn
from services.gateway.reckoning.hops import RATE
from services.gateway.reckoning.offset import ERROR_SIGMA, Offset, Ratio, Sign, horizontal, window_offsets
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE
from services.gateway.reckoning.turned_hand_heading import TurnedHandHeading
from services.gateway.steps.detector import Steps


def waves(
    offset: float, seconds: float = 4.0, sway: float = 0.6, frequency: float = 1.7, start: float = 0.0
) -> tuple[np.ndarray, ...]:
    """Return what a phone turned to the left by ``offset`` sees along its forward direction and to its right."""
    t = start + np.arange(int(seconds * RATE)) / RATE
    forward, left = np.sin(2.0 * np.pi * frequency * t), sway * np.sin(np.pi * frequency * t + 0.9)
    along = np.cos(offset) * forward + np.sin(offset) * left
    right = np.sin(offset) * forward - np.cos(offset) * left
    return along[None], right[None]


def walks(offsets: list[float], metres: float = 60.0) -> list[Walk]:
    ahead = twin_walk(3, [(metres, 0.0)], "hand", habits=POINTING_AHEAD)
    return [turn(ahead, float(np.radians(offset))) for offset in offsets]


@pytest.mark.parametrize("degrees", [-40.0, -30.0, -15.0, 15.0, 30.0, 40.0])
def test_an_offset_to_either_side_is_found_with_its_sign(degrees: float) -> None:
    found = np.degrees(window_offsets(*waves(np.radians(degrees))))
    assert found[0] == pytest.approx(degrees, abs=2.0)


@pytest.mark.parametrize("degrees", [-70.0, 55.0, 70.0])
def test_no_offset_is_beyond_45_degrees(degrees: float) -> None:
    assert np.degrees(np.abs(window_offsets(*waves(np.radians(degrees)))))[0] == pytest.approx(45.0)


def test_the_ratio_of_the_peaks_is_exact_where_each_axis_share_of_its_own_total_is_not() -> None:
    wave = waves(np.radians(15.0))
    common, per_axis = (np.degrees(window_offsets(*wave, ratio=ratio))[0] for ratio in ("common", "per_axis"))
    assert abs(common - 15.0) < 1.5 < abs(per_axis - 15.0)


def test_a_step_frequency_between_the_bins_of_a_window_is_found() -> None:
    for frequency in (1.45, 1.62, 1.87, 2.13):
        found = np.degrees(window_offsets(*waves(np.radians(20.0), frequency=frequency)))
        assert found[0] == pytest.approx(20.0, abs=3.0)


def test_sway_turns_the_sign_while_braking_but_not_that_of_the_steps_harmonic() -> None:
    generator = np.random.default_rng(0)
    right: dict[str, list[bool]] = {sign: [] for sign in get_args(Sign)}
    for _ in range(200):
        start, frequency = float(generator.uniform(0.0, 2.0)), float(generator.uniform(1.5, 2.1))
        along, beside = waves(np.radians(10.0), sway=0.9, frequency=frequency, start=start)
        for sign in right:
            right[sign].append(bool(window_offsets(along, beside, sign=sign)[0] > 0.0))
    assert np.mean(right["harmonic"]) > 0.97
    assert np.mean(right["braking"]) < 0.9


def test_acceleration_is_taken_along_where_the_phone_points_and_to_its_right() -> None:
    # The phone lies flat, its top to the east: x points south.
    attitude = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    along, right = horizontal(np.array([[[3.0, 2.0, 9.8]]]), attitude[None, None])
    assert (along[0, 0], right[0, 0]) == pytest.approx((2.0, 3.0))


@pytest.mark.parametrize("ratio", get_args(Ratio))
def test_a_walk_tells_offsets_of_both_signs_and_grows_sure_of_them(ratio: Ratio) -> None:
    method = Offset(ratio)
    group = walks([-30.0, -15.0, 15.0, 30.0])
    state = np.zeros(len(group), method.STATE)
    doubts = []
    for recent, steps in replay(group):
        found = method.advance(state, recent, steps)
        last = [np.flatnonzero(steps.phone == row)[-1:] for row in range(len(group))]
        rows = np.concatenate(last)
        if len(rows) == len(group):
            doubts.append(found.wrong_sign_probability[rows])
            offset, variance = found.offset[rows], found.variance[rows]
    assert np.sign(offset).tolist() == [-1.0, -1.0, 1.0, 1.0]
    assert np.degrees(offset) == pytest.approx([-30.0, -15.0, 15.0, 30.0], abs=3.0 if ratio == "common" else 9.0)
    assert doubts[0].tolist() == [0.5] * 4
    assert (doubts[-1] < 0.05).all()
    assert (variance >= ERROR_SIGMA**2).all()


def test_nothing_is_known_of_a_phone_that_has_not_walked_for_four_seconds() -> None:
    method = Offset()
    state = np.zeros(1, method.STATE)
    recent, _ = next(iter(replay(walks([20.0]))))
    found = method.advance(
        state, recent, Steps(np.zeros(1, np.int64), np.array([0.8]), np.array([True]), np.array([0.5]))
    )
    assert (found.offset[0], found.variance[0], found.wrong_sign_probability[0]) == (0.0, UNKNOWN_VARIANCE, 0.5)


def test_a_new_grip_is_learnt() -> None:
    method = Offset(memory=10.0)
    state = np.zeros(1, method.STATE)
    for degrees in (-25.0, 25.0):
        for recent, steps in replay(walks([degrees])):
            found = method.advance(state, recent, steps)
            if len(found.offset):
                offset = found.offset[-1]
        assert np.degrees(offset) == pytest.approx(degrees, abs=4.0)


def test_a_turned_phone_leads_along_the_walk_and_offers_the_other_sign() -> None:
    group = walks([-25.0, 0.0, 25.0])
    method = TurnedHandHeading(least=np.radians(10.0))
    state = np.zeros(len(group), method.STATE)
    for recent, steps in replay(group):
        found = method.advance(state, recent, steps)
        rows = [np.flatnonzero(steps.phone == row)[-1:] for row in range(3)]
        if all(len(row) for row in rows):
            last = np.concatenate(rows)
            off = np.array([found.heading[i] - group[k].heading_at(steps.t[i : i + 1])[0] for k, i in enumerate(last)])
            apart = found.heading[last] - found.other[last]
            doubt = found.other_probability[last]
    assert np.degrees(np.angle(np.exp(1j * off))) == pytest.approx([0.0, 0.0, 0.0], abs=8.0)
    assert np.degrees(np.angle(np.exp(1j * apart))) == pytest.approx([-50.0, 0.0, 50.0], abs=6.0)
    assert doubt[1] == 0.0 < min(doubt[0], doubt[2])


def test_many_phones_at_once_are_told_the_same_as_each_alone() -> None:
    group = walks([-20.0, 5.0, 30.0], metres=25.0)
    method = Offset()
    together = np.zeros(len(group), method.STATE)
    for recent, steps in replay(group):
        method.advance(together, recent, steps)
    for row, walk in enumerate(group):
        alone = np.zeros(1, method.STATE)
        for recent, steps in replay([walk]):
            method.advance(alone, recent, steps)
        for name in method.STATE.names or ():
            assert alone[name][0] == pytest.approx(together[name][row])


def test_the_errors_of_a_method_split_into_a_right_and_a_wrong_mode() -> None:
    errors = np.radians([0.0, 2.0, -2.0, -30.0])
    modes = error_modes(errors, np.radians(15.0))
    assert modes["right_share"] == 0.75
    assert modes["right_mean_deg"] == pytest.approx(0.0)
    assert modes["wrong_mean_deg"] == pytest.approx(-30.0)
