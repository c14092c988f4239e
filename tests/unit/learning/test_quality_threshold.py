"""The threshold separates right names from wrong ones, whatever their shares; where all are wrong nothing passes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from services.learning.tracks.threshold import REFUSED, Threshold


def _filled(right: float, seed: int = 0, gap: float = 3.0) -> Threshold:
    rng = np.random.default_rng(seed)
    threshold = Threshold(-5.0)
    for _ in range(300):
        own = rng.normal(gap if rng.random() < right else 0.0, 1.0)
        threshold.add(own, rng.normal(0.0, 1.0))
    return threshold


@pytest.mark.parametrize("right", [0.3, 0.6, 0.9])
def test_few_wrong_ones_pass_and_most_right_ones_do(right: float) -> None:
    value = _filled(right).value
    rng = np.random.default_rng(1)
    wrong, good = rng.normal(0.0, 1.0, 4000) >= value, rng.normal(3.0, 1.0, 4000) >= value
    among = (1.0 - right) * wrong.mean() / ((1.0 - right) * wrong.mean() + right * good.mean())
    assert among < 0.2
    assert good.mean() > 0.75


def test_where_other_checks_refuse_most_wrong_names_more_right_ones_pass() -> None:
    rng = np.random.default_rng(2)
    plain, checked = Threshold(-5.0), Threshold(-5.0)
    for _ in range(40):
        own, other = rng.normal(1.0, 1.0), rng.normal(0.5, 1.5)
        plain.add(own, other)
        checked.add(own if rng.random() < 0.8 else REFUSED, other if rng.random() < 0.2 else REFUSED)
    assert math.isinf(plain.value)
    assert math.isfinite(checked.value)
    assert checked.value > REFUSED


def test_where_every_name_is_wrong_nothing_passes() -> None:
    assert all(math.isinf(_filled(0.0, seed).value) for seed in range(5))


def test_before_enough_is_known_the_first_threshold_stands() -> None:
    threshold = Threshold(0.4)
    for _ in range(10):
        threshold.add(-1.0, 1.0)
    assert threshold.value == 0.4
    alone = Threshold(0.4)
    for _ in range(100):
        alone.add(1.0, None)
    assert alone.value == 0.4


def test_only_the_last_scores_count_and_a_state_goes_on() -> None:
    threshold = _filled(0.0)
    rng = np.random.default_rng(2)
    for _ in range(300):
        threshold.add(rng.normal(3.0, 1.0), rng.normal(0.0, 1.0))
    assert math.isfinite(threshold.value)
    again = Threshold(-5.0)
    again.restore(threshold.state())
    assert again.value == threshold.value
