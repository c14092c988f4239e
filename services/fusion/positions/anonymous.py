"""Where is everybody? An anonymous tracker on the ground plane: one Kalman bank, one assignment per camera frame.

Gated global nearest neighbour on Mahalanobis² + log det; a track that costs too much is rather missed. Tracks are
confirmed by enough confident detections over enough time. Of a track that is missed, the probability that the person is
still there falls with a hazard per state: fast where it leaves the view, in a second or two where it was moving, ten
times as slowly where it stood still, because detectors with a background model lose people who stand. Cameras' clocks
are compared by people whom two of them see. Every duration is in seconds, because cameras deliver anything from 2 to
30 frames a second.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.positions import kalman_bank
from services.fusion.positions.assignment import assign
from services.fusion.positions.believable import limits, usable
from services.fusion.positions.camera_clocks import CameraClocks
from services.fusion.positions.settings import AnonymousSettings
from services.fusion.positions.track_table import TrackTable
from services.fusion.snapshot import counts
from shared.messages import DetectionFrame

__all__ = ["AnonymousLayer", "AnonymousSettings", "TrackTable"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
Rows = Integers | slice

MOST_CAMERAS = 63
"""Which cameras fed a track is kept as bits of a signed 64-bit integer."""
LIFETIMES = 3.0
"""A track is dead once its probability of being there has fallen to exp(−this)."""
SLACK = 1e-6
"""Of probabilities, so that as many misses mean the same at any time of day."""
DEAD = math.exp(-LIFETIMES) * (1.0 + SLACK)
MATRIX = np.array([2, 3, 3, 4])
"""Of x, y, xx, xy, yy: those that make a covariance."""
QUALITY_TIME = 3.0
"""Seconds over which ``quality`` averages."""


class AnonymousLayer:
    """Tracks of one area; feed it frames in the order they were consumed.

    Attributes:
        tracks: see ``TrackTable``; ``told()`` says which of them are people to be told of.
        t: the newest time, by most cameras' clocks.
        clocks: how the cameras' clocks differ; their frames' times are set right by it.
        ignored: how much could not be used, by reason.
    """

    def __init__(self, view: AreaView, settings: AnonymousSettings | None = None) -> None:
        if len(view.views) > MOST_CAMERAS:
            raise ValueError(f"area {view.area!r} has {len(view.views)} cameras; allowed: at most {MOST_CAMERAS}")
        self.view = view
        self.settings = settings or AnonymousSettings()
        self.cameras = sorted(view.views)
        self._camera_number = {camera: number for number, camera in enumerate(self.cameras)}
        self.tracks = TrackTable.empty()
        self.t = -math.inf
        self.clocks = CameraClocks(self.cameras)
        self.ignored: Counter[str] = Counter()
        self._next_id = 1
        self._last_frame: dict[str, float] = {}
        self._limits = limits(view.lower, view.upper)

    def begin_chunk(self) -> None:
        """Forget which cameras fed the tracks before."""
        self.tracks.fed.fill(0)

    def new_id(self) -> int:
        """Return a track id that no track has had or will have, for somebody whom no camera sees."""
        self._next_id += 1
        return self._next_id - 1

    def told(self) -> Flags:
        """Return which tracks (n,) are people more likely there than not."""
        told: Flags = self.tracks.confirmed & (self.tracks.existence >= self.settings.told * (1.0 - SLACK))
        return told

    def names_of(self, fed: Sequence[int]) -> list[list[str]]:
        """Return the names of the cameras that each of some tracks' ``fed`` stands for, a list of its own for each."""
        names = {mask: [name for bit, name in enumerate(self.cameras) if mask >> bit & 1] for mask in set(fed)}
        return [names[mask].copy() for mask in fed]

    def observe(self, frame: DetectionFrame) -> None:
        """Take in what one camera saw."""
        number = self._camera_number.get(frame.camera)
        if number is None or frame.floor != self.view.floor or not math.isfinite(frame.t):
            self.ignored["frame of an unknown camera or floor"] += 1
            return
        s = self.settings
        t = frame.t - float(self.clocks.offsets[number])
        if math.isfinite(self.t) and (t - self.t > s.forget or t < self.t - s.set_back):
            # A long silence or a clock set back: who stands there now is not known to be who stood there then.
            self.tracks.keep(np.zeros(len(self.tracks.ids), np.bool_))
            self._last_frame.clear()
            self.t = t
        positions, noise, confidence = self._usable(frame)
        self._advance(t)
        lag = self.t - t
        before = self._last_frame.get(frame.camera, frame.t)
        self._last_frame[frame.camera] = max(frame.t, before)
        interval = min(max(frame.t - before, 0.0), s.longest_interval)
        free = self._match(number, frame.t, lag, positions, noise, confidence, interval)
        if len(free):
            self._give_birth(number, frame.t, t, positions[free], noise[free], confidence[free])

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        return {
            "t": self.t if math.isfinite(self.t) else None,
            "next_id": self._next_id,
            "last_frame": dict(self._last_frame),
            "ignored": dict(self.ignored),
            "clocks": self.clocks.state(),
            "tracks": self.tracks.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        table, clocks = TrackTable.restored(state["tracks"]), CameraClocks(self.cameras)
        clocks.restore(state["clocks"])
        t, next_id, ignored = state["t"], int(state["next_id"]), counts(state["ignored"])
        last_frame = {str(camera): float(when) for camera, when in state["last_frame"].items()}
        self.tracks, self.t, self._next_id, self.ignored = table, -math.inf if t is None else float(t), next_id, ignored
        self._last_frame, self.clocks = last_frame, clocks

    def _usable(self, frame: DetectionFrame) -> tuple[Array, Array, Array]:
        """Return position (n, 2), covariance (n, 2, 2), confidence (n,) of the usable detections, in canonical order.

        The order in which a detector lists people means nothing; sorted, it cannot change a bit of the result.
        """
        if not frame.x:
            return np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
        columns = np.array([frame.x, frame.y, *zip(*frame.covariance, strict=True), frame.confidence])
        good = usable(columns, *self._limits)
        useless = len(good) - int(np.count_nonzero(good))
        if useless:
            self.ignored["detection off the floor or without an extent"] += useless
            columns = columns[:, good]
        columns = columns.take(np.lexsort(columns), axis=1)
        return columns[:2].T, columns.take(MATRIX, axis=0).T.reshape(-1, 2, 2), columns[5]

    def _advance(self, t: float) -> None:
        tracks, s = self.tracks, self.settings
        if t > self.t and len(tracks.ids):
            dt = min(t - self.t, s.forget)
            resting = tracks.resting.nonzero()[0]
            if len(resting):
                held = kalman_bank.hold(
                    tracks.mean[resting], tracks.covariance[resting], dt, s.rest_diffusion, s.start_speed
                )
            kalman_bank.predict(tracks.mean, tracks.covariance, dt, s.acceleration)
            unseen = (tracks.missed > 0.0).nonzero()[0]
            if len(unseen):
                tracks.mean[unseen, 2:] *= math.exp(-dt / s.slow_down)
            if len(resting):
                tracks.mean[resting], tracks.covariance[resting] = held
        self.t = max(self.t, t)

    def _match(
        self, camera: int, clock: float, lag: float, positions: Array, noise: Array, confidence: Array, interval: float
    ) -> Integers:
        """Give detections to tracks, count misses, bury the dead; return which detections are left."""
        tracks, s = self.tracks, self.settings
        count, found = len(tracks.ids), len(positions)
        free = np.arange(found)
        if not count:
            return free
        unseen = np.ones(count, np.bool_)
        if found:
            distance, mahalanobis, log_det = kalman_bank.innovations(
                tracks.mean, tracks.covariance, positions, noise, lag
            )
            log_det += np.where(tracks.confirmed, -2.0 * np.log(tracks.existence), s.tentative_penalty)[:, None]
            near = distance < s.gate_distance**2
            if np.count_nonzero(tracks.resting):
                near &= ~tracks.resting[:, None] | (distance < s.rest_gate**2)
            near &= (mahalanobis < s.gate**2) & np.isfinite(log_det)
            cost = np.where(near, mahalanobis + log_det, s.dearest)
            rows, columns = assign(cost, s.dearest)
            if len(rows):
                unseen[rows] = False
                seen: Rows = rows
                if len(rows) == count:
                    # Everybody, as nearly always where few people are about: columns are faster read whole.
                    seen, columns = slice(None), columns[rows.argsort()]
                given = positions.take(columns, axis=0), noise.take(columns, axis=0), confidence.take(columns)
                self._feed(seen, camera, clock, lag, given, interval)
                if len(columns) < found:
                    # What lies beside an established track, or beside one another camera just saw, is its double.
                    established = tracks.confirmed
                    if len(self.cameras) > 1:
                        just_seen = self.t - lag - tracks.seen < s.confirm_age
                        established = established | (just_seen & (tracks.camera != camera))
                    alone: Flags = ~np.logical_or.reduce(
                        established[:, None] & (distance < s.birth_exclusion**2), axis=0
                    )
                    alone[columns] = False
                    free = alone.nonzero()[0]
                else:
                    free = free[:0]
        missed = unseen.nonzero()[0]
        if len(missed):
            if interval:
                self._count_misses(camera, self.t - lag, missed, interval)
            self._bury(unseen, self.t - lag)
        return free

    def _feed(
        self,
        rows: Rows,
        camera: int,
        clock: float,
        lag: float,
        given: tuple[Array, Array, Array],
        interval: float,
    ) -> None:
        tracks, s = self.tracks, self.settings
        positions, noise, weight = given
        t = self.t - lag
        common = s.lasting * noise
        if len(self.cameras) > 1:
            # The lasting errors of two cameras are not the same.
            common[(tracks.camera[rows] != camera) & (t - tracks.seen[rows] < QUALITY_TIME)] *= 0.5
            fixes, velocity = tracks.fix[rows], tracks.mean[rows, 2:]
            self.clocks.learn(camera, clock, tracks.camera[rows], fixes, velocity, positions)
            tracks.fix[rows, :2] = positions
            tracks.fix[rows, 2] = clock
        mean, covariance = kalman_bank.update(tracks.mean[rows], tracks.covariance[rows], positions, noise, lag)
        tracks.mean[rows], tracks.covariance[rows] = mean, covariance
        tracks.common[rows] = common
        seen = tracks.seen[rows]
        newer = np.maximum(seen, t)
        settled = np.exp((seen - newer) / s.still_time)[:, None]
        tracks.anchor[rows] = mean[:, :2] + settled * (tracks.anchor[rows] - mean[:, :2])
        tracks.seen[rows] = newer
        if np.count_nonzero(tracks.walked) < len(tracks.walked):
            tracks.walked[rows] |= ((mean[:, :2] - tracks.origin[rows]) ** 2).sum(axis=1) > s.walked**2
        if np.count_nonzero(tracks.resting):
            tracks.woke[rows] = np.where(tracks.resting[rows], t, tracks.woke[rows])
            tracks.resting[rows] = False
        tracks.missed[rows] = 0.0
        tracks.existence[rows] = 1.0
        tracks.hits[rows] += 1
        tracks.score[rows] += weight
        tracks.quality[rows] = 1.0 - math.exp(-interval / QUALITY_TIME) * (1.0 - tracks.quality[rows])
        tracks.camera[rows] = camera
        tracks.fed[rows] |= 1 << camera
        if np.count_nonzero(tracks.confirmed) < len(tracks.confirmed):
            grown = (
                ~tracks.confirmed
                & (tracks.score >= s.confirm_confidence)
                & (tracks.hits >= s.confirm_hits)
                & (tracks.seen - tracks.born >= s.confirm_age)
            )
            tracks.confirmed |= grown
            for row in grown.nonzero()[0].tolist():
                self._recognise(row)

    def _recognise(self, row: int) -> None:
        """Give a newcomer who walks away from a resting track that track's id: it is the person who rested there.

        A background model that has learned a person takes the floor they left for them, a ghost, and so the resting
        track may go on being fed; it keeps the newcomer's id and may rest no more.
        """
        tracks, s = self.tracks, self.settings
        away = np.hypot(*(tracks.mean[:, :2] - tracks.origin[row]).T)
        left = tracks.resting | (np.abs(tracks.woke - tracks.born[row]) <= s.rose_time)
        still = ((tracks.mean[:, :2] - tracks.anchor) ** 2).sum(axis=1) < s.still_radius**2
        left &= still & tracks.confirmed & (away < s.rose_distance)
        left[row] = False
        moving = ((tracks.mean[row, :2] - tracks.anchor[row]) ** 2).sum() > (0.5 * s.still_radius) ** 2
        if not moving or not left.any():
            return
        old = int(np.argmin(np.where(left, away, np.inf)))
        for column in (tracks.ids, tracks.born, tracks.walked, tracks.origin):
            column[[old, row]] = column[[row, old]]
        if tracks.resting[old]:
            tracks.existence[old] = 0.0

    def _count_misses(self, camera: int, t: float, rows: Integers, interval: float) -> None:
        """A track is missed by a camera that sees its place, did not see it, and has nobody else who just did.

        Args:
            camera: number of the camera.
            t: time of its frame.
            rows: (m,), of the tracks that it did not see.
            interval: seconds since its frame before; of a longer silence, ``longest_interval`` of it.
        """
        tracks, s = self.tracks, self.settings
        looks: Flags = t - tracks.seen[rows] >= 0.9 * interval
        if len(self.cameras) > 1:
            places = tracks.mean[rows, :2]
            sees = self.view.views[self.cameras[camera]].depth_at(places) > 0.0
            looks &= sees | (self.view.everywhere.depth_at(places) <= 0.0)
        rows = rows[looks]
        if len(rows):
            places, seen = tracks.mean[rows, :2], tracks.seen[rows]
            # However many cameras look, a second without a detection is one second.
            looked = tracks.looked[rows]
            elapsed = np.minimum(np.maximum(t - np.maximum(seen, looked), 0.0), interval)
            tracks.looked[rows] = np.maximum(looked, t)
            missed = tracks.missed[rows] + elapsed
            tracks.missed[rows] = missed
            tracks.quality[rows] *= np.exp(-elapsed / QUALITY_TIME)
            still = ((places - tracks.anchor[rows]) ** 2).sum(axis=1) < s.still_radius**2
            still &= missed > 0.0
            if np.count_nonzero(still):
                tracks.resting[rows] |= still & tracks.confirmed[rows] & tracks.walked[rows]
            tracks.existence[rows] *= np.exp(-self._hazard(rows, places) * elapsed)

    def _bury(self, unseen: Flags, t: float) -> None:
        """Let go of who has surely left, at any frame rate."""
        tracks, s = self.tracks, self.settings
        dead = unseen & ((tracks.existence <= DEAD) | (~tracks.resting & (t - tracks.seen >= s.forget)))
        if dead.any():
            tracks.keep(~dead)

    def _hazard(self, rows: Integers, places: Array) -> Array:
        """Return (m,) by how much of itself each second of misses lowers the existence of tracks in ``rows``.

        Args:
            rows: (m,).
            places: (m, 2) metres.
        """
        tracks, s = self.tracks, self.settings
        soon = places + s.look_ahead * tracks.mean[rows, 2:]
        depth, ahead = self.view.everywhere.depth_at(np.concatenate([places, soon])).reshape(2, -1)
        resting = tracks.resting[rows]
        fade = -math.log(s.told)
        told = tracks.existence[rows] > s.told * (1.0 + SLACK)
        hazard: Array = np.where(told, fade / s.report, (LIFETIMES - fade) / (s.coast - s.report))
        if np.count_nonzero(resting):
            held = np.where(told, fade / s.rest_report, (LIFETIMES - fade) / (s.rest - s.rest_report))
            hazard = np.where(resting & (depth >= s.leaving_depth), held, hazard)
        hazard[~resting & (ahead < np.minimum(depth, s.leaving_depth))] = LIFETIMES / s.coast_leaving
        hazard[~tracks.confirmed[rows]] = LIFETIMES / s.tentative_patience
        return hazard

    def _give_birth(
        self, camera: int, clock: float, t: float, positions: Array, noise: Array, confidence: Array
    ) -> None:
        s = self.settings
        sure = confidence >= s.birth_confidence
        count = int(sure.sum())
        if not count:
            return
        mean, covariance = kalman_bank.start(positions[sure], noise[sure], s.start_speed)
        ids = np.arange(self._next_id, self._next_id + count)
        self._next_id += count
        self.tracks.append(
            TrackTable.start(ids, mean, covariance, s.lasting * noise[sure], t, confidence[sure], camera, clock)
        )
