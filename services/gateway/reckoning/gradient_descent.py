"""How is the phone turned? The gradient-descent MARG filter [nonvisual-visual-fusion-dissertation §2.2; Madgwick 2011].

The alternative to the complementary filter: one gain for gravity and compass alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.angles import unit
from services.gateway.reckoning.complementary import ComplementaryFilter, trusted_field
from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State

__all__ = ["GradientDescentFilter"]


class GradientDescentFilter:
    """A quaternion carried by the gyroscope and drawn a step of fixed length down the gradient of what it misses.

    The gradient is of the squared distance between the directions of gravity and field that are measured and those
    that the quaternion foretells; the foretold field has the measured one's dip, so that dip and iron overhead tilt
    nothing. Where the field cannot be the Earth's, gravity alone draws. The complementary filter tells where the first
    hop begins: the gradient finds its way from anywhere, but at 0.04 rad/s takes a minute.

    Args:
        beta: rad/s, by which the gradient draws.
    """

    STATE = np.dtype([("quaternion", np.float64, (4,))])
    """(w, x, y, z) from the phone's axes to (magnetic north, west, up)."""

    def __init__(self, beta: float = 0.04) -> None:
        self._beta = beta
        self._start = ComplementaryFilter()

    def advance(self, state: State, hops: Hops, rate: Array) -> Array:
        """Take one hop of each of p phones; see ``Attitude``."""
        q = state["quaternion"]
        new = ~q.any(axis=1)
        if new.any():
            q[new] = self._first(hops, rate)[new]
        gravity = unit(hops.acceleration)
        trusted = trusted_field(hops.field)
        field = unit(np.where(trusted[..., None], hops.field, [0.0, 0.0, 1.0]))
        measured = hops.measured()
        path = np.empty((*rate.shape[:2], 4))
        for n in range(HOP):
            miss = _gradient(q, gravity[:, n], field[:, n], trusted[:, n])
            drawn = self._beta * unit(miss) * measured[:, n, None]
            q = unit(q + (0.5 * _times_vector(q, rate[:, n]) - drawn) / RATE)
            path[:, n] = q
        state["quaternion"] = q
        return _to_east_north_up(path)

    def _first(self, hops: Hops, rate: Array) -> Array:
        """Return quaternions (p, 4) at the beginning of a hop, from all of it."""
        start = np.zeros(len(hops.t), self._start.STATE)
        east, north, up = np.moveaxis(self._start.advance(start, hops, rate)[:, 0], 1, 0)
        return _quaternion(np.stack([north, -east, up], axis=1))


def _gradient(q: Array, gravity: Array, field: Array, trusted: NDArray[np.bool_]) -> Array:
    """Return Jᵀ F (p, 4) for unit quaternions (p, 4) and measured unit vectors (p, 3)."""
    w, x, y, z = q.T
    # What is measured, turned to (north, west, up); b has its dip and points north.
    h = _rotate(q, field)
    bx, bz = np.hypot(h[:, 0], h[:, 1]), h[:, 2]
    fx = 2.0 * (x * z - w * y) - gravity[:, 0]
    fy = 2.0 * (w * x + y * z) - gravity[:, 1]
    fz = 1.0 - 2.0 * (x * x + y * y) - gravity[:, 2]
    mx = trusted * (bx * (1.0 - 2.0 * (y * y + z * z)) + 2.0 * bz * (x * z - w * y) - field[:, 0])
    my = trusted * (2.0 * bx * (x * y - w * z) + 2.0 * bz * (w * x + y * z) - field[:, 1])
    mz = trusted * (2.0 * bx * (w * y + x * z) + bz * (1.0 - 2.0 * (x * x + y * y)) - field[:, 2])
    return 2.0 * np.stack(
        [
            -y * fx + x * fy - bz * y * mx + (bz * x - bx * z) * my + bx * y * mz,
            z * fx + w * fy - 2.0 * x * fz + bz * z * mx + (bx * y + bz * w) * my + (bx * z - 2.0 * bz * x) * mz,
            -w * fx
            + z * fy
            - 2.0 * y * fz
            - (2.0 * bx * y + bz * w) * mx
            + (bx * x + bz * z) * my
            + (bx * w - 2.0 * bz * y) * mz,
            x * fx + y * fy + (bz * x - 2.0 * bx * z) * mx + (bz * y - bx * w) * my + bx * x * mz,
        ],
        axis=1,
    )


def _times_vector(q: Array, v: Array) -> Array:
    """Return q (0, v) for (p, 4) and (p, 3)."""
    w, x, y, z = q.T
    a, b, c = v.T
    return np.stack(
        [-x * a - y * b - z * c, w * a + y * c - z * b, w * b - x * c + z * a, w * c + x * b - y * a], axis=1
    )


def _rotate(q: Array, v: Array) -> Array:
    """Return q (0, v) q* for (p, 4) and (p, 3)."""
    axis = q[:, 1:]
    aside = 2.0 * np.cross(axis, v)
    turned: Array = v + q[:, :1] * aside + np.cross(axis, aside)
    return turned


def _to_east_north_up(q: Array) -> Array:
    """Return the rotations (..., 3, 3) from the phone to (east, north, up) of quaternions to (north, west, up)."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    north = np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)], axis=-1)
    west = np.stack([2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)], axis=-1)
    up = np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=-1)
    return np.stack([-west, north, up], axis=-2)


def _quaternion(matrix: Array) -> Array:
    """Return (p, 4) w, x, y, z of rotations (p, 3, 3)."""
    from_scipy: Array = Rotation.from_matrix(matrix).as_quat()
    return np.roll(from_scipy, 1, axis=1)
