"""Marginals against full enumeration; assignments that do not flicker."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.fusion.evidence.association import assign, association_marginals
from services.fusion.evidence.identity_settings import IdentitySettings


def enumerated(log_odds: np.ndarray) -> np.ndarray:
    """Sum over every way to put devices on tracks."""
    devices, tracks = log_odds.shape
    weight = np.zeros(log_odds.shape)
    total = 0.0
    for choice in itertools.product(range(-1, tracks), repeat=devices):
        taken = [track for track in choice if track >= 0]
        if len(taken) != len(set(taken)):
            continue
        value = math.exp(sum(log_odds[device, track] for device, track in enumerate(choice) if track >= 0))
        total += value
        for device, track in enumerate(choice):
            if track >= 0:
                weight[device, track] += value
    return weight / total


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32), devices=st.integers(1, 6), tracks=st.integers(1, 6), size=st.floats(0.1, 4.0))
def test_marginals_are_shares(seed: int, devices: int, tracks: int, size: float) -> None:
    found = association_marginals(np.random.default_rng(seed).normal(0, size, (devices, tracks)))
    assert (found >= 0.0).all()
    assert (found.sum(axis=1) <= 1.0 + 1e-9).all()
    assert (found.sum(axis=0) <= 1.0 + 1e-3).all()


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**32), others=st.integers(1, 6), size=st.floats(0.1, 4.0), one_device=st.booleans())
def test_marginals_are_exact_where_there_is_no_loop(seed: int, others: int, size: float, one_device: bool) -> None:
    """One device or one track: the graph is a tree, on which belief propagation is exact."""
    shape = (1, others) if one_device else (others, 1)
    log_odds = np.random.default_rng(seed).normal(0, size, shape)
    assert association_marginals(log_odds) == pytest.approx(enumerated(log_odds), abs=1e-6)


def test_marginals_are_close_to_enumeration() -> None:
    """With loops they are an approximation: good on the whole, off by a tenth or two where odds conflict strongly."""
    errors = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        log_odds = rng.normal(0, rng.uniform(0.1, 4.0), (rng.integers(2, 5), rng.integers(2, 5)))
        errors.append(np.abs(association_marginals(log_odds) - enumerated(log_odds)).max())
    assert np.median(errors) < 0.03
    assert np.percentile(errors, 95) < 0.12


def test_extreme_odds_stay_finite() -> None:
    found = association_marginals(np.array([[700.0, -700.0], [-700.0, 700.0], [0.0, 0.0]]))
    assert np.isfinite(found).all()
    assert found[0, 0] == pytest.approx(1.0)


def test_two_phones_of_one_person_share_the_doubt() -> None:
    found = association_marginals(np.array([[5.0], [5.0]]))
    assert found[0, 0] == pytest.approx(found[1, 0])
    assert found[0, 0] <= 0.5


def test_a_device_needs_more_to_claim_than_to_keep() -> None:
    probability = np.array([[0.3, 0.3]])
    nothing, second = np.array([[False, False]]), np.array([[False, True]])
    assert assign(probability, nothing, 0.4, 0.2).tolist() == [-1]
    assert assign(probability, second, 0.4, 0.2).tolist() == [1]


def test_no_track_is_given_twice() -> None:
    probability = np.array([[0.5, 0.45], [0.48, 0.02]])
    given_ = assign(probability, np.zeros((2, 2), np.bool_), 0.4, 0.2)
    assert sorted(given_.tolist()) == [0, 1]


def test_nothing_to_assign_is_fine() -> None:
    assert assign(np.zeros((2, 0)), np.zeros((2, 0), np.bool_), 0.4, 0.2).tolist() == [-1, -1]
    assert association_marginals(np.zeros((0, 3))).shape == (0, 3)


def test_a_name_as_likely_wrong_as_right_is_not_told_even_to_who_bore_it() -> None:
    """Two companions whom one phone fits alike: not sure; nor do the default thresholds let the old name stand."""
    shipped, nobody = IdentitySettings(), np.zeros((1, 2), bool)
    alike = association_marginals(np.array([[4.0, 4.0]]))
    for holds in (nobody, np.array([[True, False]])):
        assert assign(alike, holds, shipped.claim, shipped.keep).tolist() == [-1]
    better = association_marginals(np.array([[4.0, 3.0]]))
    assert assign(better, nobody, shipped.claim, shipped.keep).tolist() == [0]
