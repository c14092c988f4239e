"""Where does somebody have the phone, and what do they do with it? Hand, pocket, a new grip, a fidget while standing.

How a phone is turned against its carrier is a rotation that stays while the phone is held and moves smoothly (minimum
jerk) to the next: a new grip, out of the pocket, back into it. In the hand it points along the walk but for an offset,
partly the person's habit and partly this grip's: what [self-calibrating-rss-thesis §3.5] calls the phone-to-walking
offset. Handling a phone while standing shakes it about as often as steps do, and those are no steps (§3.4 there).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from shared.site.site_file import Number, Part

__all__ = ["Carried", "Carrying", "CarryingParameters", "Habit"]

Array = NDArray[np.float64]
Carrying = Literal["hand", "pocket", "mixed"]

_STANDING = 0.25  # m/s; below it somebody may fidget
_RAMP = 0.4  # seconds in which fidgeting begins and ends
_LIFT = np.array([0.25, 0.15, 0.40])  # metres forward, left and up from pocket to hand
_PERSONAL = 0.6  # share of the offset's standard deviation that is the person's own; the rest is drawn per grip


class CarryingParameters(Part):
    """How phones are carried. Waiting times are means of an exponential distribution; 0 is never."""

    offset: Number = Field(10.0, ge=0, le=60, description="std of a phone in the hand against the walk, degrees")
    regrip_every: Number = Field(120.0, ge=0, le=86_400, description="seconds between two grips, in the hand")
    in_hand: Number = Field(60.0, ge=5, le=86_400, description="seconds in the hand before the pocket (mixed)")
    in_pocket: Number = Field(150.0, ge=5, le=86_400, description="seconds in the pocket before the hand (mixed)")
    fidget_every: Number = Field(45.0, ge=0, le=86_400, description="seconds between two fidgets of who stands still")
    fidget_for: tuple[Number, Number] = Field((1.5, 10.0), description="shortest and longest fidget, s")
    rhythmic: Number = Field(0.5, ge=0, le=1, description="share of fidgets that repeat themselves as steps do")
    fidget_strength: Number = Field(1.2, ge=0, le=10, description="std of a fidget's acceleration per axis, m/s²")

    @model_validator(mode="after")
    def _in_order(self) -> CarryingParameters:
        low, high = self.fidget_for
        if not 0.5 <= low <= high <= 600:
            raise ValueError(f"fidget_for is [{low:g}, {high:g}], allowed is 0.5 <= shortest <= longest <= 600 s")
        return self


@dataclass(frozen=True, slots=True)
class Carried:
    """How a phone was carried at n times.

    Attributes:
        mount: (n, 3, 3) rotations from the phone's axes (right, top, screen) to the body's (forward, left, up).
        hand: how far it is in the hand, (n,): 1 held, 0 in the pocket, in between on the way.
        push: acceleration of being moved about, (n, 3) m/s², in the body's axes.
        fidget: how much the carrier fidgets with it, (n,), 0 to 1.
        rhythm: the part of that which repeats itself as steps do, (n, 3), 0 to about 2.
        offset: of the phone's top against the walk, (n,) radians, left is positive; meaningless in a pocket.
    """

    mount: Array
    hand: Array
    push: Array
    fidget: Array
    rhythm: Array
    offset: Array


@dataclass(frozen=True, slots=True)
class _Hold:
    """A way to hold the phone for a while."""

    mount: Array
    hand: float
    offset: float


@dataclass(frozen=True, slots=True)
class _Move:
    """From one hold to the next."""

    start: float
    seconds: float
    before: _Hold
    after: _Hold
    lift: Array


@dataclass(frozen=True, slots=True)
class _Fidget:
    """Handling the phone for a while: without order, or ``tempo`` times a second along a direction."""

    start: float
    end: float
    tempo: float
    direction: Array


class Habit:
    """What one person does with the phone; asked in order of time.

    Args:
        rng: decides.
        carrying: always in the hand, always in the pocket, or now here, now there.
        parameters: of everybody.
    """

    def __init__(self, rng: np.random.Generator, carrying: Carrying, parameters: CarryingParameters) -> None:
        # Moves and fidgets draw apart, each in order of time: blocks do not matter to when things happen.
        self._rng, self._fidgeting = rng.spawn(2)
        self._carrying = carrying
        self._parameters = parameters
        sigma = math.radians(parameters.offset)
        self._own_offset = float(rng.normal(0.0, _PERSONAL * sigma))
        self._grip_sigma = math.sqrt(1.0 - _PERSONAL**2) * sigma
        # Phones lie along a trouser pocket, top up or down, turned any way about that.
        self._pocket = Rotation.from_euler(
            "ZXY",
            [
                rng.uniform(-math.pi, math.pi),
                rng.choice([-1.0, 1.0]) * math.pi / 2 + rng.normal(0.0, 0.25),
                rng.normal(0.0, 0.25),
            ],
        )
        stays = parameters.in_hand / (parameters.in_hand + parameters.in_pocket)
        self._hold = self._draw(carrying == "hand" or (carrying == "mixed" and rng.random() < stays))
        self._move: _Move | None = None
        self._next_move: float | None = None
        self._swaps = False
        self._next_fidget = math.inf
        self._fidgets = _Fidget(-math.inf, -math.inf, 1.0, np.zeros(3))

    def follow(self, t: Array, speed: Array) -> Carried:
        """Return how the phone was carried at the next times ``t`` (n,) s of a walk at ``speed`` (n,) m/s."""
        if self._next_move is None:
            self._next_move = self._wait(float(t[0]))
            self._next_fidget = float(t[0]) + _exponential(self._fidgeting, self._parameters.fidget_every)
        n = len(t)
        mount = np.broadcast_to(self._hold.mount, (n, 3, 3))
        hand, offset, push = np.full(n, self._hold.hand), np.full(n, self._hold.offset), np.zeros((n, 3))
        while True:
            if self._move is None:
                if self._next_move > t[-1]:
                    break
                self._move = self._begin(self._next_move)
            move = self._move
            mount = _turn(mount, hand, offset, push, move, t)
            if move.start + move.seconds > t[-1]:
                break
            self._hold, self._move = move.after, None
            self._next_move = self._wait(move.start + move.seconds)
        fidget, rhythm = self._fidget(t, speed)
        return Carried(mount, hand, push, fidget, rhythm, offset)

    def _begin(self, start: float) -> _Move:
        rng, held = self._rng, self._hold.hand > 0.5
        if self._carrying == "mixed" and self._swaps:
            after = self._draw(not held)
            return _Move(start, float(rng.uniform(0.9, 1.8)), self._hold, after, _LIFT * (-1.0 if held else 1.0))
        if held:
            after = self._draw(True)
        else:  # it slips about in its pocket
            slipped = Rotation.from_matrix(self._hold.mount) * Rotation.from_rotvec(rng.normal(0.0, 0.12, 3))
            after = _Hold(slipped.as_matrix(), 0.0, 0.0)
        return _Move(start, float(rng.uniform(0.4, 1.0)), self._hold, after, rng.normal(0.0, 0.04, 3))

    def _wait(self, now: float) -> float:
        """Return when the next move begins, and decide which it is."""
        held = self._hold.hand > 0.5
        regrip = now + _exponential(self._rng, self._parameters.regrip_every * (1.0 if held else 4.0))
        swap = now + _exponential(self._rng, self._parameters.in_hand if held else self._parameters.in_pocket)
        self._swaps = self._carrying == "mixed" and swap < regrip
        return swap if self._swaps else regrip

    def _draw(self, in_hand: bool) -> _Hold:
        rng = self._rng
        if not in_hand:
            loose = self._pocket * Rotation.from_rotvec(rng.normal(0.0, 0.2, 3))
            return _Hold(loose.as_matrix(), 0.0, 0.0)
        offset = self._own_offset + float(rng.normal(0.0, self._grip_sigma))
        # Held along the walk, its x axis (to its right) lies 90 degrees clockwise of forward; raised at the top.
        angles = [offset - 0.5 * math.pi, math.radians(rng.uniform(15.0, 40.0)), math.radians(rng.normal(0.0, 4.0))]
        return _Hold(Rotation.from_euler("ZXY", angles).as_matrix(), 1.0, offset)

    def _fidget(self, t: Array, speed: Array) -> tuple[Array, Array]:
        envelope, rhythm = np.zeros(len(t)), np.zeros((len(t), 3))
        while True:
            fidget = self._fidgets
            if fidget.end > t[0]:
                since = t - fidget.start
                own = np.clip(np.minimum(since, fidget.end - t) / _RAMP, 0.0, 1.0)
                envelope = np.maximum(envelope, own)
                beat = np.sin(2.0 * math.pi * (fidget.tempo * since + 0.1 * np.sin(2.0 * since)))
                rhythm += (own * beat)[:, None] * fidget.direction
            next_fidget = self._begin_fidget(t, speed)
            if next_fidget is None:
                return envelope, rhythm
            self._fidgets = next_fidget

    def _begin_fidget(self, t: Array, speed: Array) -> _Fidget | None:
        """Return the next fidget that begins by the end of ``t``; who walks at its time leaves it out."""
        while self._next_fidget <= t[-1]:
            at, found = self._next_fidget, None
            if speed[min(int(np.searchsorted(t, at)), len(t) - 1)] < _STANDING:
                found = self._draw_fidget(at)
                at = found.end
            self._next_fidget = at + _exponential(self._fidgeting, self._parameters.fidget_every)
            if found is not None:
                return found
        return None

    def _draw_fidget(self, start: float) -> _Fidget:
        rng = self._fidgeting
        direction = rng.normal(size=3) * float(rng.uniform(0.5, 1.5)) * (rng.random() < self._parameters.rhythmic)
        return _Fidget(
            start, start + float(rng.uniform(*self._parameters.fidget_for)), rng.uniform(0.8, 2.6), direction
        )


def _exponential(rng: np.random.Generator, mean: float) -> float:
    return float(rng.exponential(mean)) if mean > 0 else math.inf


def _turn(mount: Array, hand: Array, offset: Array, push: Array, move: _Move, t: Array) -> Array:
    """Write a move into the columns and return the mounts with it."""
    on = int(np.searchsorted(t, move.start))
    share = np.clip((t[on:] - move.start) / move.seconds, 0.0, 1.0)
    s = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    bend = share * (60.0 - 180.0 * share + 120.0 * share**2) / move.seconds**2
    mount = mount.copy()
    relative = Rotation.from_matrix(move.before.mount.T @ move.after.mount).as_rotvec()
    mount[on:] = move.before.mount @ _rotations(relative, s)
    hand[on:] = move.before.hand + (move.after.hand - move.before.hand) * s
    offset[on:] = move.before.offset + (move.after.offset - move.before.offset) * s
    push[on:] += bend[:, None] * move.lift
    return mount


def _rotations(vector: Array, share: Array) -> Array:
    """Return the rotations (n, 3, 3) by ``share`` (n,) of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-9:
        return np.broadcast_to(np.eye(3), (len(share), 3, 3))
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sin, cos = np.sin(angle * share)[:, None, None], np.cos(angle * share)[:, None, None]
    turned: Array = np.eye(3) + sin * cross + (1.0 - cos) * (cross @ cross)
    return turned
