"""A detection counts the density it should, and both sums of the two services are made of these terms."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from shared.sight_nats import assigned_nats, missed_nats, off_by


def test_a_detection_counts_its_density_against_clutter() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(0.0, 1.0, (20, 2, 2))
    s = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    x, y = rng.normal(0.0, 1.0, (2, 20))
    squared, log_determinant = off_by(x, y, s[:, 0, 0], s[:, 0, 1], s[:, 1, 1])
    density = [multivariate_normal(cov=one).logpdf(at) for one, at in zip(s, np.column_stack([x, y]), strict=True)]
    found = assigned_nats(squared, log_determinant, 0.9, 0.01)
    np.testing.assert_allclose(found, np.array(density) + np.log(0.9 / 0.01))


def test_a_certain_place_and_a_look_in_vain_are_finite() -> None:
    zero = np.zeros(1)
    assert np.isfinite(assigned_nats(*off_by(zero, zero, zero, zero, zero), 0.9, 1e-4)).all()
    assert missed_nats(0.9) == pytest.approx(np.log(0.1))
