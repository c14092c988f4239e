"""Pairs without rivals taken at once, the rest by blocks: the same assignment as the whole solved at once."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from services.fusion.positions.assignment import SMALL, assign


def total(cost: np.ndarray, rows: np.ndarray, columns: np.ndarray, dearest: float) -> float:
    return float(cost[rows, columns].sum() + dearest * (min(cost.shape) - len(rows)))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("shape", [(4, 6), (7, 3), (60, 40), (40, 90)])
def test_it_is_as_cheap_as_the_hungarian_method_on_everything(seed: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    tracks, found = rng.uniform(0, 30, (shape[0], 2)), rng.uniform(0, 30, (shape[1], 2))
    cost = ((tracks[:, None] - found[None]) ** 2).sum(axis=2) - 2.0
    assert (shape[0] * shape[1] > SMALL) == (shape[0] > 10)
    rows, columns = assign(cost, 9.0)
    assert len(set(rows.tolist())) == len(rows)
    assert len(set(columns.tolist())) == len(columns)
    assert (cost[rows, columns] < 9.0).all()
    whole = np.minimum(cost, 9.0)
    assert total(cost, rows, columns, 9.0) == pytest.approx(whole[linear_sum_assignment(whole)].sum())


def test_nothing_is_paired_that_costs_too_much() -> None:
    rows, columns = assign(np.full((40, 40), 5.0), 5.0)
    assert len(rows) == len(columns) == 0
