"""The errors of the studies on worlds small enough to compute them by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from benchmarks.position_error import (
    centre_of,
    error_cdf,
    field_of_view_errors,
    hold,
    percentiles,
    window_rmse,
)
from benchmarks.world_record import Truth

Array = NDArray[np.float64]
NAN = math.nan
EPOCH = 1.7e9


def standing(n: int, step: float = 1.0) -> Truth:
    """A stranger at (9, 9) and one carrier at the origin, both in view at all of n times."""
    position = np.broadcast_to(np.array([[9.0, 9.0], [0.0, 0.0]]), (n, 2, 2)).copy()
    return Truth(EPOCH + step * np.arange(n), ["stranger", "worker"], [None, "d1"], position, np.ones((n, 2), np.bool_))


def on_x(*values: float) -> Array:
    """Estimates of one carrier on the x axis."""
    return np.array([[[value, value * 0.0]] for value in values])


def test_rmse_is_taken_within_each_window_and_not_over_all() -> None:
    errors = window_rmse(standing(4), on_x(1, 7, 3, 3), np.zeros(2), window=2.0)
    assert_allclose(errors.rmse, [[5.0], [3.0]])  # sqrt((1 + 49) / 2), sqrt((9 + 9) / 2)
    assert_array_equal(errors.scored, [[2], [2]])


def test_windows_of_a_minute_hold_a_minute_at_any_frame_rate() -> None:
    for rate in (2, 7, 15, 30):
        errors = window_rmse(standing(121 * rate, 1 / rate), np.zeros((121 * rate, 1, 2)), np.zeros(2))
        assert_array_equal(errors.scored[:, 0], [60 * rate, 60 * rate, rate])


def test_a_missing_estimate_is_the_last_one_held_and_before_the_first_the_centre_of_the_view() -> None:
    errors = window_rmse(standing(4), on_x(NAN, 2, NAN, NAN), np.array([6.0, 8.0]), window=2.0)
    assert_allclose(errors.rmse[:, 0], [math.sqrt((100 + 4) / 2), 2.0])
    assert_allclose(errors.located[:, 0], [0.5, 0.0])


def test_times_out_of_view_count_only_when_asked_for() -> None:
    truth = standing(4)
    truth.in_view[2:, 1] = False
    estimate = on_x(1, 1, 5, 5)
    seen = window_rmse(truth, estimate, np.zeros(2), window=2.0)
    assert_allclose(seen.rmse, [[1.0], [NAN]])
    assert_allclose(seen.located, [[1.0], [NAN]])
    assert_allclose(window_rmse(truth, estimate, np.zeros(2), window=2.0, out_of_view=True).rmse, [[1.0], [5.0]])


def test_who_is_not_about_is_never_scored() -> None:
    truth = standing(4)
    truth.position[:2, 1] = NAN
    errors = window_rmse(truth, on_x(1, 1, 2, 2), np.zeros(2), window=2.0, out_of_view=True)
    assert_allclose(errors.rmse, [[NAN], [2.0]])
    assert errors.figures("trial1_") == {
        "trial1_p50": pytest.approx(2.0),
        "trial1_p70": pytest.approx(2.0),
        "trial1_p90": pytest.approx(2.0),
        "trial1_located": 1.0,
    }


def test_an_estimate_for_other_people_is_refused_with_both_shapes() -> None:
    with pytest.raises(ValueError, match=r"\(4, 2, 2\).*\(4, 1, 2\)"):
        window_rmse(standing(4), np.zeros((4, 2, 2)), np.zeros(2))
    with pytest.raises(ValueError, match="window: 0"):
        window_rmse(standing(4), np.zeros((4, 1, 2)), np.zeros(2), window=0.0)


def test_the_field_of_view_errors_of_the_museum_study() -> None:
    truth = standing(5)
    truth.in_view[:, 1] = [True, True, True, False, False]
    errors = field_of_view_errors(truth, on_x(1, 4, NAN, 2, NAN), window=10.0)
    assert errors.offline[0, 0] == pytest.approx(2.5)  # the two times both say "in view": (1 + 4) / 2
    assert errors.false_in[0, 0] == pytest.approx(1 / 5)
    assert errors.false_out[0, 0] == pytest.approx(1 / 5)
    assert errors.overlap[0, 0] == pytest.approx(2 / 5)
    assert math.isnan(errors.online[0, 0])  # out of view at the last time


def test_the_online_error_is_that_of_the_windows_last_time() -> None:
    errors = field_of_view_errors(standing(4), on_x(1, 2, 3, 4), window=2.0)
    assert_allclose(errors.online[:, 0], [2.0, 4.0])
    figures = errors.figures("evloc_")
    assert figures["evloc_offline_median"] == pytest.approx(2.5)  # of 1.5 and 3.5
    assert (figures["evloc_overlap_zero_share"], figures["evloc_overlap_max"]) == (1.0, 0.0)
    assert figures["evloc_online_median"] == pytest.approx(3.0)


def test_percentiles_leave_out_what_is_not_defined() -> None:
    assert percentiles(np.array([NAN, 0.0, 10.0])) == pytest.approx((5.0, 7.0, 9.0))
    assert percentiles(np.array([NAN])) == (None, None, None)


def test_the_cdf_reaches_one_at_the_largest_error() -> None:
    values, share = error_cdf(np.array([[3.0, NAN], [1.0, 2.0]]))
    assert_allclose(values, [1, 2, 3])
    assert_allclose(share, [1 / 3, 2 / 3, 1])


def test_the_centre_of_a_view_does_not_lean_towards_many_corners() -> None:
    assert_allclose(centre_of(np.array([[0, 0], [4, 0], [4, 2], [3.9, 2], [3.8, 2], [0, 2]])), [2.0, 1.0])


finite = st.floats(-50, 50, width=32)


@given(arrays.arrays(np.float64, (12, 1, 2), elements=finite), st.floats(-30, 30), st.floats(-30, 30))
def test_rmse_does_not_depend_on_where_the_plan_begins(estimate: Array, dx: float, dy: float) -> None:
    truth = standing(12)
    shift = np.array([dx, dy])
    moved = Truth(truth.t, truth.person, truth.device, truth.position + shift, truth.in_view)
    here = window_rmse(truth, estimate, np.zeros(2), window=5.0).rmse
    there = window_rmse(moved, estimate + shift, shift, window=5.0).rmse
    assert_allclose(here, there, atol=1e-9)


@given(arrays.arrays(np.float64, (9, 2, 2), elements=st.one_of(finite, st.just(NAN))))
def test_holding_changes_no_estimate_and_leaves_no_gap(estimate: Array) -> None:
    held = hold(estimate, np.array([1.0, 2.0]))
    known = np.isfinite(estimate).all(axis=2)
    assert np.isfinite(held).all()
    assert_array_equal(held[known], estimate[known])
    for column in range(2):  # the slow, obvious way
        last = np.array([1.0, 2.0])
        for row in range(9):
            last = estimate[row, column] if known[row, column] else last
            assert_array_equal(held[row, column], last)
