"""The vision-only particle filter as a tracker: everybody, nobody by name, once a second [ravel-thesis §10]."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.rbmcda.generators import generator_of, generator_state
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.sight_particles import Particles, RbmcdaParameters, View
from services.fusion.rbmcda.sightings import SightingLinks
from services.fusion.snapshot import counts, encode_snapshot
from services.fusion.tracker import Chunk, TrackerStateError
from shared.messages import DetectionFrame, Revision, TrackFrame, pack_covariances

__all__ = ["VisionRbmcdaTracker"]


class VisionRbmcdaTracker:
    """Everybody in view, by sightings alone."""

    name = "rbmcda-vision"
    cycle = 1.0

    def __init__(self, view: AreaView, seed: int = 0, parameters: RbmcdaParameters | None = None) -> None:
        self.view = view
        self._parameters = replace(parameters or RbmcdaParameters(), seed=seed)
        self._count: Counter[str] = Counter()
        self._start()

    def _start(self) -> None:
        self._t = -math.inf
        everywhere = self.view.everywhere
        rows, columns = np.nonzero(everywhere.depth > 0.0)
        corners = everywhere.origin + everywhere.cell * (np.column_stack([columns, rows]) + 0.5)
        if len(corners) < 3:
            corners = np.array([self.view.lower, [self.view.upper[0], self.view.lower[1]], self.view.upper])
        self._particles = Particles(View(corners), self._parameters)
        self._links = SightingLinks(self.view.lower, self.view.upper, RbmcdaSettings())

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume one chunk: a cycle."""
        frames = [
            frame
            for frame in chunk.frames
            if frame.camera in self.view.views and frame.floor == self.view.floor and math.isfinite(frame.t)
        ]
        if len(frames) < len(chunk.frames):
            self._count["frame of an unknown camera or floor"] += len(chunk.frames) - len(frames)
        told = max((frame.t for frame in chunk.frames if math.isfinite(frame.t)), default=chunk.t_start)
        empty = TrackFrame(t=told, area=self.view.area, chunk=chunk.index, tracker=self.name)
        if frames:
            self._look(frames)
        ids, states = self._particles.people()
        fed = [bool(frames) and self._particles.seen_last(int(who)) >= self._t for who in ids]
        count = len(ids)
        return msgspec.structs.replace(
            empty,
            track=[int(who) + 1 for who in ids],
            floor=[self.view.floor] * count,
            x=states[:, 0].tolist(),
            y=states[:, 1].tolist(),
            vx=states[:, 2].tolist(),
            vy=states[:, 3].tolist(),
            covariance=pack_covariances(self._particles.covariances()),
            state=["confirmed" if now else "coasting" for now in fed],
            device=[None] * count,
            probability=[1.0] * count,
            runner_up=[None] * count,
            runner_up_probability=[0.0] * count,
            former=[[] for _ in range(count)],
            sources=[sorted({frame.camera for frame in frames}) if now else [] for now in fed],
            quality=[1.0 if now else 0.5 for now in fed],
        )

    def _look(self, frames: Sequence[DetectionFrame]) -> None:
        """Take in what the cameras saw in a cycle."""
        newest = max(frame.t for frame in frames)
        if newest < self._t - RbmcdaSettings().set_back:
            generator = self._particles.generator
            self._start()
            self._particles.generator = generator
        self._t = max(newest, self._t)
        seen, nonsense = self._links.cycle(frames, self._t)
        if nonsense:
            self._count["detection off the floor or without an extent"] += nonsense
        self._particles.scan(self._t, seen.places, seen.noise)

    def retune(self, view: AreaView) -> None:
        """Go on under another radio model, which says nothing about people as cameras see them."""
        self.view = view

    def revision(self) -> Revision | None:
        """Return nothing: what was said stands."""
        return None

    def ignored(self) -> dict[str, int]:
        """Return how much could not be used so far, by reason."""
        return dict(self._count)

    def snapshot(self) -> Callable[[], bytes]:
        """Copy all the tracker knows; calling the result encodes the copy."""
        parts: dict[str, Any] = {
            "tracker": self.name,
            "t": self._t if math.isfinite(self._t) else None,
            "generator": generator_state(self._particles.generator),
            "particles": self._particles.state(),
            "links": self._links.state(),
            "ignored": dict(self._count),
        }
        return partial(encode_snapshot, parts)

    def state(self) -> bytes:
        """Return all the tracker knows, as JSON."""
        return self.snapshot()()

    def restore(self, state: bytes) -> None:
        """Go on from a state of the same tracker."""
        fresh = VisionRbmcdaTracker(self.view, self._parameters.seed, self._parameters)
        try:
            parts = msgspec.json.decode(state)
            if parts["tracker"] != self.name:
                raise TrackerStateError(f"a state of tracker {parts['tracker']!r}, expected {self.name!r}")
            fresh._particles.restore(parts["particles"])
            fresh._links.restore(parts["links"])
            fresh._particles.generator = generator_of(parts["generator"])
            t, count = parts["t"], counts(parts["ignored"])
        except TrackerStateError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise TrackerStateError(f"not a state of tracker {self.name!r}: {error}") from error
        self._particles, self._links = fresh._particles, fresh._links
        self._t, self._count = -math.inf if t is None else t, count
