"""What does this visitor look at? Every exhibit they may see, with its probability, the most probable first.

What is known is a place, how surely, and which way they walked last. Who walks looks ahead. Who stands has turned
towards something near, and nobody was told which way: what the walk says fades with the time stood. So an exhibit
weighs by how people stand before exhibits (near, and before its front) times how its direction agrees with the walk,
each blurred by how surely the place is known; the weights, with that of nothing at all, are normed to 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.site import FloorPlan

__all__ = ["BEHIND", "InFront", "Visitor", "in_front"]

Floats = NDArray[np.float64]

HANGS = 0.3
"""Metres before an exhibit at which sight ends: what hangs on a wall is not behind it."""
BEHIND = np.radians(100.0)
"""How far off its front somebody may stand to whom an exhibit still shows it."""
STANDS = 1.0
"""Metres, standard deviation along either axis: where people stand about what they look at."""
AHEAD = np.radians(50.0)
"""Standard deviation of where somebody looks about the way they walk."""
BEFORE = np.radians(50.0)
"""Standard deviation of where people stand about the front of an exhibit."""
TURNS = 0.5
"""Seconds of standing after which the walk tells 1/e of what it told."""
NOTHING = 0.05
"""What it weighs that somebody looks at no exhibit; an exhibit at their feet weighs 1."""


@dataclass(frozen=True)
class Visitor:
    """What is known of one.

    Attributes:
        place: metres.
        sigma: standard deviation of it, metres.
        heading: which way they walked last, radians counter-clockwise from +x; None: nobody knows.
        stood: seconds since.
    """

    place: tuple[float, float]
    sigma: float = 0.0
    heading: float | None = None
    stood: float = 0.0


@dataclass(frozen=True)
class InFront:
    """What may be looked at, the most probable first.

    Attributes:
        exhibit: (k,) indices.
        distance: (k,) metres.
        bearing: (k,) radians left of the heading; nan: unknown.
        probability: (k,) of its being what they look at; with that of nothing, they add up to 1.
    """

    exhibit: NDArray[np.int64]
    distance: Floats
    bearing: Floats
    probability: Floats


def in_front(
    visitor: Visitor, field_of_view: float, exhibits: Floats, reach: Floats, facing: Floats, plan: FloorPlan
) -> InFront:
    """Return which exhibits somebody may be looking at: within reach, in view, not behind a wall or turned away.

    Args:
        visitor: who.
        field_of_view: radians about the heading of who walks; it widens to all round as the walk fades. Where the place
            is known to ``sigma``, it is wider for what is near by the angle under which ``sigma`` is seen from there.
        exhibits: (n, 2) places, metres.
        reach: (n,) metres from which each is looked at.
        facing: (n,) radians where the front of each looks; nan: it has no back.
        plan: whose walls block the view.
    """
    away = exhibits - np.asarray(visitor.place)
    distance = np.hypot(away[:, 0], away[:, 1])
    direction = np.arctan2(away[:, 1], away[:, 0])
    blur = np.where(distance < HANGS, np.pi, np.arctan2(visitor.sigma, distance))
    bearing = np.full(len(exhibits), np.nan)
    spread = STANDS**2 + visitor.sigma**2
    weight = STANDS**2 / spread * np.exp(-(distance**2) / (2.0 * spread))
    seen = distance <= reach
    if visitor.heading is not None:
        walked = np.exp(-visitor.stood / TURNS)
        bearing = _turn(direction - visitor.heading)
        half = field_of_view / 2.0 + np.pi * (1.0 - walked)
        seen &= np.abs(bearing) <= half + blur
        weight = weight * (1.0 - walked + walked * _likelier(bearing, AHEAD, blur))
    fronted = np.isfinite(facing)
    off = _turn(direction + np.pi - np.where(fronted, facing, 0.0))
    seen &= ~fronted | (np.abs(off) <= BEHIND + blur)
    weight = weight * np.where(fronted, _likelier(off, BEFORE, blur), 1.0)
    share = np.maximum(0.0, 1.0 - HANGS / np.maximum(distance, HANGS))[:, None]
    (found,) = np.nonzero(seen)
    start = np.broadcast_to(np.asarray(visitor.place, dtype=float), (len(found), 2))
    found = found[plan.walls_crossed(start, start + share[found] * away[found]) == 0]
    probability = weight[found] / (NOTHING + weight[found].sum())
    order = np.lexsort((distance[found], -probability))
    found = found[order]
    return InFront(found, distance[found], bearing[found], probability[order])


def _likelier(angle: Floats, sigma: float, blur: Floats) -> Floats:
    """Return how much likelier an angle is, (n,), about zero with ``sigma`` radians than where all are alike.

    ``blur`` is by how much the angle itself is not known.
    """
    spread = np.hypot(sigma, blur)
    # The normal density, of which the part within half a turn counts, so that a wide one comes out even.
    cut = np.linspace(-np.pi, np.pi, 73)
    norm = np.exp(-0.5 * (cut[None, :] / spread[:, None]) ** 2).mean(axis=1)
    return np.asarray(np.exp(-0.5 * (angle / spread) ** 2) / norm)


def _turn(angle: Floats) -> Floats:
    """Return the same directions between -π and π."""
    turned: Floats = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return turned
