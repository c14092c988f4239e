"""The incremental radio filter against the one big Gaussian, and what the evidence must and must not say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.fusion.evidence.radio_evidence import PathFilters
from shared.radio import PathLoss, RadioNoise, log_likelihood

NOISE = RadioNoise(white=2.0, shadowing=4.0, shadowing_range=3.0, access_point=3.0, device=2.5)
ROW = np.zeros(1, np.int64)


def filtered(residual: np.ndarray, along: np.ndarray, heard: np.ndarray) -> float:
    """Sum of the filter's predictive log-likelihoods of (n, m) residuals at (n,) positions along a straight line."""
    points = residual.shape[1]
    filters = PathFilters.new(1, 1, np.full(points, NOISE.access_point**2), NOISE)
    total = 0.0
    for index in range(len(residual)):
        kept = np.exp(-abs(along[index] - along[index - 1]) / NOISE.shadowing_range) if index else 0.0
        here, rest = np.flatnonzero(heard[index]), np.flatnonzero(~heard[index])
        variance = np.full((1, len(here)), NOISE.shadowing**2)
        total += float(
            filters.scan(
                0, ROW, here, residual[index, here][None], np.array([kept]), variance, NOISE.white**2
            )[0]
        )  # fmt: skip
        filters.fade(0, ROW, rest, np.array([kept]), np.full((1, len(rest)), NOISE.shadowing**2))
    return total


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32), scans=st.integers(1, 12), points=st.integers(1, 5))
def test_the_filter_is_the_gaussian_exactly_on_a_straight_path(seed: int, scans: int, points: int) -> None:
    """Also where access points are missing from a scan, and where the person stands still for a while."""
    rng = np.random.default_rng(seed)
    along = np.cumsum(rng.choice([0.0, 0.7, 1.4], scans))
    residual = rng.normal(0, 6, (scans, points))
    heard = rng.random((scans, points)) < 0.7
    heard[:, 0] = True
    index, point = np.nonzero(heard)
    places = np.column_stack([along[index], np.zeros(len(index))])
    expected = log_likelihood(residual[heard], places, point, NOISE)
    assert filtered(residual, along, heard) == pytest.approx(expected, rel=1e-9, abs=1e-8)


def test_standing_still_adds_little() -> None:
    """A hundred scans on one spot tell two places apart hardly better than three do."""
    rng = np.random.default_rng(4)
    error = rng.normal(0, NOISE.white, (100, 4))
    heard = np.ones((100, 4), np.bool_)
    spot = np.zeros(100)
    here, there = error, error + np.array([5.0, -5.0, 5.0, -5.0])
    after_three = filtered(here[:3], spot[:3], heard[:3]) - filtered(there[:3], spot[:3], heard[:3])
    after_all = filtered(here, spot, heard) - filtered(there, spot, heard)
    assert after_all - after_three < 2.0


def test_a_phone_that_hears_everything_weaker_is_forgiven() -> None:
    heard = np.ones((5, 6), np.bool_)
    along = np.arange(5.0)
    common = filtered(np.full((5, 6), -6.0), along, heard)
    mixed = filtered(np.tile([-6.0, 6.0], (5, 3)), along, heard)
    assert common > mixed


def test_path_loss_falls_by_ten_n_per_decade_and_stays_finite_at_the_antenna() -> None:
    model = PathLoss(("a",), np.array([[0.0, 0.0, 1.1]]), np.array([-40.0]), np.array([2.0]))
    level = model.rssi(np.array([[1.0, 0.0], [10.0, 0.0], [0.0, 0.0]]))[:, 0]
    assert level[0] == pytest.approx(-40.0)
    assert level[1] == pytest.approx(-60.0)
    assert np.isfinite(level[2])
