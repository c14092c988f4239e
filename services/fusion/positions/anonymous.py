"""Where is everybody? An anonymous tracker on the ground plane: one Kalman bank, one assignment per camera frame.

Gated global nearest neighbour on Mahalanobis² + log det; tracks are confirmed by enough confident detections over
enough time, coast through misses, and die sooner where they leave the view. Every duration is in seconds, because
cameras deliver anything from 2 to 30 frames a second.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, fields
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from services.fusion.area_view import AreaView
from services.fusion.positions import kalman_bank
from services.fusion.snapshot import counts, unpack
from shared.messages import DetectionFrame

__all__ = ["AnonymousLayer", "AnonymousSettings", "TrackTable"]

Array = NDArray[np.float64]

MOST_CAMERAS = 63
"""Which cameras fed a track is kept as bits of a signed 64-bit integer."""
FORBIDDEN = 1e6
"""Cost of a pair outside the gate; larger than any sum of costs inside."""


@dataclass(frozen=True)
class AnonymousSettings:
    """How people move and how cameras err; the defaults suit walking people anywhere."""

    acceleration: float = 0.2
    """Spectral density of the white acceleration, m²/s³."""
    start_speed: float = 1.0
    """Standard deviation of a new person's velocity along each axis, m/s."""
    gate: float = 3.0
    """Standard deviations, and ``gate_distance`` metres: farther detections never belong to a track."""
    gate_distance: float = 2.0
    tentative_penalty: float = 6.0
    """Added to an unconfirmed track's cost: at equal distance the established track gets the detection."""
    birth_confidence: float = 0.3
    birth_exclusion: float = 0.8
    """Metres around an established track within which an unmatched detection is taken for its double."""
    confirm_confidence: float = 2.0
    """Sum of confidences, number of detections and age in seconds that confirm a track."""
    confirm_hits: int = 3
    confirm_age: float = 0.5
    tentative_patience: float = 0.25
    """Seconds of misses after which an unconfirmed track dies."""
    coast: float = 2.0
    """Seconds of misses after which a confirmed track dies."""
    coast_leaving: float = 0.3
    """The same where the track leaves the view."""
    leaving_depth: float = 0.3
    """Metres from the border of the view, ``look_ahead`` seconds from now, that count as leaving."""
    look_ahead: float = 0.3
    forget: float = 10.0
    """Seconds without any detection, cameras silent or not, after which a track dies."""
    set_back: float = 1.0
    """Seconds by which a frame must be older than the newest to be no late frame but of a clock set back."""
    slow_down: float = 2.8
    """Time constant with which an unseen person's assumed velocity fades, seconds."""
    report: float = 0.5
    """Seconds of misses during which a coasting track is still told."""
    longest_interval: float = 1.0
    """Seconds; a camera silent for longer has not missed anybody meanwhile."""


@dataclass
class TrackTable:
    """All tracks, one row each."""

    ids: NDArray[np.int64]
    mean: Array
    covariance: Array
    born: Array
    seen: Array
    missed: Array
    hits: NDArray[np.int64]
    score: Array
    confirmed: NDArray[np.bool_]
    quality: Array
    camera: NDArray[np.int64]
    fed: NDArray[np.int64]

    @classmethod
    def empty(cls) -> TrackTable:
        """Return a table without rows."""
        integers, numbers = np.zeros(0, np.int64), np.zeros(0)
        return cls(
            ids=integers,
            mean=np.zeros((0, 4)),
            covariance=np.zeros((0, 4, 4)),
            born=numbers,
            seen=numbers,
            missed=numbers,
            hits=integers,
            score=numbers,
            confirmed=np.zeros(0, np.bool_),
            quality=numbers,
            camera=integers,
            fed=integers,
        )

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drop all other rows."""
        for name in _COLUMNS:
            setattr(self, name, getattr(self, name)[rows])

    def append(self, other: TrackTable) -> None:
        """Add the rows of another table."""
        for name in _COLUMNS:
            setattr(self, name, np.concatenate([getattr(self, name), getattr(other, name)]))


_COLUMNS = tuple(field.name for field in fields(TrackTable))


class AnonymousLayer:
    """Tracks of one area; feed it frames in the order they were consumed."""

    def __init__(self, view: AreaView, settings: AnonymousSettings | None = None) -> None:
        if len(view.views) > MOST_CAMERAS:
            raise ValueError(f"area {view.area!r} has {len(view.views)} cameras; allowed: at most {MOST_CAMERAS}")
        self.view = view
        self.settings = settings or AnonymousSettings()
        self.cameras = sorted(view.views)
        self._camera_number = {camera: number for number, camera in enumerate(self.cameras)}
        self.tracks = TrackTable.empty()
        self.t = -math.inf
        self._next_id = 1
        self._last_frame: dict[str, float] = {}
        self.ignored: Counter[str] = Counter()

    def begin_chunk(self) -> None:
        """Forget which cameras fed the tracks before."""
        self.tracks.fed = np.zeros_like(self.tracks.fed)

    def observe(self, frame: DetectionFrame) -> None:
        """Take in what one camera saw."""
        number = self._camera_number.get(frame.camera)
        if number is None or frame.floor != self.view.floor or not math.isfinite(frame.t):
            self.ignored["frame of an unknown camera or floor"] += 1
            return
        known, s = math.isfinite(self.t), self.settings
        if known and (frame.t - self.t > s.forget or frame.t < self.t - s.set_back):
            # A long silence or a clock set back: who stands there now is not known to be who stood there then.
            self.tracks.keep(np.zeros(len(self.tracks.ids), np.bool_))
            self._last_frame.clear()
            self.t = frame.t
        positions, noise, confidence = self._usable(frame)
        self._advance(frame.t)
        lag = self.t - frame.t
        interval = frame.t - self._last_frame.get(frame.camera, frame.t)
        self._last_frame[frame.camera] = max(frame.t, self._last_frame.get(frame.camera, frame.t))
        interval = interval if 0.0 < interval <= self.settings.longest_interval else 0.0
        free = self._match(number, frame.t, lag, positions, noise, confidence, interval)
        if len(free):
            self._give_birth(number, frame.t, positions[free], noise[free], confidence[free])

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        return {
            "t": self.t if math.isfinite(self.t) else None,
            "next_id": self._next_id,
            "last_frame": dict(self._last_frame),
            "ignored": dict(self.ignored),
            "tracks": {name: getattr(self.tracks, name).copy() for name in _COLUMNS},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        table = TrackTable(**{name: unpack(state["tracks"][name]) for name in _COLUMNS})
        t, next_id, ignored = state["t"], int(state["next_id"]), counts(state["ignored"])
        last_frame = {str(camera): float(when) for camera, when in state["last_frame"].items()}
        if {len(getattr(table, name)) for name in _COLUMNS} != {len(table.ids)}:
            raise msgspec.ValidationError("track columns of different lengths")
        self.tracks, self.t, self._next_id, self.ignored = table, -math.inf if t is None else float(t), next_id, ignored
        self._last_frame = last_frame

    def _usable(self, frame: DetectionFrame) -> tuple[Array, Array, Array]:
        """Return position (n, 2), covariance (n, 2, 2), confidence (n,) of the usable detections, in canonical order.

        The order in which a detector lists people means nothing; sorted, it cannot change a bit of the result.
        """
        rows = np.array(
            [(x, y, *c, p) for x, y, c, p in zip(frame.x, frame.y, frame.covariance, frame.confidence, strict=True)],
            dtype=np.float64,
        ).reshape(-1, 6)
        if len(rows):
            xx, xy, yy = rows[:, 2], rows[:, 3], rows[:, 4]
            usable = np.isfinite(rows).all(axis=1) & (xx > 0.0) & (yy > 0.0) & (xx * yy > xy * xy)
            usable &= ((rows[:, :2] >= self.view.lower) & (rows[:, :2] <= self.view.upper)).all(axis=1)
            if not usable.all():
                self.ignored["detection off the floor or without an extent"] += int(len(rows) - usable.sum())
                rows = rows[usable]
            if len(rows) > 1:
                rows = rows[np.lexsort(rows.T)]
        return rows[:, :2], rows[:, [2, 3, 3, 4]].reshape(-1, 2, 2), rows[:, 5]

    def _advance(self, t: float) -> None:
        tracks, s = self.tracks, self.settings
        if t > self.t and len(tracks.ids):
            dt = min(t - self.t, s.forget)
            kalman_bank.predict(tracks.mean, tracks.covariance, dt, s.acceleration)
            unseen = tracks.missed > 0.0
            if unseen.any():
                tracks.mean[unseen, 2:] *= math.exp(-dt / s.slow_down)
        self.t = max(self.t, t)

    def _match(
        self, camera: int, t: float, lag: float, positions: Array, noise: Array, confidence: Array, interval: float
    ) -> NDArray[np.int64]:
        """Give detections to tracks, count misses, bury the dead; return which detections are left."""
        tracks, s = self.tracks, self.settings
        count, found = len(tracks.ids), len(positions)
        free = np.arange(found)
        if not count:
            return free
        hit = np.zeros(count, np.bool_)
        if found:
            distance, mahalanobis, log_det = kalman_bank.innovations(
                tracks.mean, tracks.covariance, positions, noise, lag
            )
            inside = (mahalanobis < s.gate**2) & (distance < s.gate_distance**2)
            cost = mahalanobis + log_det + np.where(tracks.confirmed, 0.0, s.tentative_penalty)[:, None]
            rows, columns = linear_sum_assignment(np.where(inside, cost, FORBIDDEN))
            allowed = inside[rows, columns]
            rows, columns = rows[allowed], columns[allowed]
            if len(rows):
                self._feed(rows, camera, t, lag, positions[columns], noise[columns], confidence[columns])
                hit[rows] = True
                taken = np.zeros(found, np.bool_)
                taken[columns] = True
                # What lies beside an established track, or beside one another camera just saw, is its double.
                established = tracks.confirmed | ((tracks.camera != camera) & (t - tracks.seen < s.confirm_age))
                double = (established[:, None] & (distance < s.birth_exclusion**2)).any(axis=0)
                free = np.flatnonzero(~taken & ~double)
        self._count_misses(camera, t, hit, interval)
        return free

    def _feed(
        self, rows: NDArray[np.int64], camera: int, t: float, lag: float, positions: Array, noise: Array, weight: Array
    ) -> None:
        tracks, s = self.tracks, self.settings
        tracks.mean[rows], tracks.covariance[rows] = kalman_bank.update(
            tracks.mean[rows], tracks.covariance[rows], positions, noise, lag
        )
        tracks.seen[rows] = np.maximum(tracks.seen[rows], t)
        tracks.missed[rows] = 0.0
        tracks.hits[rows] += 1
        tracks.score[rows] += weight
        tracks.camera[rows] = camera
        tracks.fed[rows] |= 1 << camera
        if not tracks.confirmed.all():
            tracks.confirmed |= (
                (tracks.score >= s.confirm_confidence)
                & (tracks.hits >= s.confirm_hits)
                & (tracks.seen - tracks.born >= s.confirm_age)
            )

    def _count_misses(self, camera: int, t: float, hit: NDArray[np.bool_], interval: float) -> None:
        """A track is missed by a camera that sees its place, did not see it, and has nobody else who just did."""
        tracks, s = self.tracks, self.settings
        share = 1.0 - math.exp(-interval / 3.0)
        tracks.quality[hit] += share * (1.0 - tracks.quality[hit])
        if hit.all():
            return
        places = tracks.mean[:, :2]
        in_view = self.view.views[self.cameras[camera]].depth_at(places) > 0.0
        missed = ~hit & in_view & (t - tracks.seen >= 0.9 * interval)
        tracks.missed[missed] += interval
        tracks.quality[missed] *= 1.0 - share
        ahead = places + s.look_ahead * tracks.mean[:, 2:]
        leaving = self.view.everywhere.depth_at(ahead) < s.leaving_depth
        gone = self.view.everywhere.depth_at(places) <= 0.0
        absent = np.where(gone, np.maximum(tracks.missed, t - tracks.seen), tracks.missed)
        patience = np.where(tracks.confirmed, np.where(leaving, s.coast_leaving, s.coast), s.tentative_patience)
        dead = ~hit & ((absent >= patience) | (t - tracks.seen >= s.forget))
        if dead.any():
            tracks.keep(~dead)

    def _give_birth(self, camera: int, t: float, positions: Array, noise: Array, confidence: Array) -> None:
        s = self.settings
        sure = confidence >= s.birth_confidence
        count = int(sure.sum())
        if not count:
            return
        mean, covariance = kalman_bank.start(positions[sure], noise[sure], s.start_speed)
        self.tracks.append(
            TrackTable(
                ids=np.arange(self._next_id, self._next_id + count),
                mean=mean,
                covariance=covariance,
                born=np.full(count, t),
                seen=np.full(count, t),
                missed=np.zeros(count),
                hits=np.ones(count, np.int64),
                score=confidence[sure].copy(),
                confirmed=np.zeros(count, np.bool_),
                quality=np.full(count, 0.5),
                camera=np.full(count, camera),
                fed=np.full(count, 1 << camera),
            )
        )
        self._next_id += count
