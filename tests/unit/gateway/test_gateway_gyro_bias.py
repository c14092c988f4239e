"""A gyroscope's bias is learned at rest, and only there."""

import numpy as np
import pytest

from services.gateway.reckoning.gyro_bias import GyroBias
from services.gateway.reckoning.hops import HOP, RATE, Hops

BIAS = np.array([0.01, -0.02, 0.03])


def hop(rotation: np.ndarray, shake: float = 0.03, count: int = HOP) -> Hops:
    rng = np.random.default_rng(7)
    acceleration = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, shake, (1, HOP, 3))
    return Hops(np.zeros(1), np.array([count]), np.array([False]), acceleration, rotation[None], np.zeros((1, HOP, 3)))


def noise(mean: np.ndarray, sigma: float = 0.005) -> np.ndarray:
    return mean + np.random.default_rng(3).normal(0.0, sigma, (HOP, 3))


def test_a_second_of_rest_removes_it() -> None:
    state = np.zeros(1, GyroBias.STATE)
    rate = GyroBias().advance(state, hop(noise(BIAS)))
    assert np.abs(rate.mean(axis=1)).max() < 1e-9
    np.testing.assert_allclose(state["bias"][0], BIAS, atol=0.003)


@pytest.mark.parametrize(
    "moving",
    [
        hop(noise(BIAS), shake=1.0),  # walking
        hop(noise(BIAS, sigma=0.2)),  # turning to and fro
        hop(noise(BIAS + np.array([0.0, 0.0, 0.5]))),  # turning evenly, on a chair
        hop(noise(BIAS), count=20),  # a hole
    ],
    ids=["walking", "shaking", "turning", "hole"],
)
def test_what_moves_teaches_nothing(moving: Hops) -> None:
    state = np.zeros(1, GyroBias.STATE)
    rate = GyroBias().advance(state, moving)
    np.testing.assert_array_equal(rate, moving.rotation)


def test_it_follows_a_bias_that_wanders() -> None:
    state = np.zeros(1, GyroBias.STATE)
    for second in range(300):
        GyroBias().advance(state, hop(noise(BIAS * (1.0 + second / 300))))
    np.testing.assert_allclose(state["bias"][0], 2.0 * BIAS, rtol=0.15)


def test_a_random_walk_of_the_angle_stays_small_after_rest() -> None:
    """Without it a degree a second makes a minute's walk turn by sixty."""
    state = np.zeros(1, GyroBias.STATE)
    for _ in range(10):
        GyroBias().advance(state, hop(noise(BIAS)))
    turned = sum(GyroBias().advance(state, hop(noise(BIAS), shake=2.0)).sum(axis=1) / RATE for _ in range(60))
    assert np.degrees(np.abs(turned)).max() < 3.0
