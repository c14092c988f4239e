"""Where is an access point not to be believed for now? A model that is known to be wrong misleads until the next one.

To learn what an access point reads since something changed takes minutes, and to prove it on held-out time some more.
That it does not read what the live model foretells is known before: then its variance grows there by ``DOUBT`` squared,
so that it says nearly nothing, and shrinks again when it reads as foretold after all. Readings that the live model was
not taught from say both, so the nats for it are a trial of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.learning.radio.changes import REACH
from services.learning.radio.shifts import AGREED, Shift, block_means
from shared.radio import RadioModel, ShadowingMap, Visits

__all__ = ["DOUBT", "SURE", "agreement", "believed", "doubted", "doubts", "is_doubted"]

Array = NDArray[np.float64]

DOUBT = 15.0
"""dB by which an access point that is not believed may read otherwise: those that were moved do."""
SURE = 14.0
"""Nats from which it is doubted, and believed again. Where nothing changed for a quarter of an hour, two areas of nine
came to 9, once; access points that were moved to above 20 in two or three minutes."""


def doubts(model: RadioModel, shifts: Sequence[Shift]) -> list[Shift]:
    """Return the shifts for which a live model's access points are to be doubted, the surest first.

    At most half of the access points are doubted at a time: where more seem to have changed, it is something else.
    """
    already = {point for point in range(len(model.path_loss.names)) if is_doubted(model, point)}
    new = sorted((one for one in shifts if one.nats > SURE), key=lambda one: -one.nats)
    new = [one for one in new if not _at(model.shadowing, one).all()]
    room = int(model.path_loss.placed.sum()) // 2 - len(already)
    fresh = [one for one in new if one.point not in already]
    return [one for one in new if one.point in already or one in fresh[: max(room, 0)]]


def doubted(model: RadioModel, shifts: Sequence[Shift]) -> RadioModel:
    """Return the model with access points doubted where they read otherwise; mean and constants stay."""
    variance = model.shadowing.variance.copy()
    for shift in shifts:
        cells = _cells(model.shadowing, shift) & (variance[shift.point] < DOUBT**2)
        variance[shift.point][cells] += DOUBT**2
    return _with_variance(model, variance)


def believed(model: RadioModel, points: Sequence[int]) -> RadioModel:
    """Return the model with some access points believed again."""
    variance = model.shadowing.variance.copy()
    for point in points:
        variance[point][variance[point] >= DOUBT**2] -= DOUBT**2
    return _with_variance(model, variance)


def is_doubted(model: RadioModel, point: int) -> bool:
    """Whether an access point is doubted anywhere."""
    return bool((model.shadowing.variance[point] >= DOUBT**2).any())


def agreement(model: RadioModel, visits: Visits, error: Array, shared: float, point: int) -> float:
    """Return the nats by which readings of a doubted access point speak for believing it again.

    Without those of the phone that says most for it, where there are others: they may not carry it alone.

    Args:
        model: the live one.
        visits: n of the last minutes, none of which taught it.
        error: (n,) heard − foretold by it, the phone's offset taken off, dB.
        shared: standard deviation of what a visit's readings have in common, dB.
        point: which access point.
    """
    variance = model.shadowing.of(visits.place, np.full(len(visits), point))[1]
    mine = (visits.point == point) & (variance >= DOUBT**2)
    if not mine.any():
        return 0.0
    means = block_means(visits.where(mine), error[mine], variance[mine] - DOUBT**2, shared)
    narrow = means.alone + means.map_variance
    wide = narrow + DOUBT**2
    nats = 0.5 * np.log(wide / narrow) - 0.5 * means.off**2 * (1.0 / narrow - 1.0 / wide)
    by_phone = [float(nats[means.device == device].sum()) for device in np.unique(means.device)]
    total = sum(by_phone)
    return total if len(by_phone) > 1 and total - max(by_phone) > AGREED else min(total, 0.0)


def _cells(map_: ShadowingMap, shift: Shift) -> NDArray[np.bool_]:
    """Return which cells (rows, columns) a shift is about."""
    rows, columns = map_.variance.shape[1:]
    if shift.whole:
        return np.ones((rows, columns), bool)
    x = map_.origin[0] + map_.cell * np.arange(columns)
    y = map_.origin[1] + map_.cell * np.arange(rows)
    near = np.zeros((rows, columns), bool)
    for place in shift.places:
        near |= np.hypot(x[None] - place[0], y[:, None] - place[1]) <= REACH
    return near


def _at(map_: ShadowingMap, shift: Shift) -> NDArray[np.bool_]:
    """Return of the blocks (k,) of a shift whether the access point is doubted there."""
    doubtful: NDArray[np.bool_] = map_.of(shift.places, np.full(len(shift.places), shift.point))[1] >= DOUBT**2
    return doubtful


def _with_variance(model: RadioModel, variance: Array) -> RadioModel:
    return dataclasses.replace(model, shadowing=dataclasses.replace(model.shadowing, variance=variance))
