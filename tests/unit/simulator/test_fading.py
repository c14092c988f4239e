"""The law of fading people and ghosts: monotone in what it should be, and kept from tick to tick."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.simulator.cameras.fading import FITTED, Imprints, imprint_after

RATES = st.floats(0.001, 1.0)
SECONDS = st.floats(0.0, 2000.0)


@given(RATES, SECONDS, SECONDS)
def test_who_stands_longer_is_seen_less_and_leaves_the_surer_ghost(rate: float, first: float, second: float) -> None:
    short, long_ = sorted((first, second))
    brief, lasting = imprint_after(rate, short), imprint_after(rate, long_)
    assert FITTED.visible(lasting, rate) <= FITTED.visible(brief, rate) + 1e-12
    assert FITTED.ghostly(lasting) >= FITTED.ghostly(brief) - 1e-12
    assert 0.0 <= FITTED.visible(lasting, rate) <= 1.0 + 1e-12
    assert FITTED.visible(np.zeros(()), rate) == pytest.approx(1.0)


@given(SECONDS, RATES, RATES)
def test_a_faster_background_never_forgets_later(seconds: float, first: float, second: float) -> None:
    slow, fast = sorted((first, second))
    seen_slowly = FITTED.visible(imprint_after(slow, seconds), slow)
    assert FITTED.visible(imprint_after(fast, seconds), fast) <= seen_slowly + 1e-9


def test_ticks_add_up_to_the_law_and_ghosts_decay_by_it() -> None:
    rate, tick = 0.05, 0.5
    imprints = Imprints(2, rate, FITTED)
    here = np.array([[1.0, 1.0], [np.nan, np.nan]])
    for k in range(121):
        imprints.step(here, 1000.0 + k * tick, tick)
    assert imprints.imprint[0] == pytest.approx(1.0 - math.exp(-rate * 60.0))
    assert imprints.imprint[1] == 0.0
    away = np.array([[2.0, 1.0], [np.nan, np.nan]])
    imprints.step(away, 1060.5, tick)
    assert imprints.imprint[0] == 0.0
    assert imprints.ghost.tolist() == [[1.0, 1.0]]
    left = imprints.ghost_imprint[0]
    for k in range(6):
        imprints.step(away, 1061.0 + k * tick, tick)
    assert imprints.ghost_imprint[0] == pytest.approx(left * math.exp(-rate * 3.0))
    for k in range(200):
        imprints.step(away, 1064.0 + k * tick, tick)
    assert [1.0, 1.0] not in imprints.ghost.tolist()


def test_small_shifts_of_weight_do_not_count_as_moving() -> None:
    imprints = Imprints(1, 0.1, FITTED)
    for k in range(100):
        imprints.step(np.array([[3.0 + 0.1 * math.sin(k), 2.0]]), 500.0 + 0.5 * k, 0.5)
    assert imprints.imprint[0] > 0.98


def test_a_young_background_takes_people_in_at_once() -> None:
    young, old = Imprints(1, 0.01, FITTED), Imprints(1, 0.01, FITTED)
    for k in range(21):
        young.step(np.array([[0.0, 0.0]]), 0.5 * k, 0.5)
        old.step(np.array([[0.0, 0.0]]), 1000.0 + 0.5 * k, 0.5)
    assert young.imprint[0] > 0.7 > 0.2 > old.imprint[0]


def test_a_background_that_learns_nothing_fades_nobody() -> None:
    imprints = Imprints(1, 0.0, FITTED)
    for k in range(100):
        imprints.step(np.zeros((1, 2)), 0.5 * k, 0.5)
    assert imprints.imprint[0] == 0.0
