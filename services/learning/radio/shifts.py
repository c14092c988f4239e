"""Does an access point read otherwise than it did? The last minutes against what was learned before, as a ratio.

Readings share errors: with their visit, with the map about the place, with the phone. So they are averaged over blocks
of the floor before they are weighed, a block's error is at least the map's, and what one phone alone tells is not
believed where others could have told it too: it may be the phone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radio import Visits

__all__ = ["AGREED", "BlockMeans", "Shift", "block_means", "find_shifts"]

Array = NDArray[np.float64]

BLOCK = 3.0
"""Metres: about as far as shadowing and the way somebody faces last."""
ONSETS = (60.0, 90.0, 120.0, 180.0, 240.0, 300.0)
"""Seconds ago at which something may have changed."""
SIZES = np.array([size for step in range(3, 22) for size in (float(step), -float(step))])
"""dB by which it may read otherwise."""
FREE = 2.0
"""Nats that it costs each block to be in the lee of something or not."""
SUSPECT, SUSPECTED = 6.0, 3.0
"""Nats from which a shift is worth a trial, and without the phone that says most."""
ENOUGH = 9.0
"""Nats from which it is believed; of nine areas of the twin in which nothing changed for a quarter of an hour, two came
to so much, once."""
AGREED = 5.0
"""Nats that remain without the phone that says most."""
KNOWN = 12.0
"""dB²; where what was foretold is less sure, nothing can be told to have changed."""
CHUNK = 30.0
"""Seconds for which a phone's readings are judged together."""
HALF = 0.5
PATIENCE = 170.0
"""Seconds."""
WHOLE = 0.7
"""Share of blocks from which it is the access point that changed and not something on the way."""


@dataclass(frozen=True)
class Shift:
    """An access point reads otherwise.

    Attributes:
        point: which.
        by: dB.
        since: seconds since the epoch, roughly.
        nats: for it.
        places: (k, 2) middles of the blocks where it does, metres.
        whole: whether that is nearly everywhere.
        phones: how many say so.
    """

    point: int
    by: float
    since: float
    nats: float
    places: Array
    whole: bool
    phones: int


def find_shifts(
    visits: Visits,
    error: Array,
    unknown: Array,
    shared: float,
    before: Visits,
    now: float,
    *,
    early: bool = False,
) -> list[Shift]:
    """Return the access points that read otherwise, at most one shift each.

    Whether it is the access point or something on the way shows once people walked in half of where they were before;
    so long, but no longer than ``PATIENCE``, what reads otherwise wherever they walked is not told.

    Args:
        visits: n of the last minutes, none of which taught what ``error`` is about.
        error: (n,) heard − foretold, the phone's offset taken off, dB.
        unknown: (n,) variance of what was foretold, dB².
        shared: standard deviation of what a visit's readings have in common, dB.
        before: those that taught it.
        now: seconds since the epoch.
        early: tell also what is only suspected, and as soon as it is; for models that are tried before they are used.
    """
    enough, agreed = (SUSPECT, SUSPECTED) if early else (ENOUGH, AGREED)
    found = []
    known = unknown < KNOWN
    visits, error, unknown = visits.where(known), error[known], unknown[known]
    unknown = unknown + _mistrust(visits, error, unknown + shared**2 + 1.0 / visits.weight)
    for point in np.unique(visits.point).tolist():
        shifts = [
            shift
            for onset in ONSETS
            if (shift := _shift(visits, error, unknown, shared, point, now - onset, enough, agreed)) is not None
        ]
        if not shifts:
            continue
        best = max(shifts, key=lambda shift: shift.nats)
        seen = _blocks(visits, point, best.since) / max(_blocks(before, point, -np.inf), 1)
        if best.whole and seen < HALF and not early:
            if now - best.since < PATIENCE:
                continue
            best = dataclasses.replace(best, whole=False)
        found.append(best)
    return found


def _blocks(visits: Visits, point: int, since: float) -> int:
    """Return in how many blocks an access point was heard."""
    mine = (visits.point == point) & (visits.t > since)
    return len(np.unique(np.floor(visits.place[mine] / BLOCK), axis=0))


def _mistrust(visits: Visits, error: Array, variance: Array) -> Array:
    """Return the variance, (n,) dB², to add where a phone's readings of most access points fit badly for a while.

    Then it is not an access point that changed: the name was wrong, or the phone lies.
    """
    chunk = np.unique(np.column_stack([visits.device, visits.t // CHUNK]), axis=0, return_inverse=True)[1].ravel()
    more = np.zeros(len(error))
    for one in range(int(chunk.max(initial=-1)) + 1):
        mine = np.flatnonzero(chunk == one)
        usual = float(np.median(variance[mine]))
        more[mine] = max(float(np.median(error[mine] ** 2)) / 0.455 - usual, 0.0)
    return more


@dataclass(frozen=True)
class BlockMeans:
    """What p pairs of a block and a phone read beyond what was foretold, on average.

    Attributes:
        off: (p,) dB.
        alone: (p,) variance of that without the map's, dB².
        map_variance: (p,) dB².
        device: (p,) which phone.
        block: (p,) which of ``blocks``, (b, 2), in numbers of blocks from the plan's zero.
        blocks: see above.
    """

    off: Array
    alone: Array
    map_variance: Array
    device: NDArray[np.int64]
    block: NDArray[np.int64]
    blocks: NDArray[np.int64]


def block_means(visits: Visits, error: Array, unknown: Array, shared: float) -> BlockMeans:
    """Return means over blocks and phones of n visits, n > 0; arguments as of ``find_shifts``."""
    spots = np.floor(visits.place / BLOCK).astype(np.int64)
    pairs, pair = np.unique(np.column_stack([spots, visits.device]), axis=0, return_inverse=True)
    pair = pair.ravel()
    total = np.bincount(pair, visits.weight)
    blocks, block = np.unique(pairs[:, :2], axis=0, return_inverse=True)
    return BlockMeans(
        off=np.bincount(pair, visits.weight * error) / total,
        alone=1.0 / total + shared**2,
        map_variance=np.bincount(pair, visits.weight * unknown) / total,
        device=pairs[:, 2],
        block=block.ravel(),
        blocks=blocks,
    )


def _shift(
    visits: Visits, error: Array, unknown: Array, shared: float, point: int, since: float, enough: float, agreed: float
) -> Shift | None:
    mine = (visits.point == point) & (visits.t > since)
    if mine.sum() < 6:
        return None
    means = block_means(visits.where(mine), error[mine], unknown[mine], shared)
    off, alone, map_variance, who, block = means.off, means.alone, means.map_variance, means.device, means.block
    best = _best(off, alone, map_variance, block)
    if best is None or best[0] < enough:
        return None
    nats, size, chosen = best
    hit = chosen[block]
    phones = np.unique(who)
    gains = {
        phone: float(((off * size - 0.5 * size**2) / (alone + map_variance))[hit & (who == phone)].sum())
        for phone in phones.tolist()
    }
    loudest = max(gains, key=lambda phone: gains[phone])
    others = hit & (who != loudest)
    rest = sum(gain for phone, gain in gains.items() if phone != loudest)
    if not others.any() or rest < agreed:
        return None
    middles = (means.blocks[np.unique(block[hit])] + 0.5) * BLOCK
    by = float(np.sum(off[hit] / (alone + map_variance)[hit]) / np.sum(1.0 / (alone + map_variance)[hit]))
    agreeing = sum(gain > 1.0 for gain in gains.values())
    return Shift(point, by, since, nats, middles, bool(chosen.mean() >= WHOLE), agreeing)


def _best(off: Array, alone: Array, map_variance: Array, block: NDArray[np.int64]) -> tuple[float, float, Array] | None:
    """Return nats, dB and which blocks (b,) of the shift that explains most."""
    precision = np.bincount(block, 1.0 / alone)
    level = np.bincount(block, off / alone) / precision
    variance = 1.0 / precision + np.bincount(block, map_variance) / np.bincount(block)
    nats = (level[None] * SIZES[:, None] - 0.5 * SIZES[:, None] ** 2) / variance[None]
    everywhere, somewhere = nats.sum(axis=1), np.maximum(nats - FREE, 0.0).sum(axis=1)
    total = np.maximum(everywhere, somewhere)
    row = int(np.argmax(total))
    chosen = nats[row] > (FREE if somewhere[row] > everywhere[row] else 0.0)
    if not chosen.any():
        return None
    return float(total[row]), float(SIZES[row]), chosen
