"""Wi-Fi alone by histograms: the case by hand, the bins' edges, what is missing, and who ends up where."""

import numpy as np
import pytest
from baseline_world import SmallWorld
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.baselines.naive_bayes import NaiveBayes, NaiveBayesParameters, bin_width_for
from benchmarks.baselines.survey import Survey

NAN = np.nan
TWO_POINTS = Survey(
    ["a", "b"],
    np.array([[0.0, 0.0], [3.0, 0.0]]),
    np.array([[[-95.0, -61.0], [-96.0, NAN]], [[-60.0, -61.0], [-60.0, -61.0]]]),
)


def test_a_survey_small_enough_to_count_by_hand():
    # Bins of 20 dB from -100: [-100, -81], [-80, -61], [-60, -41], [-40, -34]. Two scans at each point.
    nb = NaiveBayes(TWO_POINTS, NaiveBayesParameters(bin_width=20))
    assert nb.parameters.bins == 4
    a, b = np.exp(nb.log_probability[:, 0]), np.exp(nb.log_probability[:, 1])
    np.testing.assert_allclose(a, np.array([[3, 1, 1, 1], [1, 1, 3, 1]]) / 6)
    # At the first point b was heard once at -61 (second bin) and missed once (the weakest bin).
    np.testing.assert_allclose(b, np.array([[2, 2, 1, 1], [1, 3, 1, 1]]) / 6)
    # a in the third bin, b missed: 1/6 · 2/6 against 3/6 · 1/6, hence 2 : 3 and 3 m · 3/5.
    np.testing.assert_allclose(nb.posterior(np.array([[-55.0, NAN]])), [[0.4, 0.6]])
    np.testing.assert_allclose(nb.locate(np.array([[-55.0, NAN]])), [[1.8, 0.0]])


@pytest.mark.parametrize(
    ("missing", "first", "second"),
    [
        # Of b alone (a was heard alike by choice): what its absence says of each point.
        ("skip", 1.0, 1.0),
        ("own_bin", 2 / 7, 1 / 7),
        ("floor", 2 / 6, 1 / 6),
    ],
)
def test_an_access_point_that_was_missed_counts_as_it_was_told_to(missing, first, second):
    nb = NaiveBayes(TWO_POINTS, NaiveBayesParameters(bin_width=20, missing=missing))
    bins = 5 if missing == "own_bin" else 4
    # a at -45 dBm was never heard at the first point, twice at the second.
    expected = np.array([1 / (2 + bins) * first, 3 / (2 + bins) * second])
    np.testing.assert_allclose(np.exp(nb.log_likelihood(np.array([[-45.0, NAN]]))), [expected])


@pytest.mark.parametrize(
    ("width", "reading", "number"),
    # The study's example: -100 … -34 dBm in bins of 14 dB, -67 dBm is in the third; its own formula lets -34 overflow.
    [(14, -67.0, 2), (14, -34.0, 4), (11, -34.0, 6), (4, -100.0, 0), (4, -97.0, 0), (4, -96.0, 1), (4, -20.0, 16)],
)
def test_readings_fall_into_the_study_s_bins_and_the_outermost_take_what_lies_outside(width, reading, number):
    survey = Survey(["a"], np.zeros((1, 2)), np.array([[[reading]]]))
    nb = NaiveBayes(survey, NaiveBayesParameters(bin_width=width))
    assert np.argmax(nb.log_probability[0, 0]) == number


def test_many_access_points_do_not_underflow():
    rng = np.random.default_rng(0)
    readings = np.concatenate([rng.normal(-80.0, 2.0, (1, 10, 2000)), rng.normal(-50.0, 2.0, (1, 10, 2000))])
    nb = NaiveBayes(Survey([str(n) for n in range(2000)], np.array([[0.0, 0.0], [9.0, 0.0]]), readings))
    np.testing.assert_allclose(nb.locate(rng.normal(-50.0, 2.0, (3, 2000))), [[9.0, 0.0]] * 3)


def test_silence_is_nowhere_in_particular_when_missing_tells_nothing():
    nb = NaiveBayes(TWO_POINTS, NaiveBayesParameters(missing="skip"))
    np.testing.assert_allclose(nb.locate(np.array([[NAN, NAN]])), [[1.5, 0.0]])


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.one_of(st.just(NAN), st.floats(-200.0, 20.0)), min_size=2, max_size=2),
    st.integers(1, 90),
    st.sampled_from(["floor", "skip", "own_bin"]),
)
def test_no_reading_however_odd_leads_out_of_the_survey(readings, width, missing):
    nb = NaiveBayes(TWO_POINTS, NaiveBayesParameters(bin_width=width, missing=missing))
    np.testing.assert_allclose(np.exp(nb.log_probability).sum(axis=2), 1.0)
    place = nb.locate(np.array([readings]))[0]
    assert 0.0 <= place[0] <= 3.0
    assert place[1] == 0.0


def test_more_scans_at_each_point_are_less_error_and_one_bin_says_nothing():
    world = SmallWorld(seed=4)
    points = world.survey(spacing=1.5, samples=60)
    rng = np.random.default_rng(1)
    order = rng.permutation(60)
    test = points.readings[:, order[50:]]
    truth = np.repeat(points.position, 10, axis=0)

    def rmse(samples, width):
        survey = Survey(points.access_points, points.position, points.readings[:, order[:samples]])
        estimate = NaiveBayes(survey, NaiveBayesParameters(bin_width=width)).locate(test.reshape(-1, test.shape[2]))
        return np.sqrt(((estimate - truth) ** 2).sum(axis=1).mean())

    assert rmse(40, 2) < 0.9 * rmse(5, 4) < 0.9 * rmse(40, 67)


def test_the_bin_width_follows_the_study_s_table():
    assert [bin_width_for(count) for count in (1, 10, 20, 29, 30, 40, 50, 500)] == [4, 4, 4, 4, 3, 2, 2, 2]


@pytest.mark.parametrize(
    ("wrong", "named"),
    [({"bin_width": 0}, "bin_width: 0"), ({"missing": "zero"}, "missing: 'zero'"), ({"weakest": -34}, "weakest: -34")],
)
def test_settings_without_a_meaning_are_refused(wrong, named):
    with pytest.raises(ValueError, match=named):
        NaiveBayesParameters(**wrong)
