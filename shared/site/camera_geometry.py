"""Which place on the floor does this pixel see? One projective camera with first-order radial distortion.

Three ways in: a Tsai calibration file, pairs of image and plan points, or the pose the camera was mounted in.
Pixels count from the centre of the top-left pixel (0, 0); the plan is metres, z upwards from the camera's own floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

__all__ = ["CameraGeometry", "GeometryError"]

Array = NDArray[np.float64]


class GeometryError(ValueError):
    """The calibration cannot be used: the text says why."""


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
    """

    image_size: tuple[int, int]
    focal: tuple[float, float]
    centre: tuple[float, float]
    rotation: Array
    translation: Array
    distortion: float = 0.0

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
        ideal = distorted * (1.0 + self.distortion * np.sum(distorted**2, axis=1, keepdims=True))
        rays = np.column_stack([ideal, np.ones(len(ideal))]) @ self.rotation
        position = self.position
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (height - position[2]) / rays[:, 2]
        ground: Array = position[:2] + scale[:, None] * rays[:, :2]
        ground[~(np.isfinite(scale) & (scale > 0.0))] = np.nan
        return ground

    def to_image(self, points: Array) -> Array:
        """Return the pixels (n, 2) at which plan points (n, 3) appear; NaN for points behind the camera."""
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
    def from_points(cls, image_size: tuple[int, int], image: Array, plan: Array) -> CameraGeometry:
        """Return the camera that sees floor points ``plan`` (n, 2) at pixels ``image`` (n, 2), n >= 4.

        Square pixels and a principal point in the middle of the picture are assumed, so that points on the floor
        alone give the full pose, and with it how tall a person appears. Distances in the image are minimised.

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
        centre = np.array(_middle(image_size))
        best = None
        for focal in _focal_candidates(image_size):
            try:
                pose = _pose_from_homography(_homography(plan, (image - centre) / focal))
                start = np.concatenate([[math.log(focal)], pose])
                fit = least_squares(
                    _reprojection, start, args=(plan, image, centre), method="lm", x_scale="jac", max_nfev=800
                )
            except (np.linalg.LinAlgError, ValueError):
                continue  # from here the points make no camera; another start may
            if best is None or fit.cost < best.cost:
                best = fit
        if best is None:
            raise GeometryError("no camera above the floor sees these points: check the pairs")
        focal, rotation, translation = _unpack(best.x)
        camera = cls(image_size, (focal, focal), (centre[0], centre[1]), rotation, translation)
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
    def from_tsai_file(cls, path: Path) -> CameraGeometry:
        """Return the camera described by a Tsai calibration in XML (millimetres; R = Rz·Ry·Rx).

        Raises:
            GeometryError: the file cannot be read, or lacks an element or attribute.
        """
        try:
            root = ElementTree.parse(path).getroot()  # noqa: S314 (a local calibration file named by the operator)
            geometry, intrinsic, extrinsic = (_numbers(root, tag) for tag in ("Geometry", "Intrinsic", "Extrinsic"))
            focal_mm = intrinsic["focal"]
            rotation = Rotation.from_euler("xyz", [extrinsic["rx"], extrinsic["ry"], extrinsic["rz"]]).as_matrix()
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
        """Solve distorted · (1 + κ r²) = ideal for the distorted coordinates by Newton's method on the radius."""
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


def _middle(image_size: tuple[int, int]) -> tuple[float, float]:
    return (image_size[0] - 1) / 2.0, (image_size[1] - 1) / 2.0


def _numbers(root: ElementTree.Element, tag: str) -> dict[str, float]:
    element = root.find(tag)
    if element is None:
        raise KeyError(f"element <{tag}> is missing")
    return {name: float(value) for name, value in element.attrib.items()}


def _focal_candidates(image_size: tuple[int, int]) -> list[float]:
    """Start values from a very wide (110 degrees) to a narrow (15 degrees) lens: the fit is not convex in the focal."""
    return [image_size[0] / 2.0 / math.tan(math.radians(fov) / 2.0) for fov in (110, 80, 55, 35, 15)]


def _homography(source: Array, target: Array) -> Array:
    """Direct linear transform with Hartley normalisation: (3, 3) with target ~ H · source."""
    (a, from_source), (b, from_target) = _normalised(source), _normalised(target)
    rows = []
    for (x, y), (u, v) in zip(a, b, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    solution = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    homography: Array = np.linalg.inv(from_target) @ solution @ from_source
    return homography


def _normalised(points: Array) -> tuple[Array, Array]:
    mean = points.mean(axis=0)
    scale = math.sqrt(2.0) / float(np.mean(np.linalg.norm(points - mean, axis=1)))
    transform = np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
    return (points - mean) * scale, transform


def _pose_from_homography(homography: Array) -> Array:
    """Return rotation vector and translation (6,) of the camera whose floor homography this is (unit focal)."""
    columns = homography / math.sqrt(np.linalg.norm(homography[:, 0]) * np.linalg.norm(homography[:, 1]))
    poses = []
    for sign in (1.0, -1.0):
        first, second, translation = (sign * columns).T
        u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        height = (-rotation.T @ translation)[2]
        poses.append((height, np.concatenate([Rotation.from_matrix(rotation).as_rotvec(), translation])))
    # Of the two signs, one puts the points behind the camera; on a plan with z upwards the other hangs above the floor.
    return max(poses, key=lambda pose: pose[0])[1]


def _unpack(parameters: Array) -> tuple[float, Array, Array]:
    rotation = Rotation.from_rotvec(parameters[1:4]).as_matrix()
    return math.exp(parameters[0]), rotation, parameters[4:7]


def _reprojection(parameters: Array, plan: Array, image: Array, centre: Array) -> Array:
    focal, rotation, translation = _unpack(parameters)
    local = np.column_stack([plan, np.zeros(len(plan))]) @ rotation.T + translation
    # A wall at the lens: a point that slips behind the camera costs dearly, where its mirror image would fit.
    depth = np.maximum(local[:, 2:], 1e-3)
    residual: Array = (focal * local[:, :2] / depth + centre - image).ravel()
    return residual
