"""Where people, walls and obstacles push a walker in one prediction: social and contact forces [ravel-thesis §7]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.fusion.forces.obstacles import REACH, Obstacles
from services.fusion.forces.walls import stay_walkable

__all__ = ["ForceSettings", "displacement"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class ForceSettings:
    """The strengths of the forces; the defaults are the published ones [ravel-thesis §7]."""

    mass: float = 70.0
    """kg."""
    radius: float = 0.2
    """Metres, of a person."""
    push: float = 50.0
    """Newtons at touch: a."""
    range: float = 0.5
    """Metres in which the push falls to 1/e: b."""
    behind: float = 0.5
    """How much of the push what lies behind has: lambda of eq. 4.9."""
    contact: float = 250.0
    """N/m of overlap with an obstacle: c."""
    people_contact: float = 0.0
    """N/m of overlap with another person; the study has none."""
    dt: float = 1.0
    """Seconds of a prediction."""
    substeps: int = 4
    """Into which a prediction is cut, so that obstacles are felt on the way and no thin wall is jumped."""


def displacement(
    positions: Array,
    alive: NDArray[np.bool_],
    heading: Array,
    obstacles: Obstacles,
    settings: ForceSettings,
    walk: Array | None = None,
) -> tuple[Array, Array]:
    """Return how far forces shift the predictions of X people in each of N particles, and the Jacobian.

    The prediction is ``positions + walk + shift`` [eq. 4.12]. People push once, from where the step begins; obstacles
    and walls push all along the way, in ``substeps`` equal parts, and no part goes through a wall.

    Args:
        positions: (N, X, 2) metres.
        alive: (N, X) who is there; the others neither push nor move.
        heading: (N, X) radians, where people want to go; NaN where that is not known: all sides count alike.
        obstacles: what stands there.
        settings: strengths and time.
        walk: (N, X, 2) metres, what steps say of the motion in ``dt``; None for people who stand.

    Returns:
        (N, X, 2) metres, zero where nobody is alive, and (N, X, 2, 2) the derivative of the prediction by the position
        (the identity where nothing pushes), everybody else held in place and walls not stopping anybody: a stop is no
        reason to be surer of a place [eq. 4.13].
    """
    particles, people = alive.shape
    rows = np.flatnonzero(alive.ravel())
    start = positions.reshape(-1, 2)[rows]
    steps = np.zeros_like(start) if walk is None else walk.reshape(-1, 2)[rows]
    towards = _unit(heading.ravel()[rows])
    particle = rows // people if people else rows
    scale = 0.5 * settings.dt**2 / settings.mass
    pushed, turned = _people(start, particle, towards, settings)
    at, jacobian = start, np.broadcast_to(np.eye(2), (len(rows), 2, 2)).copy()
    for _ in range(settings.substeps):
        force, slope = _obstacles(at, towards, obstacles, settings)
        move = (steps + scale * (pushed + force)) / settings.substeps
        jacobian = jacobian + scale / settings.substeps * (turned + slope @ jacobian)
        at = stay_walkable(at, at + move, obstacles)
    shift = np.zeros((particles * people, 2))
    slopes = np.broadcast_to(np.eye(2), (particles * people, 2, 2)).copy()
    shift[rows], slopes[rows] = at - start - steps, jacobian
    return shift.reshape(particles, people, 2), slopes.reshape(particles, people, 2, 2)


def _people(start: Array, particle: Indices, towards: Array, settings: ForceSettings) -> tuple[Array, Array]:
    """Return (n, 2) forces and (n, 2, 2) their derivatives, of everybody in the same particle."""
    one, other = _neighbours(start, particle)
    apart = start[one] - start[other]
    distance = np.linalg.norm(apart, axis=1)
    away = apart / np.maximum(distance, 1e-9)[:, None]
    touch = np.full(len(one), 2.0 * settings.radius)
    bends = np.ones(len(one), np.bool_)
    return _summed(one, away, distance, touch, bends, settings.people_contact, towards, settings)


def _obstacles(at: Array, towards: Array, obstacles: Obstacles, settings: ForceSettings) -> tuple[Array, Array]:
    """Return (n, 2) forces and (n, 2, 2) their derivatives, of what stands there."""
    near = obstacles.near(at)
    touch = settings.radius + near.radius
    return _summed(near.place, near.away, near.distance, touch, near.round, settings.contact, towards, settings)


def _summed(
    place: Indices,
    away: Array,
    distance: Array,
    touch: Array,
    bends: NDArray[np.bool_],
    contact: float,
    towards: Array,
    settings: ForceSettings,
) -> tuple[Array, Array]:
    """Sum what m pairs do to n people [eqs 4.7-4.11 and the sheet's Jacobian].

    Args:
        place: (m,) who is pushed.
        away: (m, 2) unit vectors n.
        distance: (m,) d, metres.
        touch: (m,) r, the sum of radii, metres.
        bends: (m,) whether n turns with the place.
        contact: N/m.
        towards: (n, 2) unit vectors of where people want to go, zero where unknown.
        settings: the other strengths.
    """
    wish = towards[place]
    ahead = -np.einsum("mi,mi->m", away, wish)
    gamma = settings.behind + (1.0 - settings.behind) * 0.5 * (1.0 + ahead)
    push = settings.push * np.exp((touch - distance) / settings.range)
    overlap = np.maximum(touch - distance, 0.0)
    force = (push * gamma + contact * overlap)[:, None] * away
    # Nearer than a body's radius the direction is anybody's guess: there it turns no faster than at that radius.
    turning = np.where(bends, 1.0 / np.copysign(np.maximum(np.abs(distance), settings.radius), distance), 0.0)
    normal = away[:, :, None] * away[:, None, :]
    across = np.eye(2) - normal
    sideways = np.einsum("mij,mj->mi", across, wish)
    steep = -push * gamma / settings.range - contact * (overlap > 0.0)
    slope = steep[:, None, None] * normal + ((push * gamma + contact * overlap) * turning)[:, None, None] * across
    slope -= (push * (1.0 - settings.behind) * 0.5 * turning)[:, None, None] * away[:, :, None] * sideways[:, None, :]
    count = len(towards)
    total, slopes = np.zeros((count, 2)), np.zeros((count, 2, 2))
    for i in (0, 1):
        total[:, i] = np.bincount(place, force[:, i], count)
        for j in (0, 1):
            slopes[:, i, j] = np.bincount(place, slope[:, i, j], count)
    return total, slopes


def _neighbours(start: Array, particle: Indices) -> tuple[Indices, Indices]:
    """Return both of every ordered pair within reach in one particle; ``particle`` (n,) is sorted."""
    ones, others = [], []
    number = np.arange(len(start))
    # Everybody against who comes k places later in the list: as many passes as the fullest particle has people.
    most = int(np.bincount(particle).max(initial=0)) if len(particle) else 0
    for later in range(1, most):
        first, second = number[:-later], number[later:]
        apart = start[first] - start[second]
        near = (particle[first] == particle[second]) & (np.einsum("ni,ni->n", apart, apart) <= REACH**2)
        ones.append(first[near])
        others.append(second[near])
    if not ones:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    one, other = np.concatenate(ones), np.concatenate(others)
    return np.concatenate([one, other]), np.concatenate([other, one])


def _unit(heading: Array) -> Array:
    """Return (n, 2) unit vectors, zero where the heading is NaN."""
    known = np.isfinite(heading)
    angle = np.where(known, heading, 0.0)
    return np.where(known[:, None], np.column_stack([np.cos(angle), np.sin(angle)]), 0.0)
