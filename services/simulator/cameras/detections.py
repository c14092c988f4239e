"""What would the camera service report of these people? Detections without pictures, made a block at a time.

Harder than trackers assume, and for reasons they could know: people are hidden by people, obstacles and the picture's
edge in true geometry; who stands still fades and leaves a ghost (``fading``); misses and errors last; bodies that lie
over each other become one detection and some fall into two; what is reflected comes back. Covariances are what the
camera service would publish, not what the errors really are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, ndtri

from services.simulator.cameras.clutter import Clutter
from services.simulator.cameras.detection_frames import FramePublisher, frame_numbers
from services.simulator.cameras.detection_parameters import DetectionParameters
from services.simulator.cameras.fading import FITTED, STILL_RADIUS, Imprints
from services.simulator.cameras.merging import leaders, near_pairs
from services.simulator.cameras.visibility import LEGS, Silhouettes, StaticView, hidden_by_others, project_bodies
from services.simulator.cameras.wandering import Episodes, Wander
from services.simulator.people import BLOCK, People
from services.simulator.seeds import generator
from services.simulator.video.figures import Clothes
from shared.messages import DetectionFrame
from shared.site import Camera, CameraGeometry, Floor

__all__ = ["DetectionModel", "DetectionParameters"]

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

EXPECTED_HEIGHT = 1.75
"""Metres: how tall the detector takes people to be where it sees no feet."""
_TICK = 0.5
"""Seconds between looks at who stands still."""
_GHOSTS = 1_000_000
"""Keys of ghosts begin here; below are people."""
_VISIBLE_WIDTH = 0.08
"""Share of a body over which being found falls with what is hidden (scale of a logistic)."""
_MERGE_PULL = 0.5
"""How far the foot of a blob lies from its nearest member towards the middle of all."""
_SPLIT_ASIDE = 0.4
"""How far aside the upper half of a split person is found (standard deviation, widths of the body)."""
_CONFIDENCE_SPREAD = 0.06
_LEAST_ABOVE = 0.5
"""Metres: a camera lower than this above a head guesses feet no worse than one that hangs there."""
_FARTHEST_GUESS = 1.5
"""Metres by which a guess of hidden feet is wrong at most."""


@dataclass(frozen=True, slots=True)
class _Bodies:
    """What may be taken for people in one block: people first, then ghosts; n frames, c columns."""

    key: list[int]
    position: Array  # (n, c, 2) metres
    tall: Array  # (c,)
    there: Bools  # (n, c)
    solid: Bools  # (c,) hides others
    factor: Array  # (n, c) of the probability of being found: faded people, weak ghosts


@dataclass(frozen=True, slots=True)
class _Found:
    """Detections in the picture; m rows."""

    frame: Ints
    foot: Array  # (m, 2) pixels
    box: Array  # (m, 4) left, top, right, bottom
    confidence: Array


class DetectionModel:
    """One camera over one floor; asked for block after block, in order.

    Args:
        camera: geometry and area of interest.
        floor: which it watches.
        parameters: how well it sees.
        frames_per_s: frame k is taken at k / frames_per_s.
        seed: of the world.
    """

    def __init__(
        self, camera: Camera, floor: Floor, parameters: DetectionParameters, frames_per_s: float, seed: int
    ) -> None:
        self._publisher = FramePublisher(camera, floor.id, frames_per_s)
        self.floor = floor
        self.geometry: CameraGeometry = self._publisher.geometry
        self.parameters = parameters
        self.frames_per_s = frames_per_s
        self._seed = seed
        p, interval = parameters, 1.0 / frames_per_s
        self._static = StaticView(self.geometry, floor, p.obstacle_height, p.wall_height)

        def rng(part: str) -> np.random.Generator:
            return generator(seed, "camera", camera.id, part)

        self._misses = Wander(p.miss_time, interval, p.miss_lasting, rng("misses"))
        self._errors = [Wander(p.noise_time, interval, p.noise_lasting, rng(f"error {axis}")) for axis in range(4)]
        self._merges = Wander(p.merge_time, interval, 1.0, rng("merges"))
        self._splits = Episodes(p.split_rate / 60.0, p.split_time, interval, rng("splits"))
        self._clutter = Clutter(
            self.geometry,
            floor,
            self._publisher.interest,
            p.clutter,
            p.clutter_places,
            p.clutter_episodes / 60.0,
            p.clutter_time,
            interval,
            rng("clutter"),
        )
        self._rng = rng("rest")
        self._ticks = max(1, round(_TICK * frames_per_s))
        self._imprints = Imprints(0, p.learning_rate, FITTED)
        self._tall = np.zeros(0)

    def frames(self, people: People, start: float, end: float) -> list[DetectionFrame]:
        """Return the frames taken in [start, end), seconds of the world; empty ones are among them."""
        numbers = frame_numbers(self.frames_per_s, start, end)
        block = np.floor((numbers + 1e-6) / (BLOCK * self.frames_per_s))
        made: list[DetectionFrame] = []
        for part in np.split(numbers, np.flatnonzero(np.diff(block)) + 1):
            if part.size:
                made += self._block(people, part)
        return made

    def _block(self, people: People, numbers: Ints) -> list[DetectionFrame]:
        bodies = self._bodies(people, numbers)
        parts = [self._false_alarms(numbers)]
        if bodies.key:
            parts.append(self._people(bodies))
        row, foot, box, confidence = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("frame", "foot", "box", "confidence")
        )
        confidence = np.clip(confidence + self._rng.normal(0.0, _CONFIDENCE_SPREAD, len(confidence)), 0.05, 1.0)
        return self._publisher.frames(numbers, row, foot, box, confidence)

    # Who is there

    def _bodies(self, people: People, numbers: Ints) -> _Bodies:
        now = people.movement(numbers / self.frames_per_s)
        self._learn_of(people.persons)
        place = people.floors.index(self.floor.id) if self.floor.id in people.floors else -2
        there = now.present & (now.floor == place) & np.isfinite(now.position).all(axis=2)
        visible, ghost, ghost_tall, imprint, number = self._fade(now.position, there, numbers)
        sight = there & self._in_sight(now.position)
        index = np.flatnonzero(sight.any(axis=0))
        position = np.concatenate(
            [now.position[:, index], np.broadcast_to(ghost, (len(numbers), *ghost.shape))], axis=1
        )
        return _Bodies(
            key=[*index.tolist(), *(_GHOSTS + number).tolist()],
            position=np.nan_to_num(position),
            tall=np.concatenate([self._tall[index], ghost_tall]),
            there=np.concatenate([sight[:, index], imprint > 0.0], axis=1),
            solid=np.arange(len(index) + len(number)) < len(index),
            factor=np.concatenate([visible[:, index], self._imprints.law.ghostly(imprint)], axis=1),
        )

    def _learn_of(self, persons: Sequence[str]) -> None:
        """Note how tall newcomers are: as tall as they are drawn."""
        for number in range(len(self._tall), len(persons)):
            body = Clothes.draw(generator(self._seed, "clothes", persons[number]), number)
            self._tall = np.append(self._tall, body.height)
        self._imprints.make_room(len(self._tall))

    def _in_sight(self, position: Array) -> Bools:
        """Whether people (n, p) stand where any of them could be in the picture: generously."""
        flat = np.nan_to_num(position).reshape(-1, 2)
        levels = [self.geometry.to_image(np.column_stack([flat, np.full(len(flat), z)])) for z in (0.0, 1.0, 1.9)]
        width, height = self.geometry.image_size
        low = np.fmin.reduce(levels)
        high = np.fmax.reduce(levels)
        margin = 0.1 * max(width, height)
        with np.errstate(invalid="ignore"):
            near = (high >= -margin).all(axis=1) & (low <= np.array([width, height]) + margin).all(axis=1)
        sight: Bools = near.reshape(position.shape[:2]) & np.isfinite(position[..., 0])
        return sight

    def _fade(self, position: Array, there: Bools, numbers: Ints) -> tuple[Array, Array, Array, Array, Ints]:
        """Let the background learn through a block.

        Returns:
            The factor (n, p) of finding people, places (g, 2) and heights (g,) of ghosts, their imprints (n, g; 0 where
            there is none) and numbers (g,).
        """
        imprints = self._imprints
        position = np.where(there[..., None], position, np.nan)
        visible = np.ones(there.shape)
        known: dict[int, tuple[Array, float]] = {}
        looks: list[tuple[slice, Ints, Array]] = []
        begin = 0
        for stop in [*np.flatnonzero(numbers % self._ticks == 0).tolist(), len(numbers)]:
            if stop > begin:
                span = slice(begin, stop)
                with np.errstate(invalid="ignore"):
                    near = np.hypot(*np.moveaxis(position[span] - imprints.anchor, 2, 0)) <= STILL_RADIUS
                faded = imprints.law.visible(imprints.imprint, self.parameters.learning_rate)
                visible[span] = np.where(near, faded, 1.0)
                tall = self._tall[imprints.ghost_person].tolist()
                known |= dict(zip(imprints.ghost_number.tolist(), zip(imprints.ghost, tall, strict=True), strict=True))
                looks.append((span, imprints.ghost_number, imprints.ghost_imprint))
                begin = stop
            if stop < len(numbers):
                t = float(numbers[stop]) / self.frames_per_s
                imprints.step(position[stop], t, self._ticks / self.frames_per_s)
        number = np.array(sorted(known), np.intp)
        imprint = np.zeros((len(numbers), len(number)))
        for span, ghosts, weights in looks:
            imprint[span, np.searchsorted(number, ghosts)] = weights
        place = np.array([known[ghost][0] for ghost in number.tolist()]).reshape(-1, 2)
        return visible, place, np.array([known[ghost][1] for ghost in number.tolist()]), imprint, number

    # What is found of them

    def _people(self, bodies: _Bodies) -> _Found:
        p = self.parameters
        n = len(bodies.position)
        tall = np.broadcast_to(bodies.tall, bodies.there.shape)
        shown = project_bodies(self.geometry, bodies.position, tall, bodies.there)
        eye = self.geometry.position
        in_view = bodies.there & shown.inside.any(axis=2) & np.isfinite(shown.box).all(axis=2)
        frame, one, other = near_pairs(shown.box, in_view)
        both_solid = bodies.solid[one] & bodies.solid[other]
        hidden = self._static.hidden(bodies.position) | hidden_by_others(
            eye, shown, bodies.position, bodies.tall, frame[both_solid], one[both_solid], other[both_solid]
        )
        uncovered = shown.inside & ~hidden
        visible = uncovered.mean(axis=2)
        legs = uncovered[..., LEGS].mean(axis=2)
        offset = bodies.position - eye[:2]
        distance = np.sqrt((offset**2).sum(axis=2) + eye[2] ** 2)

        probability = p.detection_probability * bodies.factor
        probability = probability * expit((p.half_distance - distance) / p.distance_width)
        probability = probability / expit(p.half_distance / p.distance_width)
        probability = probability * expit((visible - p.least_visible) / _VISIBLE_WIDTH)
        seen = in_view & (visible > 0.0) & (self._misses.next(bodies.key, n) < ndtri(probability))

        errors = np.stack([wander.next(bodies.key, n) for wander in self._errors], axis=2)
        foot = self._feet(bodies, shown, errors, legs, offset)
        box = shown.box
        confidence = 0.35 + 0.6 * visible * np.minimum(1.0, bodies.factor + 0.2)
        apart = self._splits.next(bodies.key, n)
        wander = self._merges.next(bodies.key, n)

        # Merging: of those that were seen, who lies over a nearer one is lost in them.
        near = seen[frame, one] & seen[frame, other]
        frame, one, other = frame[near], one[near], other[near]
        middle, size = 0.5 * (box[..., :2] + box[..., 2:]), box[..., 2:] - box[..., :2]
        between = (middle[frame, one] - middle[frame, other]) / (0.5 * (size[frame, one] + size[frame, other]))
        reach = p.merge_distance + p.merge_spread * (wander[frame, one] + wander[frame, other]) / math.sqrt(2.0)
        closeness = reach - np.hypot(between[:, 0], between[:, 1])
        linked = closeness > 0.0
        frame, lost, kept = leaders(
            (n, len(bodies.key)), frame[linked], one[linked], other[linked], closeness[linked], distance
        )
        box = box.copy()
        np.minimum.at(box[..., :2], (frame, kept), box[frame, lost, :2])
        np.maximum.at(box[..., 2:], (frame, kept), box[frame, lost, 2:])
        crowd = np.ones(seen.shape)
        np.add.at(crowd, (frame, kept), 1.0)
        pull = np.zeros(foot.shape)
        np.add.at(pull, (frame, kept), foot[frame, lost] - foot[frame, kept])
        foot = foot + _MERGE_PULL * pull / crowd[..., None]
        seen[frame, lost] = False
        apart[frame, kept] = False

        # Who falls apart is found twice: the legs, and a body whose "feet" are at the waist, seemingly farther away.
        apart &= seen
        row, column = np.nonzero(apart)
        upper = box[row, column]
        waist = shown.waist[row, column] - shown.foot[row, column]
        upper[:, 3] = np.maximum(upper[:, 1] + 1.0, upper[:, 3] + np.minimum(waist[:, 1], 0.0))
        box[row, column, 1] = np.minimum(upper[:, 3], box[row, column, 3] - 1.0)
        raised = foot[row, column] + waist
        raised[:, 0] += _SPLIT_ASIDE * self._rng.standard_normal(len(row)) * (upper[:, 2] - upper[:, 0])
        rows, columns = np.nonzero(seen)
        return _Found(
            np.concatenate([rows, row]),
            np.concatenate([foot[rows, columns], raised]),
            np.concatenate([box[rows, columns], upper]),
            np.concatenate([confidence[rows, columns], 0.8 * confidence[row, column]]),
        )

    def _feet(self, bodies: _Bodies, shown: Silhouettes, errors: Array, legs: Array, offset: Array) -> Array:
        """Return where feet are believed to be (n, c, 2), pixels."""
        p = self.parameters
        reach = np.maximum(np.linalg.norm(offset, axis=2), 1e-6)
        toward = -offset / reach[..., None]
        # Where legs are hidden, feet are guessed below the head: who is tall is thought to stand farther away.
        height = float(self.geometry.position[2])
        above = np.maximum(height - bodies.tall, _LEAST_ABOVE)
        guess = reach * (max(height - EXPECTED_HEIGHT, _LEAST_ABOVE) / above - 1.0)
        guess = np.clip(guess, -_FARTHEST_GUESS, _FARTHEST_GUESS) * (1.0 - legs)
        nearer = np.minimum(p.foot_bias, 0.5 * reach) - guess
        ground = bodies.position + nearer[..., None] * toward + p.floor_noise * errors[..., 2:]
        flat = np.concatenate([ground, np.zeros((*ground.shape[:2], 1))], axis=2)
        pixels = self.geometry.to_image(flat.reshape(-1, 3)).reshape(ground.shape)
        spread = p.foot_noise * (shown.box[..., 3] - shown.box[..., 1])
        pixels[..., 0] += spread * errors[..., 0]
        pixels[..., 1] += spread * (1.0 + 1.5 * (1.0 - legs)) * errors[..., 1]
        return pixels

    def _false_alarms(self, numbers: Ints) -> _Found:
        frame, place = self._clutter.next(float(numbers[0]) / self.frames_per_s, len(numbers))
        tall = EXPECTED_HEIGHT * self._rng.uniform(0.5, 1.1, len(frame))
        shown = project_bodies(self.geometry, place, tall)
        return _Found(frame, shown.foot, shown.box, self._rng.uniform(0.35, 0.75, len(frame)))
