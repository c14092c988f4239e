"""A track's way and what a phone said meanwhile, put together: a stretch, whoever bore which name."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.phones import PhoneRows
from services.learning.tracks.stretch import SAME, Stretch

__all__ = ["along"]

Array = NDArray[np.float64]


def along(
    device: str,
    phone: PhoneRows,
    track: int,
    t: Array,
    place: Array,
    covariance: Array,
    probability: Array,
    *,
    seen: NDArray[np.bool_] | None = None,
    sight: Array | None = None,
    others: tuple[NDArray[np.int64], Array, Array] | None = None,
) -> Stretch:
    """Return the stretch of a phone along a track; see ``Stretch`` for the columns.

    Args:
        device: id of the phone.
        phone: what it said.
        track: id of the track.
        t: (n,) s.
        place: (n, 2) metres.
        covariance: (n, 2, 2) m².
        probability: (n,) of the name being right.
        seen: (n,) whether a camera saw the track then; None: always.
        sight: (n,) nats by which cameras spoke for the track; None: nobody asked.
        others: ids, times and places of other tracks (``crowd.others_of``); None: nobody was about.
    """
    readings = _between(phone.readings, t, 3)
    steps = _between(phone.steps, t, 7)
    where = np.column_stack([np.interp(readings[:, 0], t, place[:, axis]) for axis in (0, 1)])
    spread = np.sqrt(0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1]))
    ids, times, places = others or (np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0, 2)))
    return Stretch(
        device=device,
        track=track,
        t=t,
        place=place,
        covariance=covariance,
        probability=probability,
        seen=np.ones(len(t), np.bool_) if seen is None else seen,
        sight=np.zeros(len(t)) if sight is None else sight,
        scan_t=readings[:, 0],
        point=readings[:, 1].astype(np.int64),
        level=readings[:, 2],
        scan_place=where,
        scan_spread=np.interp(readings[:, 0], t, spread),
        step_t=steps[:, 0],
        length=steps[:, 1],
        length_variance=steps[:, 2],
        heading=steps[:, 3],
        heading_variance=steps[:, 4],
        walk=steps[:, 5].astype(np.int64),
        still=_between(phone.still, t, 2),
        other=ids,
        other_t=times,
        other_place=places,
        magnetic=steps[:, 6],
    )


def _between(rows: Sequence[tuple[float, ...]], t: Array, columns: int) -> Array:
    """Return the rows (r, columns) of the time of the stretch."""
    during = rows[bisect_left(rows, (t[0] - SAME,)) : bisect_left(rows, (t[-1] + SAME,))]
    return np.array(during, float).reshape(-1, columns)
