"""The array filters against filterpy's, one at a time."""

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.fusion.positions import kalman_bank

Array = NDArray[np.float64]


def oracle(mean: Array, covariance: Array, dt: float, q: float) -> KalmanFilter:
    """A filterpy filter over x, y, vx, vy, ready to predict ``dt``."""
    single = KalmanFilter(dim_x=4, dim_z=2)
    single.x, single.P = mean.reshape(4, 1).copy(), covariance.copy()
    single.F = np.eye(4) + dt * np.eye(4, k=2)
    block = Q_continuous_white_noise(2, dt, spectral_density=q)
    single.Q = np.kron(block, np.eye(2))
    single.H = np.eye(2, 4)
    return single


def random_bank(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    root = rng.normal(size=(count, 4, 4))
    return rng.normal(0, 5, (count, 4)), root @ root.transpose(0, 2, 1) + 0.1 * np.eye(4)


def random_noise(rng: np.random.Generator, count: int) -> Array:
    root = rng.normal(size=(count, 2, 2))
    return root @ root.transpose(0, 2, 1) + 0.05 * np.eye(2)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32), dt=st.floats(0.001, 3.0), q=st.floats(0.01, 5.0))
def test_predict_and_update_equal_filterpy(seed: int, dt: float, q: float) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = random_bank(rng, 5)
    positions, noise = rng.normal(0, 5, (5, 2)), random_noise(rng, 5)
    singles = [oracle(mean[i], covariance[i], dt, q) for i in range(5)]
    kalman_bank.predict(mean, covariance, dt, q)
    for i, single in enumerate(singles):
        single.predict()
        np.testing.assert_allclose(mean[i], single.x.ravel(), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(covariance[i], single.P, rtol=1e-9, atol=1e-9)
    _, mahalanobis, log_det = kalman_bank.innovations(mean, covariance, positions, noise)
    after, spread = kalman_bank.update(mean, covariance, positions, noise)
    for i, single in enumerate(singles):
        single.update(positions[i], R=noise[i])
        np.testing.assert_allclose(after[i], single.x.ravel(), rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(spread[i], single.P, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(mahalanobis[i, i], single.mahalanobis**2, rtol=1e-6)
        np.testing.assert_allclose(log_det[i, i], np.linalg.slogdet(single.S)[1], rtol=1e-6, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32), lag=st.floats(0.01, 0.5))
def test_a_late_measurement_equals_a_filter_that_measures_the_past(seed: int, lag: float) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = random_bank(rng, 3)
    positions, noise = rng.normal(0, 5, (3, 2)), random_noise(rng, 3)
    after, spread = kalman_bank.update(mean, covariance, positions, noise, lag)
    for i in range(3):
        single = oracle(mean[i], covariance[i], 0.0, 0.0)
        single.H = np.hstack([np.eye(2), -lag * np.eye(2)])
        single.update(positions[i], R=noise[i])
        np.testing.assert_allclose(after[i], single.x.ravel(), rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(spread[i], single.P, rtol=1e-7, atol=1e-7)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32))
def test_covariances_stay_symmetric_and_positive(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, covariance = kalman_bank.start(rng.normal(0, 5, (4, 2)), random_noise(rng, 4), 1.0)
    for _ in range(200):
        kalman_bank.predict(mean, covariance, float(rng.uniform(0.01, 0.5)), 0.2)
        mean, covariance = kalman_bank.update(
            mean, covariance, mean[:, :2] + rng.normal(0, 0.3, (4, 2)), random_noise(rng, 4)
        )
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
