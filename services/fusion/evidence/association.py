"""Which device is on which track, and how sure is that? Marginals and the best assignment, one device per track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

__all__ = ["assign", "association_marginals"]

Array = NDArray[np.float64]

NEVER = -1e6


def association_marginals(log_odds: Array, rounds: int = 20) -> Array:
    """Return the probability (d, k) that device i is on track j, by loopy belief propagation.

    At most one device is on a track and a device is on at most one track. The fixed point exists and is reached fast
    (Williams and Lau, "Approximate evaluation of marginal association probabilities with belief propagation", 2014).

    Args:
        log_odds: (d, k), of "device i is on track j" against "device i is on no track", each pair taken by itself.
        rounds: message passes; each halves the error or better.
    """
    if not log_odds.size:
        return np.zeros(log_odds.shape)
    # Divided by each row's best, so that nothing overflows; "on no track" is divided with it.
    best = np.maximum(log_odds.max(axis=1, keepdims=True), 0.0)
    weight, none = np.exp(log_odds - best), np.exp(-best)
    to_device = np.ones_like(weight)
    for _ in range(rounds):
        claim = weight * to_device
        # Sums without the own entry, guarded against rounding below zero.
        rest = np.maximum(none + claim.sum(axis=1, keepdims=True) - claim, 1e-300)
        to_track = weight / rest
        to_device = 1.0 / np.maximum(1.0 + to_track.sum(axis=0, keepdims=True) - to_track, 1e-300)
    claim = weight * to_device
    marginals: Array = claim / (none + claim.sum(axis=1, keepdims=True))
    return marginals


def assign(
    probability: Array, holds: NDArray[np.bool_], claim: float | Array, keep: float, loyalty: float = 1.0
) -> NDArray[np.int64]:
    """Return for each device its track or −1 ("not sure"): the likeliest one-to-one assignment, with hysteresis.

    Args:
        probability: (d, k), marginals.
        holds: (d, k), which track each device held so far.
        claim: scalar or (d,), probability from which a device gets a track it did not hold; above 1 it gets none.
        keep: probability down to which it keeps the one it held.
        loyalty: added to the log-probability of what is held, so that near ties do not flicker.
    """
    devices = probability.shape[0]
    given = np.full(devices, -1, np.int64)
    if not probability.size:
        return given
    allowed = probability >= np.where(holds, keep, np.broadcast_to(claim, devices)[:, None])
    gain = np.where(allowed, np.log(np.maximum(probability, 1e-12)) - np.log(1e-6) + loyalty * holds, 0.0)
    rows, columns = linear_sum_assignment(-gain)
    good = allowed[rows, columns]
    given[rows[good]] = columns[good]
    return given
