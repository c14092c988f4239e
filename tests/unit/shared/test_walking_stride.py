"""Step lengths: universal and personal models, and that they say how far they may be off."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.walking.stride import LENGTHS, StrideLine, by_height, step_lengths
from shared.walking.stride_calibration import StrideCalibrationError, TrialWalk, two_walks
from shared.walking.stride_learning import DAY_SIGMA, SLOPE, fit_line

anything = st.floats(allow_nan=True, allow_infinity=True)


def walk(cadence: float, length: float, steps: int = 20) -> TrialWalk:
    return TrialWalk(steps * length, np.arange(steps) / cadence)


@given(st.lists(st.tuples(anything, anything), min_size=1, max_size=20))
def test_whatever_is_measured_lengths_are_human_and_doubt_is_positive(pairs: list[tuple[float, float]]) -> None:
    cadence, bounce = np.array(pairs).T
    found = step_lengths(cadence, bounce)
    assert np.all((found.length >= LENGTHS[0]) & (found.length <= LENGTHS[1]))
    assert np.all(found.scale_variance > 0.0)
    assert np.all(found.variance > found.length**2 * found.scale_variance)


def test_a_stronger_bounce_at_the_same_cadence_is_a_longer_step() -> None:
    lengths = step_lengths(np.full(5, 1.85), np.array([2.0, 4.0, 8.0, 12.0, 18.0])).length
    assert np.all(np.diff(lengths) > 0.0)


def test_a_quicker_step_is_longer_where_the_bounce_is_not_known() -> None:
    lengths = step_lengths(np.array([1.4, 1.85, 2.3]), np.full(3, np.nan)).length
    assert np.all(np.diff(lengths) > 0.0)
    assert lengths[1] == pytest.approx(0.70, abs=0.01)


def test_without_bounce_more_is_in_doubt() -> None:
    scale = step_lengths(np.full(2, 1.85), np.array([8.0, np.nan])).scale_variance
    assert scale[1] > scale[0]


def test_tall_people_take_longer_steps() -> None:
    assert by_height(np.array([1.85]), 1.9)[0] > by_height(np.array([1.85]), 1.6)[0]


def test_only_people_with_a_line_are_judged_by_it() -> None:
    line = StrideLine(np.array([0.4, 0.0]), np.array([0.1, 0.0]), np.array([0.001, 0.0]))
    cadence, bounce = np.full(2, 1.7), np.full(2, 7.0)
    found, universal = step_lengths(cadence, bounce, line), step_lengths(cadence, bounce)
    assert found.length[0] == pytest.approx(0.78)
    assert found.scale_variance[0] == pytest.approx(0.001)
    assert found.length[1] == universal.length[1]
    assert found.scale_variance[1] == universal.scale_variance[1]


@given(st.floats(0.0, 1.0), st.floats(1.3, 1.7), st.floats(0.2, 0.8), st.floats(0.5, 0.7))
def test_two_exact_walks_give_their_line_exactly(slope: float, slow: float, more: float, length: float) -> None:
    other = length + slope * more
    if other > LENGTHS[1]:
        return
    line = two_walks(walk(slow, length), walk(slow + more, other))
    assert float(line.slope) == pytest.approx(slope, abs=1e-9)
    assert float(line.slope * slow + line.offset) == pytest.approx(length)
    assert float(line.scale_variance) > 0.0


def test_the_example_of_the_thesis() -> None:
    line = two_walks(walk(1.5, 0.725), walk(2.0, 0.90))
    assert (float(line.slope), float(line.offset)) == pytest.approx((0.35, 0.20))


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        (walk(1.8, 0.7), walk(1.85, 0.72), "second walk: 1.85 steps per second"),
        (walk(1.5, 0.7, steps=5), walk(2.0, 0.8), "first walk: 5 steps"),
        (walk(1.5, 0.7), walk(2.0, 1.6), "second walk: 32 m in 20 steps"),
        (walk(1.5, 0.8), walk(2.0, 0.6), "second walk: steps of 0.60 m"),
        (TrialWalk(14.0, np.zeros(20)), walk(2.0, 0.8), "first walk: times"),
        (TrialWalk(14.0, np.full(20, np.nan)), walk(2.0, 0.8), "first walk: times"),
        (TrialWalk(float("nan"), np.arange(20.0)), walk(2.0, 0.8), "first walk: nan m"),
    ],
)
def test_walks_that_say_nothing_are_refused_by_name(first: TrialWalk, second: TrialWalk, told: str) -> None:
    with pytest.raises(StrideCalibrationError, match=told):
        two_walks(first, second)


def test_longer_trial_walks_leave_less_doubt() -> None:
    short, long = (two_walks(walk(1.5, 0.7, n), walk(2.0, 0.85, n)) for n in (10, 60))
    assert long.scale_variance < short.scale_variance


def test_without_data_the_personal_line_is_what_people_have() -> None:
    line = fit_line(np.empty(0), np.empty(0))
    assert float(line.slope) == pytest.approx(SLOPE)
    assert float(line.slope * 1.85 + line.offset) == pytest.approx(0.70, abs=0.01)


def test_a_walk_at_one_cadence_teaches_the_level_and_not_the_slope() -> None:
    rng = np.random.default_rng(1)
    cadence = rng.normal(1.85, 0.03, 200)
    length = 0.60 - 0.5 * (cadence - 1.85) + rng.normal(0.0, 0.10, 200)
    plain = np.polyfit(cadence, length, 1)[0]
    line = fit_line(cadence, length)
    assert abs(float(line.slope) - SLOPE) < 0.1 < abs(plain - SLOPE)
    assert float(line.slope * 1.85 + line.offset) == pytest.approx(0.60, abs=0.03)


def test_walks_at_many_cadences_teach_the_slope() -> None:
    rng = np.random.default_rng(2)
    cadence = rng.uniform(1.3, 2.3, 2000)
    line = fit_line(cadence, 0.15 + 0.25 * cadence + rng.normal(0.0, 0.10, 2000))
    assert float(line.slope) == pytest.approx(0.25, abs=0.03)


def test_steps_of_somebody_else_hardly_move_the_line() -> None:
    rng = np.random.default_rng(3)
    cadence = rng.normal(1.85, 0.1, 300)
    length = 0.70 + 0.35 * (cadence - 1.85) + rng.normal(0.0, 0.05, 300)
    length[::10] = 1.9
    line = fit_line(cadence, length)
    assert float(line.slope * 1.85 + line.offset) == pytest.approx(0.70, abs=0.03)


def test_more_data_leave_less_doubt_but_never_none() -> None:
    rng = np.random.default_rng(4)
    doubts = []
    for n in (0, 20, 200, 20000):
        cadence = rng.normal(1.85, 0.1, n)
        doubts.append(float(fit_line(cadence, 0.35 * cadence + 0.05).scale_variance))
    assert np.all(np.diff(doubts) < 0.0)
    assert doubts[-1] > DAY_SIGMA**2


def test_pairs_that_do_not_match_are_refused() -> None:
    with pytest.raises(ValueError, match=r"length: \(3,\)"):
        fit_line(np.ones(2), np.ones(3))
