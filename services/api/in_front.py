"""What is in front of this visitor? Exhibits within reach, in the field of view, not behind a wall, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.site import FloorPlan

__all__ = ["InFront", "in_front"]

Floats = NDArray[np.float64]

HANGS = 0.3
"""Metres before an exhibit at which sight ends: what hangs on a wall is not behind it."""
BEHIND = np.radians(100.0)
"""How far off its front somebody may stand to whom an exhibit still shows it."""


@dataclass(frozen=True)
class InFront:
    """What is seen, nearest first: (k,) indices of exhibits, metres, and radians left of the heading (nan: unknown)."""

    exhibit: NDArray[np.int64]
    distance: Floats
    bearing: Floats


def in_front(
    place: tuple[float, float],
    sigma: float,
    heading: float | None,
    field_of_view: float,
    exhibits: Floats,
    reach: Floats,
    facing: Floats,
    plan: FloorPlan,
) -> InFront:
    """Return which exhibits somebody looks at.

    Where the place is only known to ``sigma``, so is the direction of what is near: the field of view is wider for it
    by the angle under which ``sigma`` is seen from there; of what is at arm's length direction says nothing.

    Args:
        place: of the visitor, metres.
        sigma: standard deviation of it, metres.
        heading: where they look, radians counter-clockwise from +x; None: nobody knows, and all directions count.
        field_of_view: radians, the whole of it.
        exhibits: (n, 2) places, metres.
        reach: (n,) metres from which each is looked at.
        facing: (n,) radians where the front of each looks; nan: it has no back.
        plan: whose walls block the view.
    """
    away = exhibits - np.asarray(place)
    distance = np.hypot(away[:, 0], away[:, 1])
    direction = np.arctan2(away[:, 1], away[:, 0])
    seen = distance <= reach
    blur = np.where(distance < HANGS, np.pi, np.arctan2(sigma, distance))
    bearing = np.full(len(exhibits), np.nan)
    if heading is not None:
        bearing = _turn(direction - heading)
        seen &= (np.abs(bearing) <= field_of_view / 2.0 + blur) | (field_of_view >= 2.0 * np.pi)
    with np.errstate(invalid="ignore"):
        seen &= np.isnan(facing) | (np.abs(_turn(direction + np.pi - facing)) <= BEHIND + blur)
    (found,) = np.nonzero(seen)
    share = np.maximum(0.0, 1.0 - HANGS / np.maximum(distance[found], HANGS))[:, None]
    start = np.broadcast_to(np.asarray(place, dtype=float), (len(found), 2))
    found = found[plan.walls_crossed(start, start + share * away[found]) == 0]
    found = found[np.argsort(distance[found], kind="stable")]
    return InFront(found, distance[found], bearing[found])


def _turn(angle: Floats) -> Floats:
    """Return the same directions between -π and π."""
    turned: Floats = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return turned
