"""What is expected of single readings is what the tables say, on one path or many; and the model of no places."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from shared.radio import Nowhere, PathLoss, ShadowingMap, expected_level

RNG = np.random.default_rng(0)
RADIO = PathLoss(
    ("a", "b", "c"), RNG.uniform(0.0, 12.0, (3, 3)), np.array([-40.0, -43.0, -38.0]), np.array([2.0, 2.5, 3.0])
)
MAP = ShadowingMap(
    RADIO.names, np.array([0.5, 0.5]), 1.5, RNG.normal(0.0, 4.0, (3, 5, 7)), RNG.uniform(1.0, 9.0, (3, 5, 7))
)


@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(1, 4))
def test_each_reading_is_expected_as_in_the_table_of_all_access_points(seed: int, readings: int, paths: int) -> None:
    rng = np.random.default_rng(seed)
    places, point = rng.uniform(-3.0, 15.0, (paths, readings, 2)), rng.integers(0, 3, readings)
    level, variance = expected_level(places, point, RADIO, MAP)
    bare, unknown = expected_level(places, point, RADIO, None)
    assert variance is not None
    assert unknown is None
    assert level.shape == variance.shape == bare.shape == (paths, readings)
    for number, path in enumerate(places):
        mean, spread = MAP.at(path)
        one = np.arange(readings), point
        np.testing.assert_allclose(bare[number], RADIO.rssi(path)[one])
        np.testing.assert_allclose(level[number], (RADIO.rssi(path) + mean)[one])
        np.testing.assert_allclose(variance[number], spread[one])


def test_without_places_readings_are_like_what_was_heard_a_moment_ago() -> None:
    nowhere = Nowhere.of(np.array([-60.0, -70.0]), np.array([49.0, 1.0]), white=4.0, device=9.0)
    assert nowhere.variance == pytest.approx([36.0, 5.0])  # nothing predicts better than 3 dB
    t, point = np.array([0.0, 1.0, 1.0, 50.0]), np.array([0, 0, 1, 0])
    covariance = nowhere.covariance(t, point, 4.0)
    np.testing.assert_allclose(np.diag(covariance), [40.0, 40.0, 9.0, 40.0])
    assert covariance[0, 1] == pytest.approx(36.0 * np.exp(-1.0 / 7.0))
    assert covariance[0, 2] == 0.0
    assert covariance[0, 3] < 0.1
    alike, unlike = np.array([6.0, 6.0]), np.array([6.0, -6.0])
    both = multivariate_normal(cov=covariance[:2, :2])
    assert both.logpdf(alike) > both.logpdf(unlike) + 3.0
    each = nowhere.covariance(t, point, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(np.diag(each), [37.0, 38.0, 8.0, 40.0])
