"""The original identity filter as a tracker: one cycle a second, every phone that is heard, nobody else.

Added to the original, besides what ``particles`` says: sightings are the people whom the anonymous layer follows
through all frames (``followed``), and a walk speaks for who is followed when the phone has told it, against a
stranger's walk (``walk_evidence``), not by the prediction of the cycle alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.forces import ForceSettings, Obstacles, displacement
from services.fusion.rbmcda.births import birth
from services.fusion.rbmcda.constants import Constants
from services.fusion.rbmcda.filter_cycle import run_cycle
from services.fusion.rbmcda.followed import FollowedPeople
from services.fusion.rbmcda.generators import generator_of, generator_state
from services.fusion.rbmcda.inertial import Displacement, WalkLog
from services.fusion.rbmcda.learned_obstacles import LearnedObstacles
from services.fusion.rbmcda.particles import Cycle, Draws, Estimate, Particles
from services.fusion.rbmcda.present import carried_on
from services.fusion.rbmcda.readings import Readings
from services.fusion.rbmcda.said_again import said_again, without_device
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.sightings import Sightings
from services.fusion.rbmcda.surroundings import Surroundings
from services.fusion.snapshot import counts, encode_snapshot, unpack
from services.fusion.tracker import Chunk, TrackerStateError
from services.fusion.trained_view import same_radio
from shared.messages import Revision, TrackFrame, decode, pack_covariances

__all__ = ["ForcedRbmcdaTracker", "RbmcdaTracker"]

Array = NDArray[np.float64]


class RbmcdaTracker:
    """Where every phone is: particles over (who was seen where), unscented filters given them [ravel-thesis §6]."""

    name = "rbmcda"
    cycle = 1.0

    def __init__(self, view: AreaView, seed: int = 0, settings: RbmcdaSettings | None = None) -> None:
        self.view = view
        self.settings = settings or RbmcdaSettings()
        self._around = Surroundings(view, self.settings)
        self._learned = LearnedObstacles(view) if self.settings.forces else None
        self._generator = np.random.default_rng(seed)
        self._count: Counter[str] = Counter()
        self._next_id = 1
        self._forget_everybody()

    def _forget_everybody(self) -> None:
        self._particles = Particles.empty(self.settings.particles, len(self.view.radio.names))
        self._devices: list[str] = []
        self._ids: list[int] = []
        self._told: dict[str, float] = {}
        self._walks: dict[str, WalkLog] = {}
        self._readings = Readings(self.view.radio, self.settings)
        self._constants = Constants(self._around.bias, self._around.shared)
        self._people = FollowedPeople(self.view, self.settings)
        self._t, self._done = -math.inf, -math.inf
        self._held: tuple[float, Sightings, list[str]] | None = None
        self._said: TrackFrame | None = None

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume one chunk: a cycle."""
        frames = [
            frame
            for frame in chunk.frames
            if frame.camera in self.view.views and frame.floor == self.view.floor and math.isfinite(frame.t)
        ]
        self._ignore("frame of an unknown camera or floor", len(chunk.frames) - len(frames))
        t = max((frame.t for frame in frames), default=self._t)
        if t < self._t - self.settings.set_back or t > self._t + self.settings.forget:
            self._forget_everybody()
        t = max(t, self._t)
        self._listen(chunk, t)
        for erasure in chunk.erasures:
            self._forget(erasure.device)
        if not frames:
            return said_again(self._said, chunk, self.view.area, self.name)
        self._t = t
        for device in [name for name in self._told if t - self._told[name] > self.settings.forget]:
            self._forget(device)
        seen, nonsense = self._people.cycle(frames, t)
        self._ignore("detection off the floor or without an extent", nonsense)
        held, self._held = self._held, (t, seen, sorted({frame.camera for frame in frames}))
        if held is None:
            return said_again(None, chunk, self.view.area, self.name)
        self._said = self._work(chunk, held, seen)
        return self._said

    def _work(self, chunk: Chunk, held: tuple[float, Sightings, list[str]], now: Sightings) -> TrackFrame:
        """Work on the cycle before, whose steps have come by now, and tell where that leaves everybody."""
        t, seen, live = held
        before = self._done if math.isfinite(self._done) else t - self.cycle
        self._done = t
        if self._learned is not None:
            # Who is followed into the next cycle is no flicker of a detector.
            self._learned.add(t, seen.places[np.isin(seen.link, now.link)])
        reading, noise = self._readings.of_cycle(self._told)
        born = self._births(reading, noise)
        motions = [self._walk(device).advance(before, t, self.settings) for device in self._devices]
        cycle = self._cycle(before, t, motions, reading, noise, seen, set(live), born)
        draws = Draws.of(self._generator, self.settings.particles, len(self._devices))
        self._particles, estimate = run_cycle(self._particles, cycle, self.settings, draws)
        finite = estimate.finite()
        if not finite.all():
            # Numbers have overflowed, whatever it was: these begin anew with what they tell next.
            estimate, motions = estimate.of_devices(finite), [motions[index] for index in np.flatnonzero(finite)]
            for device in [self._devices[index] for index in np.flatnonzero(~finite)]:
                self._forget(device)
                self._ignore("phone whose place was no number")
        self._constants.learn(estimate.biases, estimate.fed, t - before)
        self._readings.learn(self._devices, estimate.mean.T, self._around.expected)
        pace = np.array([self._walk(device).pace(self._t) for device in self._devices]).reshape(-1, 2).T
        estimate = carried_on(self._particles, estimate, now, pace, self._t - t, self.settings.guessed)
        return self._frame(chunk, estimate, motions, seen)

    def retune(self, view: AreaView) -> None:
        """Go on under another radio model: everybody is where they were, and biases are of the new model."""
        if same_radio(self.view, view):
            return
        # Of an access point that was placed nowhere, or is now, nothing is believed that a difference could shift.
        compared = self.view.radio.placed & view.radio.placed
        before, self.view = self._around, view
        self._around = Surroundings(view, self.settings)
        # What all phones share is forgotten: the new model may have been taught by the same readings.
        self._constants = Constants(self._around.bias, self._around.shared)

        def less(places: Array) -> Array:
            return np.where(compared, before.expected(places) - self._around.expected(places), 0.0)

        on_grid = less(self._around.grid)[:, compared]
        self._readings.retune(view.radio, float(on_grid.mean()) if on_grid.size else 0.0)
        self._particles = self._particles.retuned(less)

    def revision(self) -> Revision | None:
        """Return nothing: what was said stands."""
        return None

    def ignored(self) -> dict[str, int]:
        """Return how much could not be used so far, by reason."""
        return dict(self._count)

    def snapshot(self) -> Callable[[], bytes]:
        """Copy all the tracker knows; calling the result encodes the copy."""
        particles = self._particles
        return partial(
            encode_snapshot,
            {
                "tracker": self.name,
                "t": self._t if math.isfinite(self._t) else None,
                "done": self._done if math.isfinite(self._done) else None,
                "held": None if self._held is None else (self._held[0], self._held[1].state(), self._held[2]),
                "generator": generator_state(self._generator),
                "particles": {name: getattr(particles, name) for name in _ARRAYS},
                "devices": list(self._devices),
                "ids": list(self._ids),
                "next_id": self._next_id,
                "told": dict(self._told),
                "walks": {device: walk.state() for device, walk in self._walks.items()},
                "readings": self._readings.state(),
                "people": self._people.state(),
                "constants": self._constants.state(),
                "said": self._said,
                "learned": None if self._learned is None else self._learned.state(),
                "ignored": dict(self._count),
            },
        )

    def state(self) -> bytes:
        """Return all the tracker knows, as JSON."""
        return self.snapshot()()

    def restore(self, state: bytes) -> None:
        """Go on from a state of the same tracker."""
        try:
            parts = msgspec.json.decode(state)
            if parts["tracker"] != self.name:
                raise TrackerStateError(f"a state of tracker {parts['tracker']!r}, expected {self.name!r}")
            particles = Particles(**{name: unpack(parts["particles"][name]) for name in _ARRAYS})
            expected = self.settings.particles, len(self.view.radio.names) + 2, len(parts["devices"])
            if (len(particles.weight), len(particles.mean), particles.weight.shape[1]) != expected:
                raise TrackerStateError(f"a state of another number of particles or access points than {expected[:2]}")
            walks = {device: WalkLog.of(walk) for device, walk in parts["walks"].items()}
            readings = Readings(self.view.radio, self.settings)
            readings.restore(parts["readings"])
            people = FollowedPeople(self.view, self.settings)
            people.restore(parts["people"])
            constants = Constants(self._around.bias, self._around.shared)
            constants.restore(parts["constants"])
            learned = None
            if self._learned is not None:
                learned = LearnedObstacles(self.view)
                learned.restore(parts["learned"])
            generator = generator_of(parts["generator"])
            done, held = parts["done"], parts["held"]
            said = None if parts["said"] is None else decode(msgspec.json.encode(parts["said"]), TrackFrame)
            if held is not None:
                held = float(held[0]), Sightings.of(held[1]), list(held[2])
            t, count = parts["t"], counts(parts["ignored"])
            devices, ids, next_id, told = parts["devices"], parts["ids"], parts["next_id"], parts["told"]
        except TrackerStateError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise TrackerStateError(f"not a state of tracker {self.name!r}: {error}") from error
        self._particles, self._walks, self._readings, self._generator = particles, walks, readings, generator
        self._devices, self._ids, self._next_id, self._told = devices, ids, next_id, told
        self._people, self._constants, self._held, self._learned = people, constants, held, learned
        self._done = -math.inf if done is None else done
        self._t, self._count, self._said = -math.inf if t is None else t, count, said

    def _ignore(self, reason: str, count: int = 1) -> None:
        if count:
            self._count[reason] += count

    def _walk(self, device: str) -> WalkLog:
        return self._walks.setdefault(device, WalkLog())

    def _listen(self, chunk: Chunk, t: float) -> None:
        """Note what phones told, up to a few seconds around the cycle."""
        for scan in chunk.scans:
            if scan.late or not abs(t - scan.t) < self.settings.forget:
                self._ignore("radio of another time")
            elif self._readings.take(scan):
                self._told[scan.device] = max(scan.t, self._told.get(scan.device, scan.t))
            else:
                self._ignore("radio without a known access point")
        for motion in chunk.motions:
            if motion.late or not abs(t - motion.t) < self.settings.forget:
                self._ignore("motion of another time")
                continue
            walk = self._walks.get(motion.device, WalkLog())
            if walk.take(motion):
                self._walks[motion.device] = walk
                if not self._people.walks.take(motion):
                    self._ignore("motion told again or out of order")
                self._told[motion.device] = max(motion.t, self._told.get(motion.device, motion.t))
            else:
                self._ignore("motion without a time")

    def _forget(self, device: str) -> None:
        self._told.pop(device, None)
        self._walks.pop(device, None)
        self._readings.forget(device)
        self._people.walks.forget(device)
        if self._said is not None:
            self._said = without_device(self._said, device)
        if device in self._devices:
            index = self._devices.index(device)
            self._particles = self._particles.without(index)
            del self._devices[index], self._ids[index]

    def _births(self, reading: dict[str, Array], noise: dict[str, Array]) -> dict[int, tuple[Array, Array, float]]:
        """Return where each device that was heard may be as far as this scan tells; let new ones exist, out of view."""
        around, usual, anew = self._around, self._constants.mean, {}
        for device, level in reading.items():
            found = birth(around.grid, around.expected_on_grid, level, noise[device], self._constants.bias, usual)
            if device not in self._devices:
                self._particles = self._particles.with_device(found[0], found[1])
                self._devices.append(device)
                self._ids.append(self._next_id)
                self._next_id += 1
                reading[device] = np.full_like(level, np.nan)
            else:
                anew[self._devices.index(device)] = found
        return anew

    def _cycle(
        self,
        before: float,
        t: float,
        motions: Sequence[Displacement],
        reading: dict[str, Array],
        noise: dict[str, Array],
        seen: Sightings,
        live: set[str],
        anew: dict[int, tuple[Array, Array, float]],
    ) -> Cycle:
        settings, count = self.settings, len(self._devices)
        access_points = len(self.view.radio.names)
        silent, free = np.full(access_points, np.nan), np.ones(access_points)
        packed = np.array([motion.variance for motion in motions]).reshape(count, 3).T
        path = np.array([motion.path for motion in motions])
        still = np.array([self._walk(device).still_for(t) for device in self._devices])
        shift = np.array([motion.shift for motion in motions]).reshape(count, 2).T
        lasting = settings.detection - settings.detection_still
        cycle = Cycle(
            t=t,
            shift=shift,
            owed=np.array([motion.owed for motion in motions]).reshape(count, 2).T,
            spread=packed[np.array([[0, 1], [1, 2]])],
            haste=np.array([motion.haste for motion in motions]),
            kept=self._around.kept(path, t - before),
            usual=self._constants.mean,
            bias=self._constants.bias,
            reading=np.array([reading.get(device, silent) for device in self._devices]).reshape(count, access_points).T,
            noise=np.array([noise.get(device, free) for device in self._devices]).reshape(count, access_points).T
            * np.where(path > 0.1, 1.0, settings.resting),
            expected=self._around.expected,
            places=seen.places,
            place_noise=seen.noise,
            link=seen.link,
            switched=self._switched(seen.places),
            favour=np.exp(settings.trust_motion * self._people.walks.of_cycle(self._devices, t, seen.link)),
            pickup=self._people.pickup(t, seen.link),
            detection=settings.detection_still + lasting * np.exp(-still / settings.fading),
            in_view=partial(self._around.in_view, live),
            density=max(len(seen.places), 1) / self._around.floor_seen(live),
            anew=anew,
        )
        if self._learned is None or not count:
            return cycle
        dt, obstacles = min(max(t - before, 0.0), self.cycle), self._learned.obstacles
        return replace(cycle, push=partial(_push, shift=shift, dt=dt, obstacles=obstacles))

    def _switched(self, places: Array) -> Array:
        """Return (d,) how probably each of the people at (d, 2) places has become another since the last cycle."""
        s = self.settings
        apart = np.hypot(*(places[:, None] - places[None]).T)
        np.fill_diagonal(apart, math.inf)
        near = np.exp(-((apart.min(axis=0, initial=math.inf) / s.met_range) ** 2))
        rate: Array = s.switched + s.met * near
        return rate

    def _frame(self, chunk: Chunk, estimate: Estimate, motions: Sequence[Displacement], seen: Sightings) -> TrackFrame:
        t = max((frame.t for frame in chunk.frames if math.isfinite(frame.t)), default=chunk.t_start)
        count = len(self._devices)
        state: list[Literal["confirmed", "coasting", "unseen"]] = []
        sources = []
        for index in range(count):
            mine = estimate.seen_as[:, index]
            weight = np.bincount(mine[mine >= 0], estimate.weight[mine >= 0, index], len(seen.places))
            fed = bool(estimate.fed[index] > 0.5)
            gone = self._t - estimate.seen[index] > self.settings.lost
            state.append("confirmed" if fed else "unseen" if gone else "coasting")
            sources.append((list(seen.cameras[int(weight.argmax())]) if fed else []) + [self._devices[index]])
        return TrackFrame(
            t=t,
            area=self.view.area,
            chunk=chunk.index,
            tracker=self.name,
            track=list(self._ids),
            floor=[self.view.floor] * count,
            x=estimate.mean[0].tolist(),
            y=estimate.mean[1].tolist(),
            vx=[motion.shift[0] / self.cycle for motion in motions],
            vy=[motion.shift[1] / self.cycle for motion in motions],
            covariance=pack_covariances(np.moveaxis(estimate.covariance, -1, 0)),
            state=state,
            device=list(self._devices),
            probability=estimate.agreed.tolist(),
            runner_up=[None] * count,
            runner_up_probability=[0.0] * count,
            former=[[] for _ in range(count)],
            sources=sources,
            quality=estimate.agreed.tolist(),
        )


class ForcedRbmcdaTracker(RbmcdaTracker):
    """The same with social forces in the prediction [ravel-thesis §7]."""

    name = "rbmcda-forces"

    def __init__(self, view: AreaView, seed: int = 0, settings: RbmcdaSettings | None = None) -> None:
        super().__init__(view, seed, replace(settings or RbmcdaSettings(), forces=True))


_ARRAYS = ("weight", "mean", "covariance", "state", "fed", "seen", "link")


def _push(
    positions: Array, alive: NDArray[np.bool_], shift: Array, dt: float, obstacles: Obstacles
) -> tuple[Array, Array]:
    """Return what forces add to (2, N, X) predictions, and the Jacobian (2, 2, N, X)."""
    walking = np.hypot(shift[0], shift[1]) > 0.1
    heading = np.where(walking, np.arctan2(shift[1], shift[0]), np.nan)
    places = np.moveaxis(positions, 0, -1)
    push, slope = displacement(
        places,
        alive,
        np.broadcast_to(heading, alive.shape),
        obstacles,
        ForceSettings(dt=dt),
        np.broadcast_to(shift.T, places.shape),
    )
    return np.moveaxis(push, -1, 0), np.moveaxis(slope, (2, 3), (0, 1))
