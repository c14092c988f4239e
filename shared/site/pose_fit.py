"""Which camera sees these places on the floor at these pixels? The fit behind every calibration from point pairs.

Square pixels and a principal point in the middle of the picture are assumed where the lens was not calibrated, so that
points on the floor alone give the full pose, and with it how tall a person appears. Distances in the image are
minimised (Levenberg-Marquardt from direct linear transforms [Hartley & Zisserman, Multiple View Geometry, §4.1, §7.2]).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

__all__ = ["PoseFit", "fit_pose", "focal_candidates", "focal_guesses", "homography"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseFit:
    """A camera over the floor.

    Attributes:
        focal: pixels.
        rotation: (3, 3), plan axes to camera axes.
        translation: (3,), metres.
        cost: half the sum of squared distances in the image, pixels².
    """

    focal: float
    rotation: Array
    translation: Array
    cost: float


PATIENCE = 800
"""Evaluations of one fit, those of its derivatives included."""


def fit_pose(
    plan: Array, image: Array, focals: Sequence[float], *, fixed: bool = False, patience: int = PATIENCE
) -> PoseFit | None:
    """Return the camera that sees floor points ``plan`` at ``image`` best, or None if none can be found.

    Args:
        plan: (n, 2) metres, n >= 4, not on one line.
        image: (n, 2) undistorted pixels, counted from the principal point.
        focals: focal lengths to begin with, pixels; the fit is not convex in them.
        fixed: whether the focal length is known; the first of ``focals`` is it.
        patience: evaluations after which a fit that still improves is taken as it is.
    """
    best: tuple[float, Array, float] | None = None
    for focal in focals[:1] if fixed else focals:
        try:
            pose = _pose_from_homography(homography(plan, image / focal))
            start = pose if fixed else np.concatenate([pose, [math.log(focal)]])
            known = focal if fixed else None
            fit = scipy.optimize.least_squares(
                _reprojection, start, args=(plan, image, known), method="lm", x_scale="jac", max_nfev=patience
            )
        except (np.linalg.LinAlgError, ValueError):
            continue  # from here the points make no camera; another start may
        if best is None or fit.cost < best[0]:
            best = float(fit.cost), fit.x, focal if fixed else math.exp(fit.x[6])
    if best is None:
        return None
    cost, parameters, focal = best
    return PoseFit(
        focal, scipy.spatial.transform.Rotation.from_rotvec(parameters[:3]).as_matrix(), parameters[3:6], cost
    )


def focal_candidates(width: int) -> list[float]:
    """Return start values, pixels, from a very wide (110 degrees) to a narrow (15 degrees) lens."""
    return [width / 2.0 / math.tan(math.radians(fov) / 2.0) for fov in (110, 80, 55, 35, 15)]


def focal_guesses(plan: Array, image: Array, width: int) -> list[float]:
    """Return start values from the floor's homography alone, for pairs that are nearly right.

    The plan's axes are at right angles and of one scale [Hartley & Zisserman, §8.8]: two equations for one unknown.

    Args:
        plan: (n, 2) metres.
        image: (n, 2) pixels from the principal point.
        width: of the picture, pixels.
    """
    (a, b), (c, d), (e, f) = homography(plan, image)[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = np.array([-(a * b + c * d) / (e * f), (a * a + c * c - b * b - d * d) / (f * f - e * e)])
    least, most = (width / 2.0 / math.tan(math.radians(fov) / 2.0) for fov in (120, 10))
    told = np.sqrt(squares[np.isfinite(squares) & (squares > 0.0)])
    told = told[(told > least) & (told < most)]
    usual = focal_candidates(width)[2]
    return [float(np.median(told))] if len(told) else [usual]


def homography(source: Array, target: Array) -> Array:
    """Direct linear transform with Hartley normalisation: (3, 3) with target ~ H · source."""
    (a, from_source), (b, from_target) = _normalised(source), _normalised(target)
    rows = []
    for (x, y), (u, v) in zip(a, b, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    solution = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    found: Array = np.linalg.inv(from_target) @ solution @ from_source
    return found


def _normalised(points: Array) -> tuple[Array, Array]:
    mean = points.mean(axis=0)
    scale = math.sqrt(2.0) / float(np.mean(np.linalg.norm(points - mean, axis=1)))
    transform = np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
    return (points - mean) * scale, transform


def _pose_from_homography(found: Array) -> Array:
    """Return rotation vector and translation (6,) of the camera whose floor homography this is (unit focal)."""
    columns = found / math.sqrt(np.linalg.norm(found[:, 0]) * np.linalg.norm(found[:, 1]))
    poses = []
    for sign in (1.0, -1.0):
        first, second, translation = (sign * columns).T
        u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        height = (-rotation.T @ translation)[2]
        poses.append(
            (height, np.concatenate([scipy.spatial.transform.Rotation.from_matrix(rotation).as_rotvec(), translation]))
        )
    # Of the two signs, one puts the points behind the camera; on a plan with z upwards the other hangs above the floor.
    return max(poses, key=lambda pose: pose[0])[1]


def _reprojection(parameters: Array, plan: Array, image: Array, focal: float | None) -> Array:
    focal = math.exp(parameters[6]) if focal is None else focal
    rotation = scipy.spatial.transform.Rotation.from_rotvec(parameters[:3]).as_matrix()
    local = plan @ rotation[:, :2].T + parameters[3:6]
    # A wall at the lens: a point that slips behind the camera costs dearly, where its mirror image would fit.
    depth = np.maximum(local[:, 2:], 1e-3)
    residual: Array = (focal * local[:, :2] / depth - image).ravel()
    return residual
