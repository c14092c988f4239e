"""Who is hidden from a camera by whom, by what, and by the edge of the picture? Bodies as cylinders, in true geometry.

Each body is a dozen points (legs, hips, chest, head; left, middle, right). A point is hidden where the ray from the
camera to it passes through a nearer body, or under the top of an obstacle or a wall on its way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from shared.site import CameraGeometry, Floor

__all__ = ["BODY_RADIUS", "LEGS", "Silhouettes", "StaticView", "hidden_by_others", "project_bodies"]

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

BODY_RADIUS = 0.22
"""Metres: half as wide as a person with arms."""
_LEVELS = np.repeat([0.1, 0.4, 0.7, 0.95], 3)  # shares of the height
_SIDES = np.tile([-0.15, 0.0, 0.15], 4)  # metres across the line of sight
LEGS = _LEVELS < 0.5
"""Which of the points of a body belong to its lower half, (12,)."""
_POINTS = len(_LEVELS)
_ASIDE = np.concatenate([_SIDES, BODY_RADIUS * np.array([-1.0, 1.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0, 0.0])])
_ALONG = np.concatenate([np.zeros(_POINTS), BODY_RADIUS * np.array([0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])])
_HEIGHTS = np.concatenate([_LEVELS, [0.0, 0.0, 0.0, 0.85, 0.85, 0.85, 1.0, 0.5, 0.0]])
"""Of the points whose projection is asked for: shoulders are wider than the crown, the outline's rim ends there."""
_PIECE = 1000
"""Bodies that are worked on at a time."""
_CELLS = 20_000
"""At most so many places on the floor know what hides them."""


@dataclass(frozen=True, slots=True)
class Silhouettes:
    """Bodies in the picture; leading axes are those of the positions.

    Attributes:
        points: (…, 12, 3) of each body, metres on the plan.
        inside: (…, 12) whether the point falls into the picture.
        foot: (…, 2) pixel of the middle between the feet.
        waist: (…, 2) pixel of the body's middle.
        box: (…, 4) left, top, right, bottom of the body, pixels; NaN where it is not before the camera.
    """

    points: Array
    inside: Bools
    foot: Array
    waist: Array
    box: Array


def project_bodies(geometry: CameraGeometry, position: Array, tall: Array, there: Bools | None = None) -> Silhouettes:
    """Return how bodies at ``position`` (…, 2), ``tall`` (…) metres, appear; only where they are ``there`` (…)."""
    if there is not None:
        place, high = position[there], tall[there]
        # In pieces that fit the processor's cache: several times faster in a crowd.
        pieces = [
            project_bodies(geometry, place[k : k + _PIECE], high[k : k + _PIECE])
            for k in range(0, max(len(place), 1), _PIECE)
        ]
        return Silhouettes(*(_spread([getattr(p, name) for p in pieces], there) for name in Silhouettes.__slots__))
    shape = tall.shape
    sight = position - geometry.position[:2]
    sight = sight / np.maximum(np.linalg.norm(sight, axis=-1, keepdims=True), 1e-9)
    aside = np.stack([-sight[..., 1], sight[..., 0]], axis=-1)
    # The body's points, then its outline (both sides below and above, the nearest of the feet, the farthest of the
    # shoulders, the crown), then waist and foot.
    points = np.empty((*shape, _POINTS + 9, 3))
    points[..., :2] = (
        position[..., None, :] + _ASIDE[:, None] * aside[..., None, :] + _ALONG[:, None] * sight[..., None, :]
    )
    points[..., 2] = tall[..., None] * _HEIGHTS
    pixels = geometry.to_image(points.reshape(-1, 3)).reshape(*shape, _POINTS + 9, 2)
    body, outline = pixels[..., :_POINTS, :], pixels[..., _POINTS : _POINTS + 7, :]
    width, height = geometry.image_size
    with np.errstate(invalid="ignore"):
        inside = (body >= -0.5).all(axis=-1) & (body[..., 0] <= width - 0.5) & (body[..., 1] <= height - 0.5)
    box = np.concatenate([outline.min(axis=-2), outline.max(axis=-2)], axis=-1)
    return Silhouettes(points[..., :_POINTS, :], inside, pixels[..., -1, :], pixels[..., -2, :], box)


def _spread(pieces: Sequence[NDArray[Any]], there: Bools) -> NDArray[Any]:
    """Return the values of those who are there at their places among all; nothing known of the others."""
    values = np.concatenate(pieces)
    if there.all():
        return values.reshape(*there.shape, *values.shape[1:])
    empty = np.full((*there.shape, *values.shape[1:]), False if values.dtype == bool else np.nan)
    empty[there] = values
    return empty


def hidden_by_others(
    eye: Array, bodies: Silhouettes, position: Array, tall: Array, frame: Ints, one: Ints, other: Ints
) -> Bools:
    """Return which points (n, c, 12) of bodies are hidden by nearer bodies.

    Args:
        eye: (3,) where the camera hangs.
        bodies: of c columns in n frames.
        position: (n, c, 2) of their feet.
        tall: (c,) metres.
        frame: (m,) frames of the pairs that may hide each other: their boxes overlap.
        one: (m,) columns of one of the pair.
        other: (m,) columns of the other.
    """
    hidden = np.zeros(bodies.inside.shape, bool)
    if not frame.size:
        return hidden
    reach = np.linalg.norm(position - eye[:2], axis=-1)
    swap = reach[frame, one] > reach[frame, other]
    near, far = np.where(swap, other, one), np.where(swap, one, other)
    for k in range(0, len(frame), _PIECE):
        rows, covers, covered = frame[k : k + _PIECE], near[k : k + _PIECE], far[k : k + _PIECE]
        middle = position[rows, covers] - eye[:2]
        lost = _behind(eye, bodies.points[rows, covered], middle, tall[covers])
        row, column = np.nonzero(lost)
        hidden[rows[row], covered[row], column] = True
    return hidden


def _behind(eye: Array, point: Array, middle: Array, tall: Array) -> Bools:
    """Whether rays to points (m, 12, 3) pass through cylinders at ``middle`` (m, 2) from the eye, ``tall`` (m,)."""
    x, y = point[..., 0] - eye[0], point[..., 1] - eye[1]
    length = np.maximum(np.hypot(x, y), 1e-6)
    x, y = x / length, y / length
    cx, cy = middle[:, 0, None], middle[:, 1, None]
    along = cx * x + cy * y
    squared = BODY_RADIUS**2 - (cx * y - cy * x) ** 2
    half = np.sqrt(np.maximum(squared, 0.0))
    fall = (eye[2] - point[..., 2]) / length
    # The ray is lowest where it leaves the cylinder; where it rises (a camera below the heads), where it enters.
    lowest = np.where(fall > 0.0, np.minimum(along + half, length), np.maximum(along - half, 0.0))
    behind: Bools = (squared > 0.0) & (along > 0.0) & (along < length) & (eye[2] - fall * lowest < tall[:, None])
    return behind


class StaticView:
    """What obstacles and walls hide of people on one floor, for one camera: computed once on a grid of places.

    Args:
        geometry: of the camera.
        floor: with its walls and obstacles. Where the camera hangs outside the floor's outline, walls on the outline
            are the glass it looks through.
        obstacle_height: metres.
        wall_height: metres.
    """

    def __init__(self, geometry: CameraGeometry, floor: Floor, obstacle_height: float, wall_height: float) -> None:
        outline = shapely.Polygon(floor.outline)
        left, bottom, right, top = outline.bounds
        self._step = max(0.1, math.sqrt((right - left) * (top - bottom) / _CELLS))
        self._origin = np.array([left, bottom])
        self._shape = (math.ceil((right - left) / self._step) + 1, math.ceil((top - bottom) / self._step) + 1)
        self._hidden: Bools | None = None
        eye = geometry.position
        obstacles = shapely.union_all([shapely.Polygon(obstacle.polygon) for obstacle in floor.obstacles])
        walls = shapely.union_all([shapely.LineString(wall) for wall in floor.walls])
        if not shapely.contains_xy(outline, eye[0], eye[1]):
            walls = shapely.difference(walls, shapely.buffer(outline.exterior, 0.05))
        blocks = [
            (shape, high) for shape, high in ((obstacles, obstacle_height), (walls, wall_height)) if not shape.is_empty
        ]
        if not blocks:
            return
        grid = np.stack(np.meshgrid(*(np.arange(count) for count in self._shape), indexing="ij"), axis=-1)
        places = self._origin + self._step * grid.reshape(-1, 2)
        bodies = project_bodies(geometry, places, np.full(len(places), 1.7))
        seen = np.flatnonzero(bodies.inside.any(axis=1))
        points = bodies.points[seen].reshape(-1, 3)
        hidden = np.zeros((len(places), _POINTS), bool)
        for shape, high in blocks:
            shapely.prepare(shape)
            hidden[seen] |= _passes_under(eye, points, shape, high).reshape(-1, _POINTS)
        self._hidden = hidden.reshape(*self._shape, _POINTS)

    def hidden(self, position: Array) -> Bools:
        """Return which points (…, 12) of people at ``position`` (…, 2) are hidden for good."""
        if self._hidden is None:
            return np.zeros((*position.shape[:-1], _POINTS), bool)
        cell = np.rint((np.nan_to_num(position) - self._origin) / self._step).astype(np.intp)
        cell = np.clip(cell, 0, np.array(self._shape) - 1)
        hidden: Bools = self._hidden[cell[..., 0], cell[..., 1]]
        return hidden


def _passes_under(eye: Array, points: Array, shape: shapely.Geometry, high: float) -> Bools:
    """Whether the ray from ``eye`` to each of ``points`` (n, 3) passes over ``shape`` lower than ``high`` metres."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (eye[2] - high) / (eye[2] - points[:, 2])
    if eye[2] > high:
        low = points[:, 2] < high  # from where the ray sinks below the top to its end
        start = np.clip(np.where(low, share, 0.0), 0.0, 1.0)
    else:
        low, start = np.ones(len(points), bool), np.zeros(len(points))
    begin = eye[:2] + start[:, None] * (points[:, :2] - eye[:2])
    hidden = np.zeros(len(points), bool)
    rays = np.asarray(shapely.linestrings(np.stack([begin[low], points[low, :2]], axis=1)), dtype=object)
    hidden[low] = shapely.intersects(shape, rays)
    return hidden
