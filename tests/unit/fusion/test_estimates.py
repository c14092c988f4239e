"""Where devices without a track are likely to be, against a device at a time."""

import numpy as np
import pytest
from numpy.typing import NDArray

from services.fusion.evidence.estimates import LEAST_VARIANCE, WORTH, estimates

Array = NDArray[np.float64]


def one_by_one(
    on: Array, places: Array, floor: Array, centres: Array, rest: Array, far: float
) -> tuple[Array, Array, float]:
    some = floor > WORTH * floor.max()
    share = max(1.0 - on.sum(), 0.0) / (floor.sum() + far)
    weight = np.concatenate([on, floor[some] * share])
    spots = np.concatenate([places, centres[some] + rest])
    mean = weight @ spots / weight.sum()
    covariance = np.cov(spots.T, aweights=weight, ddof=0) + LEAST_VARIANCE * np.eye(2)
    return mean, covariance, min(on.sum() + share * floor.sum(), 1.0)


def test_the_batch_agrees_with_a_device_at_a_time() -> None:
    rng = np.random.default_rng(3)
    devices, tracks, cells = 7, 5, 400
    centres = rng.uniform(80.0, 120.0, (cells, 2))
    places = rng.uniform(80.0, 120.0, (tracks, 2))
    floor = rng.gamma(0.1, 1.0, (devices, cells)) * rng.uniform(0.0, 0.01, (devices, 1))
    on = rng.dirichlet(np.ones(tracks + 1), devices)[:, :tracks]
    rest, far = rng.uniform(-0.3, 0.3, (devices, 2)), rng.uniform(0.0, 0.5, devices)
    mean, covariance, about = estimates(on, places, floor, centres, rest, far)
    for row in range(devices):
        expected = one_by_one(on[row], places, floor[row], centres, rest[row], float(far[row]))
        assert mean[row] == pytest.approx(expected[0], abs=1e-9)
        assert covariance[row] == pytest.approx(expected[1], abs=1e-9)
        assert about[row] == pytest.approx(expected[2], abs=1e-12)


def test_between_two_tracks_it_is_the_place_between() -> None:
    mean, covariance, about = estimates(
        np.array([[0.5, 0.5]]),
        np.array([[2.0, 1.0], [6.0, 1.0]]),
        np.zeros((1, 1)),
        np.zeros((1, 2)),
        np.zeros((1, 2)),
        np.ones(1),
    )
    assert mean[0] == pytest.approx([4.0, 1.0])
    assert covariance[0] == pytest.approx(np.diag([4.0 + LEAST_VARIANCE, LEAST_VARIANCE]))
    assert about[0] == pytest.approx(1.0)


def test_no_devices_no_places() -> None:
    mean, covariance, about = estimates(
        np.zeros((0, 2)), np.zeros((2, 2)), np.zeros((0, 3)), np.zeros((3, 2)), np.zeros((0, 2)), np.zeros(0)
    )
    assert mean.shape == (0, 2)
    assert covariance.shape == (0, 2, 2)
    assert about.shape == (0,)
