"""Which detection belongs to which track? The cheapest one-to-one assignment, unambiguous pairs first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

__all__ = ["assign"]

Integers = NDArray[np.int64]

SMALL = 1000
"""Pairs up to which it takes longer to look for unambiguous ones than to solve the whole."""


def assign(cost: NDArray[np.float64], dearest: float) -> tuple[Integers, Integers]:
    """Return rows and columns of the pairs whose costs are least in sum, leaving one unpaired at ``dearest``.

    Pairs that have no rival in either row or column are taken at once, the others by the Hungarian method on the rows
    and columns that are left: in a crowd these are far fewer than all.

    Args:
        cost: (n, m); pairs that cost ``dearest`` or more are never taken.
        dearest: see above.
    """
    if cost.size <= SMALL:
        rows, columns = linear_sum_assignment(np.minimum(cost, dearest))
        taken = cost[rows, columns] < dearest
        return rows[taken], columns[taken]
    possible = cost < dearest
    per_row, per_column = possible.sum(axis=1), possible.sum(axis=0)
    rows, columns = np.nonzero(possible)
    alone = (per_row[rows] == 1) & (per_column[columns] == 1)
    if alone.all():
        return rows, columns
    contested = ~alone
    open_rows = np.bincount(rows[contested], minlength=len(cost)).nonzero()[0]
    open_columns = np.bincount(columns[contested], minlength=cost.shape[1]).nonzero()[0]
    block = np.minimum(cost[np.ix_(open_rows, open_columns)], dearest)
    first, second = linear_sum_assignment(block)
    taken = block[first, second] < dearest
    return (
        np.concatenate([rows[alone], open_rows[first[taken]]]),
        np.concatenate([columns[alone], open_columns[second[taken]]]),
    )
