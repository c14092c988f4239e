"""What single step detectors promise: the thesis' figures, kernels against slow oracles, models against hmmlearn."""

import numpy as np
import pytest
from hmmlearn.hmm import CategoricalHMM
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.reckoning.hops import RATE
from services.gateway.steps.adaptive_dft import LENGTHS, LONGEST, contrast, fitted_sines
from services.gateway.steps.rhythm import LAGS, rhythm
from services.gateway.steps.spacing import CLOCK_STEP, spaced
from services.gateway.steps.step_hmm import shipped_model
from services.gateway.steps.step_words import SYMBOLS, WORD
from services.gateway.steps.thresholds import TrialError, centre_of_zeros, personalise

FIGURE_3_14 = """
0 0 3 3 3 0 3
0 0 0 0 0 0 -
0 0 0 0 0 - -
3 3 3 3 - - -
3 3 3 - - - -
3 3 - - - - -
8 - - - - - -
"""
DELTA = (13.0, 12.9, 12.8, 12.7, 12.6, 12.5, 12.4)
RHO = (12.3, 12.4, 12.5, 12.6, 12.7, 12.8, 12.9)


def trial_walk(steps: int, peak: float, seconds_of_rest: float = 2.0) -> np.ndarray:
    """Rest, ``steps`` footfalls of 0.6 s whose norm peaks at ``peak``, rest; (n, 3)."""
    walk = np.arange(int(steps * 0.6 * RATE)) / RATE
    rest = np.zeros(int(seconds_of_rest * RATE))
    wave = np.concatenate([rest, -(peak - 9.81) * np.cos(2 * np.pi * walk / 0.6), rest])
    return (9.81 + wave)[:, None] * np.array([0.6, 0.0, 0.8])


def test_the_centre_of_the_thesis_figure_is_what_the_thesis_chose() -> None:
    cells = [[np.nan if cell == "-" else float(cell) for cell in row.split()] for row in FIGURE_3_14.split("\n") if row]
    row, column = centre_of_zeros(np.array(cells))
    assert (DELTA[row], RHO[column]) == (12.9, 12.5)


@pytest.mark.parametrize("peak", [11.5, 13.5])
def test_a_trial_walk_gives_thresholds_below_its_own_peaks(peak: float) -> None:
    delta, rho = personalise(trial_walk(15, peak), 15)
    assert 9.81 < rho < delta < peak


@pytest.mark.parametrize(
    ("walk", "steps", "words"),
    [
        (trial_walk(15, 12.0), 20, "steps: 20"),
        (trial_walk(15, 12.0), 0, "steps: 0"),
        (trial_walk(15, 12.0), 3, "no thresholds"),
        (trial_walk(0, 12.0), 10, "no thresholds"),
        (trial_walk(1, 12.0, 0.1), 1, "two seconds"),
    ],
)
def test_a_trial_walk_that_teaches_nothing_is_refused_with_a_reason(walk: np.ndarray, steps: int, words: str) -> None:
    with pytest.raises(TrialError, match=words):
        personalise(walk, steps)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.01, 3.0)), max_size=30), st.floats(0.1, 1.0))
def test_spacing_keeps_what_one_after_the_other_would_keep(events: list[tuple[int, float]], gap: float) -> None:
    events = sorted(events)
    last = np.zeros(4)
    kept = spaced(np.array([e[0] for e in events], int), np.array([e[1] for e in events]), last, np.full(4, gap))
    before = np.zeros(4)
    for (phone, t), keeps in zip(events, kept, strict=True):
        assert keeps == (before[phone] == 0.0 or t - before[phone] >= gap - CLOCK_STEP)
        before[phone] = t if keeps else before[phone]
    np.testing.assert_array_equal(last, before)


def test_rhythm_agrees_with_correlation_written_out() -> None:
    rng = np.random.default_rng(2)
    n = 200
    for period in (0.45, 0.6, 0.8):
        wave = np.cos(2 * np.pi * np.arange(n) / RATE / period) + rng.normal(0, 0.3, n)
        found, agreement = (float(value[0]) for value in rhythm(wave[None]))
        assert found == pytest.approx(period, abs=1.5 / RATE)
        correlations = []
        for lag in range(LAGS[0], LAGS[1]):
            early, late = wave[: n - lag], wave[lag:]
            correlations.append(early @ late / np.sqrt((early @ early) * (late @ late)))
        assert min(abs(np.array(correlations) - agreement)) < 1e-9
        assert agreement >= 0.85 * max(correlations) - 1e-9


def test_rhythm_takes_the_step_where_one_foot_strikes_harder_and_nothing_from_silence() -> None:
    t = np.arange(200) / RATE
    limp = np.cos(2 * np.pi * t / 0.6) + 0.7 * np.cos(np.pi * t / 0.6)
    period, _ = rhythm(np.stack([limp, np.zeros(200)]))
    assert period[0] == pytest.approx(0.6, abs=0.03)
    assert period[1] == 0.0


def test_the_forward_algorithm_gives_what_hmmlearn_gives() -> None:
    model = shipped_model()
    oracle = CategoricalHMM(len(model.start), n_features=SYMBOLS)
    oracle.startprob_, oracle.emissionprob_ = model.start, model.emission
    oracle.transmat_ = model.transition / model.transition.sum(axis=1, keepdims=True)
    words = np.random.default_rng(4).integers(0, SYMBOLS, (20, WORD))
    expected = [oracle.score(word[:, None]) for word in words]
    np.testing.assert_allclose(model.log_probability(words), expected, rtol=1e-3)


def test_the_shipped_model_goes_from_left_to_right() -> None:
    model = shipped_model()
    assert model.start[0] == 1.0
    assert np.all(np.tril(model.transition, -1) == 0.0)
    np.testing.assert_allclose(model.transition.sum(axis=1), 1.0, atol=1e-4)
    np.testing.assert_allclose(model.emission.sum(axis=1), 1.0, atol=1e-4)


def test_contrast_peaks_where_a_window_holds_whole_steps() -> None:
    """The dissertation's example: 108 samples to a cycle at 100 Hz peak near 432 and 540; here 54 at 50 Hz."""
    period = 27
    n = np.arange(LONGEST)
    wave = np.cos(2 * np.pi * n / period) + 0.2 * np.cos(4 * np.pi * n / period + 1.0)
    cycles, curve, share = (values[0] for values in contrast((wave - wave.mean())[None]))
    for wanted in (8, 9, 10):
        near = np.flatnonzero(np.abs(LENGTHS - wanted * period) < 0.4 * period)
        peak = near[np.argmax(curve[near])]
        assert abs(LENGTHS[peak] - wanted * period) <= 2
        assert cycles[peak] == wanted
        assert share[peak] > 0.8


def test_sines_follow_a_curve_and_leave_its_noise() -> None:
    n = np.arange(100)
    curve = 1.0 + np.sin(2 * np.pi * n / 30) + 0.4 * np.sin(2 * np.pi * n / 55 + 1.0)
    assert np.std(fitted_sines(curve) - curve) < 0.1 * np.std(curve)
    noisy = curve + np.random.default_rng(6).normal(0, 0.3, 100)
    assert np.std(fitted_sines(noisy) - curve) < 0.5 * np.std(noisy - curve)
