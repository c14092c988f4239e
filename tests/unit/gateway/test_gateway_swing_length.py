"""Step lengths from how briskly a thigh swings, Eq. 3.3 of the dissertation."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.gait_walks import Walk, replay, swinging_thigh
from services.gateway.reckoning.swing_length import SwingLength, swing_range


def walks(count: int, **options: float) -> list[Walk]:
    return [swinging_thigh(np.random.default_rng(number), 60.0, **options) for number in range(count)]


def lengths(group: list[Walk], calibrated: float = 20.0) -> list[np.ndarray]:
    """Return (k, 2) times and lengths of each walk's steps; calibrated by what was walked in the first seconds."""
    method = SwingLength()
    state = np.zeros(len(group), method.STATE)
    rows = []
    for hop, (recent, steps) in enumerate(replay(group)):
        found = method.advance(state, recent, steps)
        rows.append(np.column_stack([steps.phone, steps.t, found]))
        if hop + 1 == calibrated:
            method.calibrate(state, np.array([walk.walked[int(hop * 50 + 35)] - 1.4 for walk in group]))
    table = np.concatenate(rows)
    return [table[table[:, 0] == row, 1:] for row in range(len(group))]


def test_the_range_is_of_the_norm_of_the_angular_rate() -> None:
    rate = np.array([[[0.0, 0.0, 1.0], [3.0, 4.0, 0.0], [0.0, 2.0, 0.0]]])
    assert swing_range(rate) == pytest.approx([4.0])


def test_twenty_seconds_of_known_distance_give_the_length_of_steps() -> None:
    group = walks(6)
    for walk, table in zip(group, lengths(group), strict=True):
        later = table[table[:, 0] > 25.0]
        true = walk.lengths(later[:, 0])[1:]
        assert np.sum(later[1:, 1]) == pytest.approx(np.sum(true), rel=0.05)


def test_nothing_is_told_before_the_calibration() -> None:
    group = walks(1)
    table = lengths(group)[0]
    assert np.isnan(table[table[:, 0] < 19.0, 1]).all()
    assert np.isfinite(table[table[:, 0] > 21.0, 1]).all()


def test_who_swings_harder_is_told_to_step_further() -> None:
    method = SwingLength()
    group = [walks(1, swing=swing)[0] for swing in (16.0, 22.0, 28.0)]
    state = np.zeros(3, method.STATE)
    state["scale"] = 0.15
    rows = []
    for recent, steps in replay(group):
        rows.append(np.column_stack([steps.phone, method.advance(state, recent, steps)]))
    table = np.concatenate(rows)
    medians = [np.nanmedian(table[table[:, 0] == row, 1]) for row in range(3)]
    assert medians == sorted(medians)
    assert medians[2] > 1.3 * medians[0]


def test_many_phones_at_once_are_told_the_same_as_each_alone() -> None:
    group = walks(3)
    for walk, table in zip(group, lengths(group), strict=True):
        alone = lengths([walk])[0]
        together = table[: len(alone)]
        assert together == pytest.approx(alone[: len(together)], nan_ok=True)


def test_a_calibration_that_makes_no_sense_is_refused_with_its_reason() -> None:
    state = np.zeros(2, SwingLength.STATE)
    state["swung"] = [10.0, 0.0]
    with pytest.raises(ValueError, match="distance is -3 m, allowed is more than 0"):
        SwingLength().calibrate(state, np.array([-3.0, np.nan]))
    with pytest.raises(ValueError, match="made no step"):
        SwingLength().calibrate(state, np.array([np.nan, 20.0]))
    SwingLength().calibrate(state, np.array([2.0, np.nan]))
    assert state["scale"].tolist() == [0.2, 0.0]
