"""What one scan says for places, and how much of it is new."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.fusion.evidence.calibration import Calibration
from services.fusion.evidence.hearing import Hearing
from services.fusion.evidence.radio_evidence import novelty, scan_likelihood
from shared.radio import PathLoss


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32), points=st.integers(1, 8))
def test_the_offset_is_marginalised_exactly(seed: int, points: int) -> None:
    """Against the Gaussian whose covariance is written out; residuals within the limit of outliers."""
    rng = np.random.default_rng(seed)
    residual, variance = rng.uniform(-4, 4, (3, points)), rng.uniform(9.0, 30.0, points)
    offset, spread = rng.uniform(-2, 2), rng.uniform(1.0, 9.0)
    covariance = np.diag(variance) + spread
    expected = [
        -0.5 * (r - offset) @ np.linalg.solve(covariance, r - offset) - 0.5 * np.linalg.slogdet(covariance)[1]
        for r in residual
    ]
    assert scan_likelihood(residual, variance, offset, spread) == pytest.approx(expected)


@pytest.mark.parametrize("rows", [1, 40], ids=["one variance for all places", "a variance of each place"])
def test_many_places_at_once_agree_with_one_by_one(rows: int) -> None:
    """Outliers among them."""
    rng = np.random.default_rng(rows)
    residual, variance = rng.normal(0.0, 15.0, (40, 7)), rng.uniform(4.0, 30.0, (rows, 7))
    together = scan_likelihood(residual, variance, 1.5, 6.0)
    for place, own in zip(range(40), np.broadcast_to(variance, (40, 7)), strict=True):
        limit = 3.0 * np.sqrt(own + 6.0)
        off = np.clip(residual[place] - 1.5, -limit, limit)
        covariance = np.diag(own) + 6.0
        expected = -0.5 * (off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(covariance)[1])
        assert together[place] == pytest.approx(expected, abs=1e-9)


def test_a_phone_that_hears_everything_weaker_is_forgiven() -> None:
    common, mixed = scan_likelihood(np.array([[-6.0] * 6, [-6.0, 6.0] * 3]), np.full(6, 20.0), 0.0, 9.0)
    assert common > mixed + 3.0


def test_an_outlier_says_no_more_than_the_limit() -> None:
    far, farther = scan_likelihood(np.array([[40.0, 0.0], [80.0, 0.0]]), np.full(2, 20.0), 0.0, 4.0)
    assert far == farther


def test_a_still_phone_tells_nothing_new_at_whatever_rate() -> None:
    slow = novelty(1.0, 0.0, 60.0, 2.5)
    quick = 1.0 - np.prod([1.0 - novelty(0.1, 0.0, 60.0, 2.5)] * 10)
    assert slow == pytest.approx(quick)
    assert slow < 0.02
    assert novelty(1.0, 1.2, 60.0, 2.5) > 0.3
    assert novelty(math.inf, 0.0, 60.0, 2.5) == 1.0


def test_ten_scans_a_second_are_gathered_into_one() -> None:
    hearing = Hearing(0.0, 9.0)
    gathered = [hearing.take(100.0 + number / 10, {0: -50.0 - number % 2, 2: -70.0}, 0.9) for number in range(41)]
    whole = [one for one in gathered if one is not None]
    assert len(whole) == 5
    assert whole[0].elapsed == math.inf
    assert whole[2].level == pytest.approx([-50.5, -70.0], abs=0.1)
    assert whole[2].count.sum() == pytest.approx(18, abs=2)
    assert Hearing.restored(hearing.state()) == hearing


def test_access_points_are_learned_though_nobody_knows_exactly_where_the_phones_are() -> None:
    model = PathLoss(
        ("a", "b"), np.array([[0.0, 0.0, 3.0], [20.0, 0.0, 3.0]]), np.array([-40.0, -40.0]), np.array([2.2, 2.2])
    )
    calibration = Calibration.of(model)
    rng = np.random.default_rng(2)
    for _ in range(300):
        place = rng.uniform([0, 0], [20, 10])
        level = model.rssi(place[None])[0] + np.array([-7.0, 4.0]) + rng.normal(0, 4, 2)
        seen = place[None] + rng.normal(0, 1, (1, 2))
        residual = level - calibration.rssi(seen)[0]
        calibration.learn(np.array([0, 1]), model.log_distance(seen)[0], residual, np.full(2, 1 / 16))
        calibration.solve()
    error = calibration.rssi(np.array([[10.0, 5.0]])) - model.rssi(np.array([[10.0, 5.0]]))
    assert error[0] == pytest.approx([-7.0, 4.0], abs=0.8)


def test_path_loss_falls_by_ten_n_per_decade_and_stays_finite_at_the_antenna() -> None:
    model = PathLoss(("a",), np.array([[0.0, 0.0, 1.1]]), np.array([-40.0]), np.array([2.0]))
    level = model.rssi(np.array([[1.0, 0.0], [10.0, 0.0], [0.0, 0.0]]))[:, 0]
    assert level[0] == pytest.approx(-40.0)
    assert level[1] == pytest.approx(-60.0)
    assert np.isfinite(level[2])


@pytest.mark.parametrize("factor", [0.7, 1.0, 2.5])
def test_how_noisy_readings_are_is_learned_whatever_the_phone_reads_too_much(factor: float) -> None:
    made = Calibration.of(PathLoss(("a",), np.zeros((1, 3)), np.full(1, -40.0), np.full(1, 2.0)))
    rng = np.random.default_rng(3)
    variance = np.array([10.0, 20.0, 20.0, 40.0])
    assert made.noise == 1.0
    for _ in range(400):
        made.learn_noise(7.0 + rng.normal(size=4) * np.sqrt(factor * variance), variance, 0.5)
    assert made.noise == pytest.approx(factor, rel=0.15)


def test_one_reading_says_nothing_of_noise_and_nonsense_not_too_much() -> None:
    made = Calibration.of(PathLoss(("a",), np.zeros((1, 3)), np.full(1, -40.0), np.full(1, 2.0)))
    made.learn_noise(np.array([50.0]), np.array([10.0]), 1.0)
    assert made.noise == 1.0
    for _ in range(50):
        made.learn_noise(np.array([50.0, -50.0]), np.array([10.0, 10.0]), 1.0)
    assert made.noise == 4.0
