"""The still part of a camera's picture: textured floor, walls with paintings, exhibits on plinths.

Drawn once at twice the size and scaled down, with a mask per exhibit, so that people can later pass behind it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from shared.site import CameraGeometry, Floor

__all__ = ["Exhibit", "Scenery", "paint_scenery"]

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[float, float, float]

_SCALE = 2
_BAND = 16  # rows
_WALL_HEIGHT = 3.2
_PARTITION_HEIGHT = 3.0
_THICKNESS = 0.12
_PARTITION = -1
"""Stands for the number of an exhibit where there is a wall within the floor."""
_PLASTER: Colour = (186, 194, 198)
_PLINTHS: Sequence[Colour] = [(205, 208, 212), (188, 196, 206), (172, 186, 200), (198, 200, 190), (210, 205, 198)]
_ACCENTS: Sequence[Colour] = [(150, 92, 48), (190, 190, 185), (70, 110, 165), (60, 76, 110), (140, 120, 40)]
_LIGHT = np.array([-0.45, -0.55, 0.7]) / math.sqrt(0.45**2 + 0.55**2 + 0.7**2)


@dataclass(frozen=True, slots=True)
class Exhibit:
    """One exhibit in the picture: what it covers, and what it stands on.

    Attributes:
        footprint: on the floor.
        left, top: where its mask lies in the picture, pixels.
        mask: (h, w), 255 where the exhibit is seen.
    """

    footprint: shapely.Polygon
    left: int
    top: int
    mask: Image


@dataclass(frozen=True, slots=True)
class Scenery:
    """The empty hall as the camera sees it: (height, width, 3) BGR, and its exhibits."""

    picture: Image
    exhibits: Sequence[Exhibit]


def paint_scenery(floor: Floor, camera: CameraGeometry, rng: np.random.Generator) -> Scenery:
    """Return the empty floor seen by ``camera``; ``rng`` decides tiles and paintings."""
    width, height = camera.image_size
    large = camera.scaled_to(width * _SCALE, height * _SCALE)
    canvas = _floor(floor, large, rng)
    outline = shapely.Polygon(floor.outline)
    inner = []
    for start, end in _walls_far_to_near(floor, large):
        if shapely.distance(outline.exterior, shapely.Point(*(0.5 * (start + end)))) > _THICKNESS:
            inner.append(_partition(start, end))
        else:
            _wall(canvas, large, outline, start, end, rng)
    solids = [(np.array(obstacle.polygon), number) for number, obstacle in enumerate(floor.obstacles)]
    solids += [(ring, _PARTITION) for ring in inner]
    eye = large.position[:2].tolist()
    solids.sort(key=lambda solid: -math.dist(solid[0].mean(axis=0).tolist(), eye))
    for ring, number in solids:
        if number != _PARTITION:
            _contact_shadow(canvas, large, ring)
    exhibits = []
    for ring, number in solids:
        mask = np.zeros(canvas.shape[:2], np.uint8)
        if number == _PARTITION:
            _prism(canvas, mask, large, ring, 0.0, _PARTITION_HEIGHT, _PLASTER)
        else:
            _exhibit(canvas, mask, large, ring, number)
        small = cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA)
        left, top, w, h = cv2.boundingRect(small)
        if w and h:
            cut = np.where(small[top : top + h, left : left + w] > 127, 255, 0).astype(np.uint8)
            exhibits.append(Exhibit(shapely.Polygon(ring), left, top, cut))
    picture = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    return Scenery(np.asarray(picture, np.uint8), exhibits)


def _floor(floor: Floor, camera: CameraGeometry, rng: np.random.Generator) -> Image:
    outline = shapely.Polygon(floor.outline)
    shapely.prepare(outline)
    shades, slabs = rng.normal(0.0, 4.5, (97, 89)), rng.normal(0.0, 3.0, (97, 89))
    height = camera.image_size[1]
    # In bands of rows that fit the processor's cache.
    bands = [
        _floor_band(outline, camera, range(top, min(top + _BAND, height)), shades, slabs, rng)
        for top in range(0, height, _BAND)
    ]
    return np.concatenate(bands)


def _floor_band(
    outline: shapely.Polygon,
    camera: CameraGeometry,
    rows: range,
    shades: Array,
    slabs: Array,
    rng: np.random.Generator,
) -> Image:
    """Return some rows of the empty floor (rows, width, 3)."""
    width, height = camera.image_size
    grid = np.stack(np.meshgrid(np.arange(width), np.array(rows)), axis=-1).reshape(-1, 2)
    ground = camera.to_ground(grid.astype(float))
    seen = np.isfinite(ground[:, 0])
    place = np.where(seen[:, None], ground, 0.0)
    inside = shapely.intersects_xy(outline, place[:, 0], place[:, 1]) & seen

    # Stone tiles of 1 m, each of its own shade, with veins and joints; joints fade where they are thinner than a pixel.
    tile = np.floor(place).astype(np.int64)
    shade = shades[tile[:, 0] % 97, tile[:, 1] % 89]
    veins = 3.0 * np.sin(1.7 * place[:, 0] + 2.3 * np.sin(1.1 * place[:, 1])) + 2.0 * np.sin(
        5.1 * place[:, 1] + 1.9 * np.sin(2.9 * place[:, 0])
    )
    offset = np.abs(place - np.round(place)).min(axis=1)
    joint = np.exp(-((offset / 0.018) ** 2)) * 26.0
    # Pools of light under three lamps along the longer side.
    left, bottom, right, top = outline.bounds
    lamps = [((left + (right - left) * share), 0.5 * (bottom + top)) for share in (1 / 6, 3 / 6, 5 / 6)]
    pool = sum(np.exp(-((place[:, 0] - x) ** 2 + (place[:, 1] - y) ** 2) / 18.0) for x, y in lamps)
    level = 138.0 + shade + veins - joint + 24.0 * np.asarray(pool)
    stone = level[:, None] * np.array([0.90, 0.97, 1.04])

    slab = slabs[np.floor(place[:, 0] / 0.5).astype(int) % 97, tile[:, 1] % 89]
    pavement = (96.0 + slab)[:, None] * np.array([1.0, 0.99, 0.97])
    depth = 38.0 + 22.0 * np.array(rows) / max(height - 1, 1)
    dark = depth.repeat(width)[:, None] * np.array([1.0, 0.98, 0.96])
    far = np.hypot(*(place - camera.position[:2]).T) > 60.0
    colour = np.where(inside[:, None], stone, np.where((seen & ~far)[:, None], pavement, dark))
    # What lies behind the far walls is not outdoors in this picture: it is hidden by them or dark.
    behind = seen & ~inside & (place[:, 1] > top)
    colour = np.where(behind[:, None], dark, colour)
    grain = rng.normal(0.0, 2.0, (len(grid), 1))
    band: Image = np.clip(colour + grain, 0, 255).astype(np.uint8).reshape(len(rows), width, 3)
    return band


def _walls_far_to_near(floor: Floor, camera: CameraGeometry) -> list[tuple[Array, Array]]:
    pieces: list[tuple[Array, Array]] = []
    for wall in floor.walls:
        points = np.array(wall, float)
        for start, end in itertools.pairwise(points):
            count = max(1, round(math.dist(start, end) / 2.0))
            stops = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (end - start)
            pieces += itertools.pairwise(stops)
    eye = camera.position[:2]
    return sorted(pieces, key=lambda piece: -math.dist(0.5 * (piece[0] + piece[1]), eye))


def _partition(start: Array, end: Array) -> Array:
    """Return the corners (4, 2) of a stretch of wall within the floor; stretches overlap at corners of the wall."""
    along = (end - start) / max(math.dist(start, end), 1e-9)
    aside = 0.5 * _THICKNESS * np.array([-along[1], along[0]])
    more = 0.5 * _THICKNESS * along
    return np.array([start - more - aside, end + more - aside, end + more + aside, start - more + aside])


def _wall(
    canvas: Image,
    camera: CameraGeometry,
    outline: shapely.Polygon,
    start: Array,
    end: Array,
    rng: np.random.Generator,
) -> None:
    """Draw one stretch of wall; one that would hide the floor behind it is glass on a low sill."""
    hides = _hides_floor(outline, camera, 0.5 * (start + end))
    texture = _wall_texture(math.dist(start, end), rng)
    top = 0.12 if hides else _WALL_HEIGHT
    corners = np.array([[*start, top], [*end, top], [*end, 0.0], [*start, 0.0]])
    image = camera.to_image(corners)
    if not np.isfinite(image).all() or np.abs(image).max() > 6.0 * max(camera.image_size):
        return
    if hides:
        cv2.fillConvexPoly(canvas, _rounded(image), (92, 96, 100), cv2.LINE_AA)
        return
    # Facing the lamps or not: walls along different directions differ in brightness.
    along = np.abs(end - start) / max(math.dist(start, end), 1e-9)
    brightness = 1.0 if along[0] > along[1] else 0.86
    h, w = texture.shape[:2]
    source = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    low = np.floor(image.min(axis=0)).clip(0).astype(int)
    high = np.minimum(np.ceil(image.max(axis=0)) + 1, camera.image_size).astype(int)
    if (high <= low).any():
        return
    local = (image - low).astype(np.float32)
    shaded = np.clip(texture * brightness, 0, 255).astype(np.uint8)
    transform = cv2.getPerspectiveTransform(source, local)
    size = (int(high[0] - low[0]), int(high[1] - low[1]))
    warped = cv2.warpPerspective(shaded, transform, size, borderMode=cv2.BORDER_REPLICATE)
    covered = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(covered, _rounded(local), 255)
    cv2.copyTo(warped, covered, canvas[low[1] : high[1], low[0] : high[0]])


def _hides_floor(outline: shapely.Polygon, camera: CameraGeometry, middle: Array) -> bool:
    """Whether the floor goes on behind this wall: the camera sees the wall from outside."""
    away = middle - camera.position[:2]
    behind = middle + 0.3 * away / max(float(np.hypot(*away)), 1e-9)
    return bool(shapely.contains_xy(outline, behind[0], behind[1]))


def _wall_texture(length: float, rng: np.random.Generator) -> Image:
    """Return 2 m or so of wall at 60 px/m: plaster, skirting board, and now and then a framed painting."""
    w, h = max(8, round(length * 60)), round(_WALL_HEIGHT * 60)
    rows = np.linspace(1.06, 0.9, h)[:, None, None]
    wall: Image = np.clip(rows * np.array([196.0, 204.0, 208.0]) + rng.normal(0, 1.5, (h, w, 1)), 0, 255).astype(
        np.uint8
    )
    cv2.rectangle(wall, (0, h - 9), (w, h), (104, 110, 116), -1)
    if w >= 90 and rng.random() < 0.55:
        pw, ph = int(rng.integers(42, 70)), int(rng.integers(36, 60))
        x, y = (w - pw) // 2, round(h * 0.30)
        cv2.rectangle(wall, (x + 3, y + 4), (x + pw + 7, y + ph + 8), (150, 158, 162), -1)
        cv2.rectangle(wall, (x - 4, y - 4), (x + pw + 4, y + ph + 4), (40, 62, 88), -1)
        small = rng.integers(40, 220, (3, 4, 3)).astype(np.uint8)
        wall[y : y + ph, x : x + pw] = cv2.resize(small, (pw, ph), interpolation=cv2.INTER_CUBIC)
    return wall


def _contact_shadow(canvas: Image, camera: CameraGeometry, ring: Array) -> None:
    """Darken the floor around a plinth, softly."""
    grown = np.array(shapely.Polygon(ring).buffer(0.18).exterior.coords)[:-1]
    grown = grown + np.array([0.12, 0.10])
    image = camera.to_image(np.column_stack([grown, np.zeros(len(grown))]))
    if not np.isfinite(image).all():
        return
    # Only where the blur reaches: three standard deviations around it.
    low = np.clip(np.floor(image.min(axis=0)) - 30, 0, camera.image_size).astype(int)
    high = np.clip(np.ceil(image.max(axis=0)) + 30, 0, camera.image_size).astype(int)
    if (low >= high).any():
        return
    mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
    cv2.fillPoly(mask, [_rounded(image - low)], 120)
    soft = cv2.GaussianBlur(mask, (0, 0), 9.0)
    cut = canvas[low[1] : high[1], low[0] : high[0]]
    cut[:] = (cut * (1.0 - soft[..., None] / 255.0)).astype(np.uint8)


def _exhibit(canvas: Image, mask: Image, camera: CameraGeometry, ring: Array, number: int) -> None:
    plinth, accent = _PLINTHS[number % len(_PLINTHS)], _ACCENTS[number % len(_ACCENTS)]
    middle = ring.mean(axis=0)
    reach = 0.5 * float(np.ptp(ring, axis=0).min())
    shape = number % 5
    if shape == 2:  # a table with a model of buildings under it
        _prism(canvas, mask, camera, ring, 0.0, 0.75, plinth)
        for fx, fy, size, tall in ((-0.32, 0.1, 0.16, 0.35), (0.0, -0.1, 0.2, 0.55), (0.33, 0.12, 0.14, 0.25)):
            spot = middle + np.array([fx, fy]) * np.ptp(ring, axis=0)
            square = spot + min(size, 0.35 * reach) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            _prism(canvas, mask, camera, square, 0.75, 0.75 + tall, accent)
        return
    if shape == 3:  # a cabinet
        _prism(canvas, mask, camera, ring, 0.0, 1.15, accent)
        _prism(canvas, mask, camera, middle + 0.94 * (ring - middle), 1.15, 1.3, plinth)
        return
    _prism(canvas, mask, camera, ring, 0.0, 0.55, plinth)
    if shape == 0:  # a vase
        z = np.linspace(0.0, 1.0, 24)
        profile = (
            0.16 + 0.24 * np.sin(math.pi * np.clip(z * 1.15, 0, 1)) ** 1.5 + 0.06 * np.clip((z - 0.85) / 0.15, 0, 1)
        )
        _lathe(canvas, mask, camera, middle, 0.55 + 0.95 * z, profile * reach / 0.6, accent)
    elif shape == 1:  # a statue: a robed figure
        z = np.linspace(0.0, 1.0, 40)
        robe = np.where(z < 0.78, 0.30 - 0.18 * z, 0.0)
        neck = np.where((z >= 0.78) & (z < 0.84), 0.07, 0.0)
        head = np.where(z >= 0.84, np.sqrt(np.clip(1 - ((z - 0.92) / 0.08) ** 2, 0, 1)) * 0.13, 0.0)
        _lathe(canvas, mask, camera, middle, 0.55 + 1.45 * z, (robe + neck + head).clip(0.02), accent)
    else:  # a globe
        angle = np.linspace(-math.pi / 2, math.pi / 2, 30)
        _lathe(canvas, mask, camera, middle, 1.05 + 0.45 * np.sin(angle), 0.45 * np.cos(angle) + 0.01, accent)


def _prism(
    canvas: Image, mask: Image, camera: CameraGeometry, ring: Array, low: float, high: float, colour: Colour
) -> None:
    """Draw an upright block: its sides from far to near, then its top."""
    if shapely.Polygon(ring).exterior.is_ccw is False:
        ring = ring[::-1]
    eye = camera.position[:2]
    sides = sorted(
        zip(ring, np.roll(ring, -1, axis=0), strict=True), key=lambda side: -math.dist(0.5 * (side[0] + side[1]), eye)
    )
    for start, end in sides:
        along = (end - start) / max(math.dist(start, end), 1e-9)
        outward = np.array([along[1], -along[0], 0.0])
        _face(canvas, mask, camera, [[*start, low], [*end, low], [*end, high], [*start, high]], colour, outward)
    _face(canvas, mask, camera, [[*corner, high] for corner in ring], colour, np.array([0.0, 0.0, 1.0]))


def _face(
    canvas: Image, mask: Image, camera: CameraGeometry, corners: Sequence[Sequence[float]], colour: Colour, out: Array
) -> None:
    image = camera.to_image(np.array(corners, float))
    if not np.isfinite(image).all() or np.abs(image).max() > 1e5:
        return
    brightness = 0.62 + 0.48 * max(0.0, float(out @ _LIGHT))
    polygon = _rounded(image)
    cv2.fillPoly(canvas, [polygon], tuple(min(255.0, brightness * part) for part in colour), cv2.LINE_AA)
    cv2.fillPoly(mask, [polygon], 255)


def _lathe(
    canvas: Image, mask: Image, camera: CameraGeometry, middle: Array, z: Array, radius: Array, colour: Colour
) -> None:
    """Draw a turned solid as a stack of discs, lighter towards the light."""
    angle = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    for level, r in zip(z, radius, strict=True):
        for share, brightness in ((1.0, 0.62), (0.8, 0.82), (0.5, 1.05)):
            shifted = middle + (1.0 - share) * r * 0.9 * _LIGHT[:2]
            ring = np.column_stack([shifted + share * r * circle, np.full(len(circle), level)])
            image = camera.to_image(ring)
            if not np.isfinite(image).all():
                return
            polygon = _rounded(image)
            cv2.fillPoly(canvas, [polygon], tuple(min(255.0, brightness * part) for part in colour), cv2.LINE_AA)
            if share == 1.0:
                cv2.fillPoly(mask, [polygon], 255)


def _rounded(pixels: NDArray[np.floating]) -> NDArray[np.int32]:
    return np.round(pixels).astype(np.int32)
