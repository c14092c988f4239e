"""How does a walking person look? Solid figures posed in metres, projected, and drawn as shaded tapered capsules.

A figure is some thirty points in the plan's own metres, so whatever camera looks at it sees legs swing, arms swing
against them, and the right size and slant at every place of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from shared.site import CameraGeometry

__all__ = ["Clothes", "Figure", "draw_figure", "draw_shadow", "figure_box", "pose_figure", "project_figure"]

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Colour = tuple[float, float, float]

_SHIRTS: Sequence[Colour] = [
    (60, 60, 190),
    (175, 95, 40),
    (70, 140, 60),
    (40, 170, 220),
    (150, 60, 120),
    (225, 225, 225),
    (50, 50, 55),
    (190, 170, 60),
    (70, 110, 235),
    (120, 60, 30),
]
_TROUSERS: Sequence[Colour] = [(70, 50, 38), (45, 45, 48), (95, 85, 70), (110, 75, 50), (50, 66, 84)]
_SKINS: Sequence[Colour] = [(165, 190, 228), (140, 172, 214), (95, 130, 178), (62, 88, 130)]
_HAIR: Sequence[Colour] = [(28, 32, 40), (40, 66, 98), (92, 140, 176), (120, 122, 126)]
_SHOES: Colour = (36, 36, 42)
_STRIDE = 1.35  # metres per gait cycle (two steps) by which legs swing
_FACE_SEEN = 0.25  # cosine from which a face shows
_SHIFT = 4  # sub-pixel bits of OpenCV's drawing functions


@dataclass(frozen=True, slots=True)
class Clothes:
    """How tall one person is, metres, and what they wear (BGR)."""

    height: float
    shirt: Colour
    trousers: Colour
    skin: Colour
    hair: Colour
    holds_phone: bool = False

    @classmethod
    def draw(cls, rng: np.random.Generator, number: int, holds_phone: bool = False) -> Clothes:
        """Return somebody's clothes; ``number`` spreads the shirt colours over the crowd."""
        return cls(
            height=float(np.clip(rng.normal(1.71, 0.07), 1.52, 1.9)),
            shirt=_SHIRTS[number % len(_SHIRTS)],
            trousers=_TROUSERS[int(rng.integers(len(_TROUSERS)))],
            skin=_SKINS[int(rng.integers(len(_SKINS)))],
            hair=_HAIR[int(rng.integers(len(_HAIR)))],
            holds_phone=holds_phone,
        )


# Joints of a figure: rows of what ``pose_figure`` returns.
_HIP, _KNEE, _ANKLE, _TOE = (0, 1), (2, 3), (4, 5), (6, 7)
_SHOULDER, _ELBOW, _HAND = (8, 9), (10, 11), (12, 13)
_NECK, _HEAD, _CROWN, _BELLY, _PHONE = 14, 15, 16, 17, 18
_JOINTS = 19


def pose_figure(clothes: Clothes, position: Array, heading: float, speed: float, walked: float) -> Array:
    """Return the joints (19, 3) in metres of a person at ``position`` (2,) who has walked so far.

    Args:
        clothes: for the height.
        position: the middle between the feet, on the floor.
        heading: where the body faces, radians.
        speed: m/s; legs and arms swing wider at higher speed and rest at none.
        walked: metres; the phase of the gait.
    """
    tall = clothes.height
    phase = 2.0 * math.pi * walked / _STRIDE
    swing = math.radians(27.0) * min(1.0, speed / 1.0)
    joints = np.zeros((_JOINTS, 3))  # forward, left, up
    hip_height = 0.50 * tall - 0.02 * swing * (1.0 + math.cos(2.0 * phase))
    thigh, shin = 0.245 * tall, 0.225 * tall
    for side, sign in ((0, 1.0), (1, -1.0)):
        angle = sign * swing * math.sin(phase)
        # The knee bends while the leg comes forward.
        bend = 1.9 * swing * max(0.0, sign * math.cos(phase))
        hip = np.array([0.0, sign * 0.09, hip_height])
        knee = hip + thigh * np.array([math.sin(angle), 0.0, -math.cos(angle)])
        ankle = knee + shin * np.array([math.sin(angle - bend), 0.0, -math.cos(angle - bend)])
        ankle[2] = max(ankle[2], 0.05)
        joints[[_HIP[side], _KNEE[side], _ANKLE[side]]] = hip, knee, ankle
        joints[_TOE[side]] = ankle + np.array([0.14, 0.0, -0.03])
        shoulder = np.array([0.0, sign * 0.175, 0.81 * tall])
        arm = -0.9 * angle
        elbow = shoulder + 0.17 * tall * np.array([math.sin(arm), sign * 0.08, -math.cos(arm)])
        hand = elbow + 0.15 * tall * np.array([math.sin(arm + 0.35), 0.0, -math.cos(arm + 0.35)])
        if clothes.holds_phone and side == 1:
            elbow = shoulder + 0.17 * tall * np.array([0.12, -0.05, -0.99])
            hand = elbow + 0.15 * tall * np.array([0.9, 0.35, 0.35])
        joints[[_SHOULDER[side], _ELBOW[side], _HAND[side]]] = shoulder, elbow, hand
    joints[_BELLY] = [0.03, 0.0, 0.62 * tall]
    joints[_NECK] = [0.0, 0.0, 0.845 * tall]
    joints[_HEAD] = [0.02, 0.0, 0.925 * tall]
    joints[_CROWN] = [-0.012, 0.0, 0.94 * tall]
    joints[_PHONE] = joints[_HAND[1]] + [0.05, 0.0, 0.04]
    cos, sin = math.cos(heading), math.sin(heading)
    forward, left = joints[:, 0].copy(), joints[:, 1].copy()
    joints[:, 0] = position[0] + cos * forward - sin * left
    joints[:, 1] = position[1] + sin * forward + cos * left
    return joints


@dataclass(frozen=True, slots=True)
class Figure:
    """A posed figure in the picture.

    Attributes:
        pixels: (19, 2) of the joints.
        scale: pixels per metre at its middle.
        near: the side, 0 left or 1 right, that is nearer to the camera.
        facing: cosine between where the face looks and the way from it to the camera.
    """

    pixels: Array
    scale: float
    near: int
    facing: float


def project_figure(joints: Array, camera: CameraGeometry) -> Figure | None:
    """Return how the joints (19, 3) appear, or None where the camera cannot see them."""
    depth = float((joints.mean(axis=0) @ camera.rotation.T + camera.translation)[2])
    if depth < 0.5:
        return None
    pixels = camera.to_image(joints)
    if not np.isfinite(pixels).all():
        return None
    eye = camera.position
    left, right = (math.dist(joints[side].tolist(), eye.tolist()) for side in _SHOULDER)
    face, sight = (joints[_HEAD] - joints[_CROWN]) * [1.0, 1.0, 0.0], eye - joints[_HEAD]
    facing = float(face @ sight) / max(float(np.linalg.norm(face) * np.linalg.norm(sight)), 1e-9)
    return Figure(pixels, camera.focal[1] / depth, 0 if left < right else 1, facing)


def figure_box(figure: Figure, size: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """Return left, top, right, bottom of what a figure may touch, cut to the picture; None if that is nothing."""
    reach = 0.25 * figure.scale
    low = np.floor(figure.pixels.min(axis=0) - reach - 2).clip(0)
    high = np.minimum(np.ceil(figure.pixels.max(axis=0) + reach + 3), size)
    if (low >= high).any():
        return None
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def draw_figure(picture: Image, clothes: Clothes, figure: Figure) -> None:
    """Draw one figure into the picture, in place: far limbs first, each lit from the upper left."""
    pixels, scale, near = figure.pixels, figure.scale, figure.near
    trunk = (_HIP[0], _HIP[1], _SHOULDER[1], _SHOULDER[0])
    for side in (1 - near, near):
        dim = 0.82 if side != near else 1.0
        _limb(picture, pixels, (_ANKLE[side], _TOE[side]), (0.05, 0.045), scale, _SHOES, dim)
        _limb(picture, pixels, (_KNEE[side], _ANKLE[side]), (0.065, 0.05), scale, clothes.trousers, dim)
        _limb(picture, pixels, (_HIP[side], _KNEE[side]), (0.09, 0.068), scale, clothes.trousers, dim)
    _arm(picture, clothes, pixels, scale, 1 - near, 0.8)
    _trunk(picture, pixels, trunk, scale, clothes.shirt)
    _arm(picture, clothes, pixels, scale, near, 0.94)
    _limb(picture, pixels, (_NECK, _HEAD), (0.06, 0.06), scale, clothes.skin, 0.85)
    _ball(picture, pixels[_HEAD], 0.105 * scale, clothes.skin)
    _ball(picture, pixels[_CROWN], 0.104 * scale, clothes.hair)
    if figure.facing > _FACE_SEEN:
        # The face is what the hair leaves free on the side that the head looks to; from above it is a sliver.
        front = pixels[_HEAD] + 1.6 * (pixels[_HEAD] - pixels[_CROWN])
        _ball(picture, front + np.array([0.0, 0.02 * scale]), 0.075 * scale, clothes.skin)


def draw_shadow(picture: Image, camera: CameraGeometry, position: Array, strength: float = 1.0) -> None:
    """Darken the floor under a person, in place: a soft pool away from the light and a firm patch at the feet.

    Args:
        picture: (height, width, 3), BGR.
        camera: its geometry.
        position: (2,) of the feet, metres.
        strength: 0 for none; 1 takes a fifth of the light in the pool and two fifths at the feet.
    """
    angle = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(16)])
    pool = np.array([position[0] + 0.12, position[1] + 0.10, 0.0]) + circle * [0.40, 0.32, 0.0]
    patch = np.array([position[0] + 0.02, position[1] + 0.02, 0.0]) + circle * [0.17, 0.13, 0.0]
    pixels = camera.to_image(np.vstack([pool, patch]))
    if not np.isfinite(pixels).all():
        return
    width, height = camera.image_size
    low = np.floor(pixels.min(axis=0) - 6).clip(0).astype(int)
    high = np.minimum(np.ceil(pixels.max(axis=0) + 7), (width, height)).astype(int)
    if (low >= high).any():
        return
    cut = picture[low[1] : high[1], low[0] : high[0]]
    light = np.full(cut.shape, 255, np.uint8)
    for part, level in ((pixels[:16], 205), (pixels[16:], 150)):
        shade = max(0.0, 255.0 - strength * (255 - level))
        cv2.fillConvexPoly(light, _fixed(part - low), (shade, shade, shade), cv2.LINE_AA, _SHIFT)
    cv2.blur(light, (7, 5), light)
    cv2.multiply(cut, light, cut, 1.0 / 255.0)


def _arm(picture: Image, clothes: Clothes, pixels: Array, scale: float, side: int, dim: float) -> None:
    _limb(picture, pixels, (_SHOULDER[side], _ELBOW[side]), (0.062, 0.05), scale, clothes.shirt, dim)
    _limb(picture, pixels, (_ELBOW[side], _HAND[side]), (0.046, 0.036), scale, clothes.skin, dim)
    if clothes.holds_phone and side == 1:
        _ball(picture, pixels[_PHONE], 0.045 * scale, (235, 215, 150))


def _trunk(picture: Image, pixels: Array, joints: Sequence[int], scale: float, colour: Colour) -> None:
    radii = (0.11 * scale, 0.11 * scale, 0.085 * scale, 0.085 * scale)
    rims = [_circle(pixels[joint], radius) for joint, radius in zip(joints, radii, strict=True)]
    rims.append(_circle(pixels[_BELLY], 0.14 * scale))
    _hull(picture, np.vstack(rims), colour, 0.80)
    light = [0.5 * (rim - rim.mean(axis=0)) + rim.mean(axis=0) - [0.035 * scale, 0.03 * scale] for rim in rims]
    _hull(picture, np.vstack(light), colour, 1.06)


def _limb(
    picture: Image,
    pixels: Array,
    ends: tuple[int, int],
    radii: tuple[float, float],
    scale: float,
    colour: Colour,
    dim: float,
) -> None:
    rims = [_circle(pixels[end], max(0.6, radius * scale)) for end, radius in zip(ends, radii, strict=True)]
    _hull(picture, np.vstack(rims), colour, 0.82 * dim)
    if scale > 25.0:
        shift = -0.3 * radii[0] * scale
        light = [0.5 * (rim - rim.mean(axis=0)) + rim.mean(axis=0) + [shift, 0.5 * shift] for rim in rims]
        _hull(picture, np.vstack(light), colour, 1.08 * dim)


def _ball(picture: Image, middle: Array, radius: float, colour: Colour) -> None:
    rim = _circle(middle, max(0.6, radius))
    _hull(picture, rim, colour, 0.86)
    _hull(picture, 0.55 * (rim - middle) + middle - 0.25 * radius, colour, 1.1)


_angles = np.linspace(0.0, 2.0 * math.pi, 10, endpoint=False)
_unit_circle = np.column_stack([np.cos(_angles), np.sin(_angles)])


def _circle(middle: Array, radius: float) -> Array:
    rim: Array = middle + radius * _unit_circle
    return rim


def _hull(picture: Image, points: Array, colour: Colour, brightness: float) -> None:
    hull = np.asarray(cv2.convexHull(points.astype(np.float32)), float).reshape(-1, 2)
    shade = tuple(min(255.0, brightness * part) for part in colour)
    cv2.fillConvexPoly(picture, _fixed(hull), shade, cv2.LINE_AA, _SHIFT)


def _fixed(points: Array) -> NDArray[np.int32]:
    return np.round(points * (1 << _SHIFT)).astype(np.int32)
