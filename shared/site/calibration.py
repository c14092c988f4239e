"""How good is a calibration from point pairs, and is one of the clicks wrong?

Pure: pairs in, a camera with what it is worth out. A single wrong pair bends the whole fit, so that every residual is
bad and none of them points at it. What does is to leave each pair out in turn: without the wrong one, the others agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.site.camera_geometry import CameraGeometry, GeometryError, LensModel
from shared.site.pose_fit import homography

__all__ = ["MOST_PAIRS", "Calibration", "calibrate"]

Array = NDArray[np.float64]

MOST_PAIRS = 200
FROM = 6
"""Pairs from which on a wrong one can be told: without it, five must disagree where they are not right themselves."""
CLICK = 0.002
"""By how much a careful click is off, share of the picture's diagonal: 1.6 px in 640 x 480."""
AGREE = 0.3
"""Without a wrong pair the others lie better than this share of before, and of what leaving out others brings."""
FLAT = 0.01
"""How far points must spread beside their line, as a share of along it, for that not to be one line."""


@dataclass(frozen=True)
class Calibration:
    """A camera fitted to pairs, and what speaks for it.

    Attributes:
        geometry: the camera.
        used: (n,) whether a pair was used; at most one is not.
        pixels: (n, 2) where the camera shows each plan point; NaN where it does not.
        plan: (n, 2) what floor the camera sees at each pixel, metres; NaN where it sees none.
        off_pixels: (n,) distance of each pair in the picture.
        off_metres: (n,) distance of each pair on the floor.
        alone_metres: (n,) the same by a camera fitted to all others: how well a place nobody clicked is known. NaN
            where the others do not make a camera.
        suspect: the pair that is taken for a wrong click and was left out, or None.
    """

    geometry: CameraGeometry
    used: NDArray[np.bool_]
    pixels: Array
    plan: Array
    off_pixels: Array
    off_metres: Array
    alone_metres: Array
    suspect: int | None


def calibrate(
    image_size: tuple[int, int], image: Array, plan: Array, lens: LensModel | None = None, *, robust: bool = True
) -> Calibration:
    """Fit a camera to pairs, leave out one that is surely wrong, and tell how far off each is.

    Args:
        image_size: width and height, pixels.
        image: (n, 2) pixels, n from 4 to ``MOST_PAIRS``.
        plan: (n, 2) the places on the floor they show, metres.
        lens: where it was calibrated.
        robust: look for a wrong pair; needs ``FROM`` pairs.

    Raises:
        GeometryError: why no camera comes of these pairs, in words for who clicked them; pairs count from 1.
    """
    image = np.asarray(image, float).reshape(-1, 2)
    plan = np.asarray(plan, float).reshape(-1, 2)
    _refuse_degenerate(image, plan)
    alone = _left_out(image_size, image, plan, lens)
    suspect = None
    if robust and len(image) >= FROM:
        suspect = _suspect(image_size, image, plan, lens, alone)
    used = np.ones(len(image), bool)
    if suspect is not None:
        used[suspect] = False
        _refuse_degenerate(image[used], plan[used])
        alone = _left_out(image_size, image, plan, lens, without=suspect)
    geometry = CameraGeometry.fitted(image_size, image[used], plan[used], lens)
    _refuse_impossible(geometry, image, plan, used)
    shown, seen = geometry.to_image(_on_floor(plan)), geometry.to_ground(image)
    return Calibration(
        geometry=geometry,
        used=used,
        pixels=shown,
        plan=seen,
        off_pixels=np.linalg.norm(shown - image, axis=1),
        off_metres=np.linalg.norm(seen - plan, axis=1),
        alone_metres=np.array(
            [
                np.nan if camera is None else float(np.linalg.norm(camera.to_ground(image[[row]])[0] - plan[row]))
                for row, camera in enumerate(alone)
            ]
        ),
        suspect=suspect,
    )


def _left_out(
    image_size: tuple[int, int], image: Array, plan: Array, lens: LensModel | None, without: int | None = None
) -> list[CameraGeometry | None]:
    """For each pair the camera fitted to all others (and never to ``without``), None where they make none."""
    found: list[CameraGeometry | None] = []
    for row in range(len(image)):
        others = np.array([other for other in range(len(image)) if other not in (row, without)], int)
        if len(others) < 4 or _flat(plan[others]) or _flat(image[others]):
            found.append(None)
            continue
        try:
            found.append(CameraGeometry.fitted(image_size, image[others], plan[others], lens, quick=True))
        except GeometryError:
            found.append(None)
    return found


def _suspect(
    image_size: tuple[int, int],
    image: Array,
    plan: Array,
    lens: LensModel | None,
    alone: list[CameraGeometry | None],
) -> int | None:
    """Return the pair without which all others agree as they do without no other, if there is one."""
    click = CLICK * math.hypot(*image_size)
    try:
        together = _rms(CameraGeometry.fitted(image_size, image, plan, lens, quick=True), image, plan)
    except GeometryError:
        together = math.inf
    if together <= click:
        return None
    rest = np.full(len(image), np.inf)
    for row, camera in enumerate(alone):
        if camera is not None and camera.position[2] > 0.0:
            others = np.arange(len(image)) != row
            rest[row] = _rms(camera, image[others], plan[others])
    best = int(np.argmin(rest))
    camera = alone[best]
    if camera is None or not np.isfinite(rest[best]):
        return None
    second = float(np.min(np.delete(rest, best)))
    limit = max(rest[best], click / 3.0)
    own = float(np.linalg.norm(camera.to_image(_on_floor(plan[[best]]))[0] - image[best]))
    if limit < AGREE * together and limit < AGREE * second and not own < 5.0 * limit:
        return best
    return None


def _refuse_degenerate(image: Array, plan: Array) -> None:
    """Refuse pairs that no camera could be fitted to, whatever it is."""
    if len(image) != len(plan):
        raise GeometryError(f"{len(image)} pixels but {len(plan)} places on the plan")
    if not (np.isfinite(image).all() and np.isfinite(plan).all()):
        raise GeometryError("every pixel and every place must be a finite number")
    if len(image) < 4:
        raise GeometryError(f"{len(image)} pairs: at least 4 are needed, and 6 to find out that one is wrong")
    if len(image) > MOST_PAIRS:
        raise GeometryError(f"{len(image)} pairs: at most {MOST_PAIRS} are taken")
    for name, points, near in (("in the picture", image, 0.5), ("on the plan", plan, 0.01)):
        apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.diag(np.full(len(points), np.inf))
        if np.min(apart) < near:
            first, second = sorted(np.unravel_index(int(np.argmin(apart)), apart.shape))
            raise GeometryError(f"pairs {first + 1} and {second + 1} are the same place {name}: take one of them away")
        if _flat(points):
            raise GeometryError(f"all pairs lie on one line {name}: add some to the left and to the right of it")
        for row in range(len(points)):
            if _flat(np.delete(points, row, axis=0)):
                raise GeometryError(
                    f"all pairs but pair {row + 1} lie on one line {name}: add one more beside that line"
                )
    found = homography(plan, image)
    depth = plan @ found[2, :2] + found[2, 2]
    if np.all(depth > 0.0) or np.all(depth < 0.0):
        # Seen from above, the plan (y up) is turned and stretched in the picture (y down), but never mirrored.
        if float(np.linalg.det(found)) * float(np.sign(depth[0])) > 0.0:
            raise GeometryError(
                "the pairs show the floor mirrored: were two of them exchanged, or corners taken the other way round?"
            )
    elif len(image) == 4:
        raise GeometryError(
            "these four pairs put one corner behind the camera: were two of them exchanged? "
            "Every pair must be a place on the floor, below the horizon"
        )


def _refuse_impossible(geometry: CameraGeometry, image: Array, plan: Array, used: NDArray[np.bool_]) -> None:
    """Refuse a fitted camera that cannot be: below the floor, or with pairs where it sees none."""
    rows = np.flatnonzero(used)
    if not geometry.position[2] > 0.0:
        raise GeometryError("no camera above the floor sees these pairs: were two of them exchanged?")
    unseen = rows[~np.isfinite(geometry.to_ground(image[used])).all(axis=1)]
    if len(unseen):
        raise GeometryError(
            f"pair {unseen[0] + 1} lies at or above the horizon, where there is no floor: check it, or take it away"
        )
    off = np.linalg.norm(geometry.to_image(_on_floor(plan[used])) - image[used], axis=1)
    limit = 0.02 * math.hypot(*geometry.image_size)
    if not np.all(off < limit):
        worst = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
        found = f"{off[worst]:.0f} px off" if math.isfinite(off[worst]) else "behind the camera"
        many = "" if len(image) >= FROM else f"; with {FROM} pairs or more a single wrong one is found by itself"
        raise GeometryError(
            f"no camera sees these pairs: pair {rows[worst] + 1} is {found} (at most {limit:.0f} px), though another "
            f"may be the wrong one{many}"
        )


def _rms(camera: CameraGeometry, image: Array, plan: Array) -> float:
    off = np.linalg.norm(camera.to_image(_on_floor(plan)) - image, axis=1)
    return float(np.sqrt(np.mean(off**2))) if np.isfinite(off).all() else math.inf


def _flat(points: Array) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] <= FLAT * spread[0])


def _on_floor(plan: Array) -> Array:
    return np.column_stack([plan, np.zeros(len(plan))])
