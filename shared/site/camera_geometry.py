"""Which place on the floor does this pixel see? One projective camera with radial distortion.

Three ways in: a Tsai calibration file, pairs of image and plan points, or the pose the camera was mounted in.
Pixels count from the centre of the top-left pixel (0, 0); the plan is metres, z upwards from the camera's own floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy  # its parts are loaded when they are used: all of them would take half of a process's start
from numpy.typing import NDArray

from shared.site.pose_fit import PATIENCE, fit_pose, focal_candidates, focal_guesses

__all__ = ["CameraGeometry", "GeometryError", "LensModel", "straightened"]

Array = NDArray[np.float64]


class GeometryError(ValueError):
    """The calibration cannot be used: the text says why."""


@dataclass(frozen=True)
class LensModel:
    """A lens as a moving checkerboard tells it.

    Attributes:
        focal: fx, fy in pixels.
        centre: principal point, pixels.
        radial: k1, k2: distorted = ideal · (1 + k1 r² + k2 r⁴) in normalised coordinates.
    """

    focal: tuple[float, float]
    centre: tuple[float, float]
    radial: tuple[float, float]


@dataclass(frozen=True)
class CameraGeometry:
    """A calibrated camera over a flat floor.

    Attributes:
        image_size: width and height in pixels.
        focal: fx, fy in pixels.
        centre: principal point, pixels.
        rotation: (3, 3), plan axes to camera axes (x right, y down, z forward).
        translation: (3,), camera = rotation @ plan + translation, metres.
        distortion: κ of Tsai's model in normalised coordinates: undistorted = distorted · (1 + κ r²).
        radial: k1, k2 of a calibrated lens the other way round: distorted = undistorted · (1 + k1 r² + k2 r⁴).
    """

    image_size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    rotation: Array
    translation: Array
    distortion: float = 0.0
    radial: tuple[float, float] = (0.0, 0.0)

    @property
    def position(self) -> Array:
        """Where the camera hangs: (3,), metres."""
        place: Array = -self.rotation.T @ self.translation
        return place

    def to_ground(self, pixels: Array, height: float | Array = 0.0) -> Array:
        """Return the plan positions (n, 2) that ``pixels`` (n, 2) see at ``height`` metres above the floor.

        A pixel that looks at or above the horizon sees no floor: its row is NaN.
        """
        distorted = (np.asarray(pixels, float).reshape(-1, 2) - self.centre) / self.focal
        ideal = straightened(distorted, self.radial)
        ideal = ideal * (1.0 + self.distortion * np.sum(ideal**2, axis=1, keepdims=True))
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ self.rotation
        position = self.position
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (height - position[2]) / rays[:, 2]
        ground: Array = position[:2] + scale[:, None] * rays[:, :2]
        ground[~(np.isfinite(scale) & (scale > 0.0))] = np.nan
        return ground

    def to_image(self, points: Array) -> Array:
        """Return the pixels (n, 2) at which plan points (n, 3) appear; NaN where the camera cannot see."""
        local = np.asarray(points, float).reshape(-1, 3) @ self.rotation.T + self.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal = local[:, :2] / local[:, 2:]
        ideal[local[:, 2] <= 0.0] = np.nan
        return self._distort(ideal) * self.focal + self.centre

    def ground_covariance(self, pixels: Array, pixel_sigma: tuple[float, float], floor_sigma: float) -> Array:
        """Return (n, 2, 2) position covariances, m²: image noise projected to the floor plus isotropic floor noise.

        Args:
            pixels: (n, 2).
            pixel_sigma: standard deviations across and down the image, pixels.
            floor_sigma: standard deviation on the floor, metres.
        """
        jacobian = self.ground_jacobian(pixels)
        spread = jacobian * np.asarray(pixel_sigma, float)
        covariance: Array = spread @ spread.transpose(0, 2, 1) + floor_sigma**2 * np.eye(2)
        return covariance

    def ground_jacobian(self, pixels: Array) -> Array:
        """Return d(plan)/d(pixel), (n, 2, 2) in metres per pixel, by central differences over one pixel."""
        pixels = np.asarray(pixels, float).reshape(-1, 2)
        columns = [self.to_ground(pixels + step) - self.to_ground(pixels - step) for step in 0.5 * np.eye(2)]
        return np.stack(columns, axis=2)

    def scaled_to(self, width: int, height: int) -> CameraGeometry:
        """Return the same camera for a picture delivered at another size (pixel centres at integers)."""
        sx, sy = width / self.image_size[0], height / self.image_size[1]
        return CameraGeometry(
            image_size=(width, height),
            focal=(self.focal[0] * sx, self.focal[1] * sy),
            centre=((self.centre[0] + 0.5) * sx - 0.5, (self.centre[1] + 0.5) * sy - 0.5),
            rotation=self.rotation,
            translation=self.translation,
            distortion=self.distortion,
            radial=self.radial,
        )

    @classmethod
    def from_pose(
        cls,
        image_size: tuple[int, int],
        position: tuple[float, float, float],
        look_at: tuple[float, float, float],
        horizontal_fov: float,
    ) -> CameraGeometry:
        """Return the camera that hangs at ``position`` and has ``look_at`` in the centre of its picture, upright.

        Args:
            image_size: width and height, pixels.
            position: metres, z above the floor.
            look_at: metres.
            horizontal_fov: full angle of view across the picture, radians.
        """
        forward = np.subtract(look_at, position)
        distance = float(np.linalg.norm(forward))
        if distance < 1e-6:
            raise GeometryError("look_at is the camera's own position")
        forward = forward / distance
        # Straight down, "upright" is undefined: the top of the picture then points along the plan's +y.
        straight = math.hypot(forward[0], forward[1]) < 1e-6
        up = np.array([0.0, 1.0, 0.0]) if straight else np.array([0.0, 0.0, 1.0])
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        focal = image_size[0] / 2.0 / math.tan(horizontal_fov / 2.0)
        return cls(
            image_size=image_size,
            focal=(focal, focal),
            centre=_middle(image_size),
            rotation=rotation,
            translation=-rotation @ np.asarray(position, float),
        )

    @classmethod
    def from_points(
        cls, image_size: tuple[int, int], image: Array, plan: Array, lens: LensModel | None = None
    ) -> CameraGeometry:
        """Return the camera that sees floor points ``plan`` (n, 2) at pixels ``image`` (n, 2), n >= 4.

        Without a calibrated ``lens``, square pixels, no distortion and a principal point in the middle of the picture
        are assumed, so that points on the floor alone give the full pose. Distances in the image are minimised.

        Raises:
            GeometryError: fewer than four points, points on one line, or no camera above the floor fits them.
        """
        image = np.asarray(image, float).reshape(-1, 2)
        plan = np.asarray(plan, float).reshape(-1, 2)
        if len(image) != len(plan):
            raise GeometryError(f"{len(image)} image points but {len(plan)} plan points")
        if len(image) < 4:
            raise GeometryError(f"{len(image)} points: at least 4 are needed")
        for name, points in (("image", image), ("plan", plan)):
            spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
            if spread[1] <= 1e-3 * spread[0]:
                raise GeometryError(f"the {name} points lie on one line")
        camera = cls.fitted(image_size, image, plan, lens)
        residual = np.linalg.norm(camera.to_image(np.column_stack([plan, np.zeros(len(plan))])) - image, axis=1)
        limit = 0.02 * math.hypot(*image_size)
        if not np.all(residual < limit) or camera.position[2] <= 0.0:
            worst = int(np.nanargmax(np.where(np.isfinite(residual), residual, np.inf)))
            raise GeometryError(
                f"no camera above the floor sees these points: point {worst} is {residual[worst]:.0f} px off "
                f"(at most {limit:.0f}); check the pairs"
            )
        return camera

    @classmethod
    def fitted(
        cls,
        image_size: tuple[int, int],
        image: Array,
        plan: Array,
        lens: LensModel | None = None,
        *,
        quick: bool = False,
    ) -> CameraGeometry:
        """Return the camera that fits best, however badly; arguments as for ``from_points``.

        ``quick`` is for pairs that either fit or show soon that they do not: one start, a quarter of the patience.

        Raises:
            GeometryError: there is none at all.
        """
        if lens is None:
            centre, radial = _middle(image_size), (0.0, 0.0)
            focals = focal_guesses(plan, image - centre, image_size[0]) if quick else focal_candidates(image_size[0])
            fit = fit_pose(plan, image - centre, focals, patience=PATIENCE // 4 if quick else PATIENCE)
        else:
            centre, radial = lens.centre, lens.radial
            ideal = straightened((image - centre) / lens.focal, radial)
            if not np.isfinite(ideal).all():
                worst = int(np.argmin(np.isfinite(ideal).all(axis=1)))
                raise GeometryError(f"point {worst} lies where the lens sees nothing: is this lens of this camera?")
            middle = math.sqrt(lens.focal[0] * lens.focal[1])
            fit = fit_pose(plan, ideal * middle, [middle], fixed=True)
        if fit is None:
            raise GeometryError("no camera above the floor sees these points: check the pairs")
        focal = (fit.focal, fit.focal) if lens is None else lens.focal
        return cls(image_size, focal, centre, fit.rotation, fit.translation, radial=radial)

    @classmethod
    def from_tsai_file(cls, path: Path) -> CameraGeometry:
        """Return the camera described by a Tsai calibration in XML (millimetres; R = Rz·Ry·Rx).

        Raises:
            GeometryError: the file cannot be read, or lacks an element or attribute.
        """
        try:
            root = ElementTree.parse(path).getroot()  # noqa: S314 (a local calibration file named by the operator)
            geometry, intrinsic, extrinsic = (_numbers(root, tag) for tag in ("Geometry", "Intrinsic", "Extrinsic"))
            focal_mm = intrinsic["focal"]
            angles = [extrinsic[axis] for axis in ("rx", "ry", "rz")]
            rotation = scipy.spatial.transform.Rotation.from_euler("xyz", angles).as_matrix()
            return cls(
                image_size=(int(geometry["width"]), int(geometry["height"])),
                focal=(intrinsic["sx"] * focal_mm / geometry["dpx"], focal_mm / geometry["dpy"]),
                centre=(intrinsic["cx"], intrinsic["cy"]),
                rotation=rotation,
                translation=np.array([extrinsic["tx"], extrinsic["ty"], extrinsic["tz"]]) / 1000.0,
                distortion=intrinsic["kappa1"] * focal_mm**2,
            )
        except OSError as error:
            raise GeometryError(f"{path}: {error.strerror}") from error
        except (ElementTree.ParseError, KeyError, ValueError) as error:
            raise GeometryError(f"{path}: not a Tsai calibration: {error}") from error

    def _distort(self, ideal: Array) -> Array:
        """Return where the lens shows ideal coordinates (n, 2).

        For Tsai's model distorted · (1 + κ r²) = ideal is solved by Newton's method on the radius.
        """
        k1, k2 = self.radial
        if k1 or k2:
            square = np.sum(ideal**2, axis=1, keepdims=True)
            slope = 1.0 + square * (3.0 * k1 + square * 5.0 * k2)
            # Where the polynomial turns back, places far outside of the view would appear in the picture.
            return np.where(slope > 0.0, ideal * (1.0 + square * (k1 + square * k2)), np.nan)
        if self.distortion == 0.0:
            return ideal
        radius = np.linalg.norm(ideal, axis=1)
        solved = radius.copy()
        for _ in range(8):
            slope = 1.0 + 3.0 * self.distortion * solved**2
            solved = solved - (solved * (1.0 + self.distortion * solved**2) - radius) / slope
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(radius > 1e-12, solved / radius, 1.0)
        distorted: Array = ideal * ratio[:, None]
        return distorted


def straightened(distorted: Array, radial: tuple[float, float]) -> Array:
    """Return ideal coordinates (n, 2) of distorted ones; NaN where the lens shows nothing.

    Args:
        distorted: (n, 2), normalised: (pixel - centre) / focal.
        radial: k1, k2 with distorted = ideal · (1 + k1 r² + k2 r⁴); solved by Newton's method on the radius.
    """
    k1, k2 = radial
    if not (k1 or k2):
        return distorted
    radius = np.linalg.norm(distorted, axis=1)
    solved = radius.copy()
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(20):
            square = solved**2
            slope = 1.0 + square * (3.0 * k1 + square * 5.0 * k2)
            solved = solved - (solved * (1.0 + square * (k1 + square * k2)) - radius) / slope
        square = solved**2
        told = np.abs(solved * (1.0 + square * (k1 + square * k2)) - radius) <= 1e-9 * (1.0 + radius)
        told &= (1.0 + square * (3.0 * k1 + square * 5.0 * k2) > 0.0) & (solved >= 0.0)
        ratio = np.where(radius > 1e-12, solved / radius, 1.0)
    ideal: Array = np.where(told[:, None], distorted * ratio[:, None], np.nan)
    return ideal


def _middle(image_size: tuple[int, int]) -> tuple[float, float]:
    return (image_size[0] - 1) / 2.0, (image_size[1] - 1) / 2.0


def _numbers(root: ElementTree.Element, tag: str) -> dict[str, float]:
    element = root.find(tag)
    if element is None:
        raise KeyError(f"element <{tag}> is missing")
    return {name: float(value) for name, value in element.attrib.items()}
