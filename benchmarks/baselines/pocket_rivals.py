"""Five other ways to tell the heading of a walker from a phone in the pocket.

After Steinhoff and Schiele (PerCom 2010), as [nonvisual-visual-fusion-dissertation §6.2] describes them: PCA2D, PCA2Df,
PCA3Df, gyroPCA and Rotational. All are given the strides of the method that ships and take its sign rule; the first
sign is given to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.hops import RATE

__all__ = ["RIVALS", "gyro_pca", "pca_2d", "pca_2df", "pca_3df", "rival_headings", "rotational"]

Array = NDArray[np.float64]
Axis = Callable[[Array, Array, Array], Array]

SMOOTHED = int(RATE / 5.0)
"""Samples of the mean filter: 5 Hz."""


def pca_2d(acceleration: Array, rate: Array, attitude: Array) -> Array:
    """Return the first axis (2,) of the horizontal acceleration of one stride; all in world axes, (n, 3)."""
    return _first_axis(acceleration[:, :2])


def pca_2df(acceleration: Array, rate: Array, attitude: Array) -> Array:
    """Return the same after a mean filter."""
    return _first_axis(_smooth(acceleration)[:, :2])


def pca_3df(acceleration: Array, rate: Array, attitude: Array) -> Array:
    """Return the horizontal part of the first axis of all three, after a mean filter."""
    return _first_axis(_smooth(acceleration))[:2]


def gyro_pca(acceleration: Array, rate: Array, attitude: Array) -> Array:
    """Return what is perpendicular to the horizontal part of the first axis of the angular rate."""
    return _across(_first_axis(rate))


def rotational(acceleration: Array, rate: Array, attitude: Array) -> Array:
    """Return what is perpendicular to the axis of the rotation between the extreme attitudes of the thigh."""
    turned = Rotation.from_matrix(attitude)
    one = int((turned * turned[0].inv()).magnitude().argmax())
    two = int((turned * turned[one].inv()).magnitude().argmax())
    return _across((turned[two] * turned[one].inv()).as_rotvec())


RIVALS: dict[str, Axis] = {
    "pca2d": pca_2d,
    "pca2df": pca_2df,
    "pca3df": pca_3df,
    "gyropca": gyro_pca,
    "rotational": rotational,
}


def rival_headings(
    axis: Axis, acceleration: Array, rate: Array, attitude: Array, steps: Array, first_heading: float
) -> Array:
    """Return the heading of each step from the third on, radians clockwise from north.

    Args:
        axis: one of ``RIVALS``.
        acceleration: (n, 3) m/s², phone axes, at ``RATE`` from t = 0.
        rate: (n, 3) rad/s.
        attitude: (n, 3, 3) rotations from the phone's axes to (east, north, up).
        steps: (k,) times of footfalls, s.
        first_heading: true heading of the third step, from which the first sign is taken.
    """
    world = np.einsum("nij,nj->ni", attitude, acceleration)
    turning = np.einsum("nij,nj->ni", attitude, rate)
    headings = np.empty(max(len(steps) - 2, 0))
    ahead: Array | None = None
    for number, (begin, end) in enumerate(zip(steps[:-2], steps[2:], strict=True)):
        rows = slice(round(begin * RATE), max(round(end * RATE), round(begin * RATE) + 4))
        line = axis(world[rows], turning[rows], attitude[rows])
        body = attitude[rows].mean(axis=0)[:2].T @ line
        if ahead is None:
            sign = np.sign(line @ [np.sin(first_heading), np.cos(first_heading)]) or 1.0
            ahead = sign * body
        else:
            sign = -1.0 if body @ ahead < 0.0 else 1.0
            ahead = ahead + (sign * body - ahead) / (number + 1.0)
        headings[number] = np.arctan2(sign * line[0], sign * line[1])
    return headings


def _smooth(values: Array) -> Array:
    smoothed: Array = uniform_filter1d(values, SMOOTHED, axis=0, mode="nearest")
    return smoothed


def _first_axis(values: Array) -> Array:
    axis: Array = np.linalg.eigh(np.cov(values.T))[1][:, -1]
    return axis


def _across(axis: Array) -> Array:
    """Return the horizontal unit vector perpendicular to ``axis`` (3,)."""
    return np.array([-axis[1], axis[0]]) / max(float(np.hypot(axis[0], axis[1])), 1e-9)
