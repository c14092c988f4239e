"""How is the phone turned? Gyroscope at once, gravity and compass by and by [self-calibrating-rss-thesis §3.2].

Also the thesis' Euler angles: α about z, β about x, γ about y, in this order; α is 0 where the phone's top points to
magnetic north and **grows counter-clockwise**.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.angles import unit
from services.gateway.reckoning.hops import RATE, Array, Hops, State

__all__ = [
    "EARTH_FIELD",
    "ComplementaryFilter",
    "angles",
    "cosine_matrix",
    "measured_angles",
    "trusted_field",
    "turned_since",
]

EARTH_FIELD = (15.0, 80.0)
"""µT; outside it the field is not the Earth's and the compass is left out."""

GRAVITY = 9.81


def cosine_matrix(angles: Array) -> Array:
    """Return the rotations (..., 3, 3) from the phone to (east, north, up) for (..., 3) α, β, γ, rad (Eq. 3.13)."""
    sa, sb, sc = np.moveaxis(np.sin(angles), -1, 0)
    ca, cb, cc = np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        np.stack([ca * cc - sa * sb * sc, -sa * cb, ca * sc + sa * sb * cc], axis=-1),
        np.stack([sa * cc + ca * sb * sc, ca * cb, sa * sc - ca * sb * cc], axis=-1),
        np.stack([-cb * sc, sb, cb * cc], axis=-1),
    ]
    return np.stack(rows, axis=-2)


def angles(matrix: Array) -> Array:
    """Return α, β, γ (..., 3) rad of rotations (..., 3, 3) from the phone to (east, north, up) (Eqs. 3.18-3.20)."""
    alpha = np.arctan2(-matrix[..., 0, 1], matrix[..., 1, 1])
    beta = np.arcsin(np.clip(matrix[..., 2, 1], -1.0, 1.0))
    gamma = np.arctan2(-matrix[..., 2, 0], matrix[..., 2, 2])
    return np.stack([alpha, beta, gamma], axis=-1)


def measured_angles(acceleration: Array, field: Array) -> Array:
    """Return α, β, γ (..., 3) rad that gravity (..., 3) and the magnetic field (..., 3) tell (Eqs. 3.5-3.7)."""
    ax, ay, az = np.moveaxis(acceleration, -1, 0)
    mx, my, mz = np.moveaxis(field, -1, 0)
    beta, gamma = np.arctan2(ay, np.hypot(ax, az)), np.arctan2(-ax, az)
    sb, cb, sc, cc = np.sin(beta), np.cos(beta), np.sin(gamma), np.cos(gamma)
    alpha = np.arctan2(mx * cc + mz * sc, mx * sb * sc + my * cb - mz * sb * cc)
    return np.stack([alpha, beta, gamma], axis=-1)


class ComplementaryFilter:
    """The blend H ← ς H G + (1 - ς) H_measured of Eqs. 3.14-3.17, a hop at a time.

    With R the gyroscope's rotation since the hop began and H = B R, the blend is B ← ς B + (1 - ς) H_measured Rᵀ: a
    linear recursion, the same for each entry, that a cumulative sum solves for all samples of all phones. Three things
    differ from the thesis: R is the exact rotation and not the first order of it; the matrix is made orthonormal where
    it leaves the filter and not in between, which comes to the same while measurements agree; and the row that points
    up has a time constant of its own.

    While little has been measured the blend is the plain mean of it.

    Args:
        level_tau: s, with which gravity draws the upward row; ς = τ / (τ + dt).
        compass_tau: s, with which the compass draws the other two, unless there is no gyroscope: then it is
            ``level_tau``, for nothing else tells a turn. The thesis has 0.98 s for both. Once bias
            and iron are taken away 1 to 30 s are within a standard error of each other on the mall's traces; on the
            twin 5 and 15 s are the best.
    """

    STATE = np.dtype([("north", np.float64, (3,)), ("up", np.float64, (3,))])
    """The rows of H in the phone's axes, each as long as what it has seen weighs, at most about 1."""

    def __init__(self, level_tau: float = 0.98, compass_tau: float = 15.0) -> None:
        self._level = level_tau / (level_tau + 1.0 / RATE)
        self._compass = compass_tau / (compass_tau + 1.0 / RATE)

    def advance(self, state: State, hops: Hops, rate: Array) -> Array:
        """Take one hop of each of p phones; see ``Attitude``."""
        turned = turned_since(rate)
        measured = hops.measured()
        down_to_earth = np.einsum("pnij,pnj->pni", turned, hops.acceleration) / GRAVITY
        state["up"][~state["up"].any(axis=1)] = [0.0, 0.0, 1e-6]  # a phone that falls must be turned some way too
        up = _blend(state["up"], down_to_earth, measured, np.array(self._level))
        vertical = unit(up)
        _seed(state["north"], vertical[:, 0])
        field = np.einsum("pnij,pnj->pni", turned, np.where(np.isnan(hops.field), 0.0, hops.field))
        use = measured & trusted_field(hops.field)
        keep = np.where(hops.rotation.any(axis=(1, 2)), self._compass, self._level)[:, None]
        north = _blend(state["north"], unit(_level(field, vertical)), use, keep)
        axes = np.empty((*north.shape, 3))
        axes[:, :, 2] = vertical
        axes[:, :, 1] = unit(_level(north, vertical))
        axes[:, :, 0] = np.cross(axes[:, :, 1], vertical)
        state["up"] = np.einsum("pi,pij->pj", up[:, -1], turned[:, -1])
        state["north"] = np.einsum("pi,pij->pj", north[:, -1], turned[:, -1])
        attitude: Array = axes @ turned
        return attitude


def trusted_field(field: Array) -> NDArray[np.bool_]:
    """Return where (..., 3) µT may be the Earth's field (bool): not missing and of its strength."""
    strength = np.einsum("...i,...i->...", field, field)
    trusted: NDArray[np.bool_] = (strength > EARTH_FIELD[0] ** 2) & (strength < EARTH_FIELD[1] ** 2)
    return trusted


def turned_since(rate: Array) -> Array:
    """Return the rotations (p, HOP, 3, 3) that ``rate`` (p, HOP, 3) rad/s makes since before the hop, by doubling."""
    shape = rate.shape
    turned = Rotation.from_rotvec(rate.reshape(-1, 3) / RATE).as_matrix().reshape(*shape, 3)
    reach = 1
    while reach < shape[1]:
        turned[:, reach:] = turned[:, :-reach] @ turned[:, reach:]
        reach *= 2
    return turned


def _blend(before: Array, value: Array, use: NDArray[np.bool_], keep: Array) -> Array:
    """Return b[n] = keep b[n-1] + (1 - keep) value[n] where ``use``, else b[n-1]; (p, n, 3), ``before`` (p, 3).

    ``keep`` is (p, 1) or one number.
    """
    kept = np.cumprod(np.where(use, keep, 1.0), axis=1)[:, :, None]
    gained = np.cumsum(((1.0 - keep) * use)[:, :, None] * value / kept, axis=1)
    blended: Array = kept * (before[:, None] + gained)
    return blended


def _seed(north: Array, vertical: Array) -> None:
    """Let north be where the phone's top points (its back, if held upright) while no compass has told, in place."""
    blind = ~north.any(axis=1)
    if blind.any():
        up = vertical[blind]
        ahead = np.where(np.abs(up[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[0.0, 0.0, -1.0]])
        north[blind] = 1e-6 * unit(_level(ahead, up))


def _level(vectors: Array, vertical: Array) -> Array:
    """Return the vectors (..., 3) without what is along the unit vectors ``vertical``."""
    level: Array = vectors - np.einsum("...i,...i->...", vectors, vertical)[..., None] * vertical
    return level
