"""Who is who? Radio evidence for every pair of device and track, gathered along the tracks' own paths.

For each device the hypotheses are "carried along track k" for every track, against "carried somewhere else". Each scan
moves the log-odds of every pair by what it says for that path beyond what it says for a stranger's. The odds live in a
small Markov model: when two tracks meet they may have swapped persons, a new track may continue one that was lost
nearby, and evidence fades as the path goes on; standing still neither adds evidence nor loses it.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.association import assign, association_marginals
from services.fusion.calibration import Calibration
from services.fusion.motion_evidence import Walk, WalkFilters, walks_of
from services.fusion.path_history import PathHistory
from services.fusion.radio_evidence import PathFilters
from services.fusion.snapshot import pack, unpack
from shared.messages import MotionBatch, RadioScan, decode, encode
from shared.radio import RadioNoise

__all__ = ["IdentityLayer", "IdentitySettings"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 8
"""Rows and columns are added in blocks."""


NOISE = RadioNoise(white=2.5, shadowing=4.0, shadowing_range=3.0, access_point=4.0, device=3.0)


@dataclass(frozen=True)
class IdentitySettings:
    """What is believed of radios and people before any is seen."""

    noise: RadioNoise = NOISE
    """``access_point`` covers an exponent that is off as well as a power that is off."""
    elsewhere_speed: float = 0.7
    """Speed of a person out of view, m/s: how fast a stranger's readings lose their memory."""
    elsewhere_range: float = 5.0
    """Metres over which what a stranger hears stays alike."""
    far_prior: float = -3.0
    """Log-odds that a phone on no track is not carried about here but rests somewhere or is far away: all it hears may
    be off by ``far_level`` dB, each access point by ``far_constant`` dB, and it moves but slowly."""
    far_level: float = 15.0
    far_constant: float = 6.0
    far_speed: float = 0.1
    trust: float = 1.0
    """Share of the radio evidence that is believed …"""
    trust_motion: float = 1.0
    """… and of what phones tell of their walks."""
    prior: float = 2.0
    """Log-odds that a device is on a given new track, each track by itself. Above zero, because a stranger's readings
    are explained a little too well: they are fitted by a Gaussian that knows no path."""
    cap: float = 12.0
    """Largest log-odds either way: no past is so sure that it could not be overruled."""
    fade_distance: float = 40.0
    """Metres of path after which evidence counts 1/e."""
    swap_rate: float = 0.1
    """Probability per second that two tracks at the same place exchange persons, and its range in metres."""
    swap_range: float = 0.6
    lost: float = 8.0
    """Seconds for which a track that ended may be continued by a new one."""
    continued: float = 0.5
    """Probability that a track born right where another was lost continues it."""
    claim: float = 0.4
    """Probability from which a device gets a track, and down to which it keeps it."""
    keep: float = 0.2
    certain: float = 0.9
    """Probability from which a pair teaches the access points' constants, put to use every so many seconds."""
    calibrate_every: float = 2.0
    residual_constant: float = 1.0
    """dB; what a learned constant may still be off for one phone."""
    cycle: float = 0.25
    """Seconds between decisions while scans come in."""
    forget: float = 60.0
    """Seconds without a scan after which a device is forgotten."""
    longest_chain: int = 16
    """Former tracks remembered of one person."""
    waiting: int = 5_000
    """Scans held until the cameras have reached their time."""


class IdentityLayer:
    """Devices (rows) against tracks (columns) of one area."""

    def __init__(self, view: AreaView, settings: IdentitySettings | None = None) -> None:
        self.view = view
        self.settings = s = settings or IdentitySettings()
        self._column_of_point = {name: index for index, name in enumerate(view.radio.names)}
        self._constant_variance = np.full(len(view.radio.names), s.noise.access_point**2)
        self._elsewhere, self._elsewhere_variance = self._anywhere()
        self.devices: list[str | None] = []
        self.device_seen = np.zeros(0)
        self.tracks = np.zeros(0, np.int64)
        """Id of the track in each column, 0 where the column is free."""
        self.lost_at = np.zeros(0)
        """When the column's track ended; infinity while it lives."""
        self.place = np.zeros((0, 2))
        """Last known place of each column's track."""
        self.odds = np.zeros((0, 0))
        self.probability = np.zeros((0, 0))
        self.last_place = np.zeros((0, 0, 2))
        """Where each pair was at the device's scan before; NaN for none."""
        self.filters = PathFilters.new(0, 0, self._constant_variance, s.noise)
        self.strangers = PathFilters.new(0, 2, self._constant_variance, s.noise)
        """Of each device: carried somewhere on this floor, or far away."""
        self.far = np.zeros(0)
        """Log-odds that a device that is on no track is far away."""
        self.given = np.zeros(0, np.int64)
        self.chains: list[list[int]] = []
        self.former: dict[int, list[int]] = {}
        self.history = PathHistory()
        self.walk_filters = WalkFilters.new(0, 0)
        self.calibration = Calibration.of(view.radio)
        self._calibrated = -math.inf
        self._waiting: list[RadioScan] = []
        self._walks: list[tuple[str, Walk]] = []
        self._decided = -math.inf
        self._dirty = False
        self.ignored = 0

    def step(
        self,
        t: float,
        ids: Integers,
        places: Array,
        scans: tuple[RadioScan, ...] = (),
        motions: tuple[MotionBatch, ...] = (),
    ) -> set[str]:
        """Take in where the tracks are and what phones heard and did; return the devices whose news counted.

        Args:
            t: time of the positions.
            ids: (n,), ids of the confirmed tracks.
            places: (n, 2), metres.
            scans: in the order they were consumed; those newer than ``t`` wait.
            motions: likewise; batches of phones whose radio was never heard say nothing.
        """
        self._follow(t, ids, places)
        heard = self._listen(t, scans) if scans or self._waiting else set()
        for batch in motions:
            self._note_walk(batch)
        if self._walks:
            heard |= self._walk(t)
        if self._dirty and not 0.0 <= t - self._decided < self.settings.cycle:
            self._decide(t)
        return heard

    # -- tracks come and go ------------------------------------------------------------------------------------------

    def _follow(self, t: float, ids: Integers, places: Array) -> None:
        known = self.tracks[np.isinf(self.lost_at)] if len(self.tracks) else self.tracks
        if len(known) != len(ids) or not np.isin(ids, known).all():
            self._end(t, np.isin(self.tracks, ids))
            for index in np.flatnonzero(~np.isin(ids, self.tracks)):
                self._begin(t, int(ids[index]), places[index])
        columns = self.columns(ids)
        self.place[columns] = places
        self.history.append(t, columns, places, len(self.tracks))
        expired = (self.tracks > 0) & (t - self.lost_at > self.settings.lost)
        if expired.any():
            self.tracks[expired] = 0

    def columns(self, ids: Integers) -> Integers:
        """Return the column (n,) of each track id, all of which must be alive."""
        order = np.argsort(self.tracks, kind="stable")
        found: Integers = order[np.searchsorted(self.tracks, ids, sorter=order)]
        return found

    def _end(self, t: float, alive: NDArray[np.bool_]) -> None:
        ended = (self.tracks > 0) & ~alive & np.isinf(self.lost_at)
        self.lost_at[ended] = t
        self.lost_at[alive] = math.inf
        for track in self.tracks[ended].tolist():
            self.former.pop(track, None)
        self.given[np.isin(self.given, np.flatnonzero(ended))] = -1
        self._dirty = True

    def _begin(self, t: float, track: int, place: Array) -> None:
        free = np.flatnonzero(self.tracks == 0)
        if not len(free):
            self._grow(0, BLOCK)
            free = np.flatnonzero(self.tracks == 0)
        column = int(free[0])
        s = self.settings
        self.filters.reset(slice(None), slice(column, column + 1), self._constant_variance, s.noise)
        self.walk_filters.reset_track(column)
        self.last_place[:, column] = np.nan
        self.history.forget(column)
        self.odds[:, column] = s.prior
        self.probability[:, column] = 0.0
        # A hypothesis about a new track descends from one about a track lost near by, or one that passed close.
        gap = np.minimum(np.maximum(t - self.lost_at, 0.0), s.lost)
        apart = np.hypot(*(self.place - place).T)
        reach = s.swap_range**2 + (0.8 * gap) ** 2
        chance = np.where(np.isinf(self.lost_at), s.swap_rate, s.continued) * np.exp(-0.5 * apart**2 / reach)
        chance[(self.tracks == 0) | (chance < 1e-3)] = 0.0
        if chance.any():
            parents = np.flatnonzero(chance)
            passed = self.odds[:, parents] + np.log(chance[parents])
            for row in range(len(self.devices)):
                best = int(np.argmax(passed[row]))
                if passed[row, best] > s.prior:
                    self.filters.inherit(row, np.array([column]), parents[[best]])
                    self.walk_filters.inherit(row, column, int(parents[best]))
                    self.last_place[row, column] = self.last_place[row, parents[best]]
                    self.odds[row, column] = np.logaddexp(s.prior, passed[row, best])
        self.tracks[column] = track
        self.lost_at[column] = math.inf
        self.place[column] = place
        self._dirty = True

    # -- what phones hear --------------------------------------------------------------------------------------------

    def _listen(self, t: float, scans: tuple[RadioScan, ...]) -> set[str]:
        self._waiting.extend(scan for scan in scans if math.isfinite(scan.t))
        due = [scan for scan in self._waiting if scan.t <= t]
        self._waiting = [scan for scan in self._waiting if scan.t > t][-self.settings.waiting :]
        due.sort(key=lambda scan: (scan.t, scan.device, scan.seq))
        return {scan.device for scan in due if self._scan(scan)}

    def _scan(self, scan: RadioScan) -> bool:
        """Move the odds of one device by one scan; False if it held nothing to go by."""
        readings = {
            self._column_of_point[name]: level
            for name, level in zip(scan.access_point, scan.rssi, strict=True)
            if name in self._column_of_point and -120.0 <= level <= 0.0
        }
        if not readings:
            self.ignored += 1
            return False
        row = self._row(scan.device)
        elapsed = abs(scan.t - self.device_seen[row])
        if elapsed == 0.0:
            self.ignored += 1
            return False
        self.device_seen[row] = max(self.device_seen[row], scan.t)
        heard = np.array(sorted(readings))
        level = np.array([readings[column] for column in heard.tolist()])
        against = self._stranger(row, heard, level, elapsed)
        places = self.history.at(scan.t)
        known = np.flatnonzero(np.isfinite(places[:, 0]) & (self.tracks[: len(places)] > 0))
        if len(known):
            self._move_odds(row, known, places[known], heard, level, against)
        self._dirty = True
        return True

    def _stranger(self, row: int, heard: Integers, level: Array, elapsed: float) -> float:
        """Log-likelihood of a scan if the device is on no track: carried about on this floor, at rest or far away."""
        s = self.settings
        kept = np.exp(-elapsed * np.array([s.elsewhere_speed, s.far_speed]) / s.elsewhere_range)
        near, far = self.strangers.scan(
            row,
            np.arange(2),
            heard,
            np.broadcast_to(level - self._elsewhere[heard], (2, len(heard))),
            kept,
            np.broadcast_to(self._elsewhere_variance[heard], (2, len(heard))),
            s.noise.white**2,
        ).tolist()
        before = float(self.far[row])
        self.far[row] = min(max(before + far - near, -s.cap), s.cap)
        return float(np.logaddexp(near, before + far) - np.logaddexp(0.0, before))

    def _forget_stranger(self, row: int) -> None:
        s = self.settings
        self.strangers.reset(slice(row, row + 1), slice(None), self._constant_variance, s.noise)
        self.strangers.cc[row, 1] += s.far_constant**2
        self.strangers.offset_variance[row, 1] += s.far_level**2
        self.far[row] = s.far_prior

    def _move_odds(
        self, row: int, known: Integers, places: Array, heard: Integers, level: Array, against: float
    ) -> None:
        s = self.settings
        walked = np.hypot(*(places - self.last_place[row, known]).T)
        first = ~np.isfinite(walked)
        walked = np.where(first, 0.0, walked)
        kept = np.where(first, 0.0, np.exp(-walked / s.noise.shadowing_range))
        residual = level - self.calibration.rssi(places)[:, heard]
        variance = np.full(residual.shape, s.noise.shadowing**2)
        unheard = np.setdiff1d(np.arange(len(self._constant_variance)), heard)
        likelihood = self.filters.scan(row, known, heard, residual, kept, variance, s.noise.white**2)
        self.filters.fade(row, known, unheard, kept, np.full((len(known), len(unheard)), s.noise.shadowing**2))
        self.last_place[row, known] = places
        self._learn(row, known, places, heard, level, kept)
        odds = self.odds[row, known]
        odds = (odds - s.prior) * np.exp(-walked / s.fade_distance) + s.prior + s.trust * (likelihood - against)
        self.odds[row, known] = np.minimum(np.maximum(odds, -s.cap), s.cap)

    # -- how phones move ---------------------------------------------------------------------------------------------

    def _note_walk(self, batch: MotionBatch) -> None:
        if not (math.isfinite(batch.t_start) and math.isfinite(batch.t)):
            self.ignored += 1
            return
        walks = walks_of(batch.t_start, batch.t, batch.step_t, batch.length, batch.heading, batch.heading_variance)
        self._walks.extend((batch.device, walk) for walk in walks)

    def _walk(self, t: float) -> set[str]:
        due = [entry for entry in self._walks if entry[1].t <= t]
        self._walks = [entry for entry in self._walks if entry[1].t > t][-self.settings.waiting :]
        due.sort(key=lambda entry: (entry[1].t, entry[0]))
        counted = set()
        for device, walk in due:
            if device not in self.devices:
                continue
            row = self.devices.index(device)
            if walk.t_start < self.walk_filters.last[row, 0] - 1e-3:
                # A second that was told before, or a revision of the past: what it said cannot be unsaid.
                continue
            start, end = self.history.at(walk.t_start), self.history.at(walk.t)
            moved = end - start
            known = np.flatnonzero(np.isfinite(moved[:, 0]) & (self.tracks[: len(moved)] > 0))
            evidence = self.walk_filters.walk(row, known, walk, moved[known])
            odds = self.odds[row, known] + self.settings.trust_motion * evidence
            self.odds[row, known] = np.minimum(np.maximum(odds, -self.settings.cap), self.settings.cap)
            self._dirty = True
            counted.add(device)
        return counted

    def _learn(self, row: int, known: Integers, places: Array, heard: Integers, level: Array, kept: Array) -> None:
        """A phone whose track is beyond doubt tells what the access points really send."""
        s = self.settings
        held = int(self.given[row])
        mine = np.flatnonzero(known == held)
        if not len(mine) or self.probability[row, held] < s.certain:
            return
        index = int(mine[0])
        weight = (1.0 - float(kept[index]) ** 2) / (s.noise.shadowing**2 + s.noise.white**2)
        self.calibration.learn(places[index], heard, level - self.filters.offset[row, held], weight)

    def _calibrate(self, t: float) -> None:
        """Put to use what was learned of the access points, in all pairs' filters as well."""
        s = self.settings
        self._calibrated = t
        places = np.where(np.isfinite(self.last_place), self.last_place, 0.0)
        flat = places.reshape(-1, 2)
        before = self.calibration.rssi(flat)
        self.calibration.solve()
        self.filters.constant -= (self.calibration.rssi(flat) - before).reshape(self.filters.constant.shape)
        self._constant_variance = (
            np.minimum(self.calibration.variance(), s.noise.access_point**2) + s.residual_constant**2
        )

    def _row(self, device: str) -> int:
        if device in self.devices:
            return self.devices.index(device)
        if None not in self.devices:
            self._grow(BLOCK, 0)
        row = self.devices.index(None)
        s = self.settings
        self.devices[row] = device
        self.device_seen[row] = -math.inf
        self.odds[row] = s.prior
        self.last_place[row] = np.nan
        self.filters.reset(slice(row, row + 1), slice(None), self._constant_variance, s.noise)
        self._forget_stranger(row)
        self.walk_filters.reset_device(row)
        self.given[row] = -1
        self.chains[row] = []
        return row

    # -- decisions ---------------------------------------------------------------------------------------------------

    def _decide(self, t: float) -> None:
        s = self.settings
        elapsed = min(max(t - self._decided, 0.0), 1.0) if math.isfinite(self._decided) else 0.0
        self._decided, self._dirty = t, False
        for row in np.flatnonzero(t - self.device_seen > s.forget).tolist():
            self.devices[row] = None
            self.given[row] = -1
        alive = np.flatnonzero((self.tracks > 0) & np.isinf(self.lost_at))
        rows = np.array([row for row, device in enumerate(self.devices) if device is not None], np.int64)
        self.probability = np.zeros(self.odds.shape)
        if not len(rows) or not len(alive):
            self.given[:] = -1
            return
        if not 0.0 <= t - self._calibrated < s.calibrate_every:
            self._calibrate(t)
        self._mix(rows, alive, elapsed)
        pairs = np.ix_(rows, alive)
        marginals = association_marginals(self.odds[pairs])
        self.probability[pairs] = marginals
        holds = self.given[rows][:, None] == alive[None, :]
        chosen = assign(marginals, holds, s.claim, s.keep)
        given = np.where(chosen >= 0, alive[chosen], -1)
        for row, column in zip(rows.tolist(), given.tolist(), strict=True):
            self._give(row, column)

    def _mix(self, rows: Integers, alive: Integers, elapsed: float) -> None:
        """Tracks that meet may have exchanged persons: let the odds of each flow into the other."""
        s = self.settings
        if len(alive) < 2 or elapsed == 0.0:
            return
        places = self.place[alive]
        dx = places[:, 0, None] - places[None, :, 0]
        dy = places[:, 1, None] - places[None, :, 1]
        flow = elapsed * s.swap_rate * np.exp(-(dx * dx + dy * dy) / s.swap_range**2)
        np.fill_diagonal(flow, 0.0)
        if flow.max() < 1e-4:
            return
        pairs = np.ix_(rows, alive)
        odds = self.odds[pairs]
        best = odds.max(axis=1, keepdims=True)
        weight = np.exp(odds - best)
        mixed = weight * (1.0 - np.minimum(flow.sum(axis=0), 0.5)) + (weight[:, :, None] * flow[None]).sum(axis=1)
        self.odds[pairs] = np.maximum(np.log(np.maximum(mixed, 1e-300)) + best, -s.cap)

    def _give(self, row: int, column: int) -> None:
        self.given[row] = column
        if column < 0:
            return
        track = int(self.tracks[column])
        chain = self.chains[row]
        if not chain or chain[-1] != track:
            chain = [earlier for earlier in chain if earlier != track][-self.settings.longest_chain :]
            self.chains[row] = [*chain, track]
            self.former[track] = chain

    # -- room and memory ---------------------------------------------------------------------------------------------

    def _anywhere(self) -> tuple[Array, Array]:
        """Mean (m,) and variance (m,) of what is heard at a random place of the floor, shadowing included."""
        radio, view, s = self.view.radio, self.view, self.settings
        if not radio.names:
            return np.zeros(0), np.zeros(0)
        x, y = (np.linspace(low, high, 20) for low, high in zip(view.lower, view.upper, strict=True))
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        level = radio.rssi(places)
        return level.mean(axis=0), level.var(axis=0) + s.noise.shadowing**2

    def _grow(self, more_devices: int, more_tracks: int) -> None:
        s = self.settings
        devices, tracks = len(self.devices), len(self.tracks)
        d, k = devices + more_devices, tracks + more_tracks
        self.devices += [None] * more_devices
        self.chains += [[] for _ in range(more_devices)]
        self.device_seen = np.concatenate([self.device_seen, np.full(more_devices, -math.inf)])
        self.given = np.concatenate([self.given, np.full(more_devices, -1)])
        self.far = np.concatenate([self.far, np.zeros(more_devices)])
        self.tracks = np.concatenate([self.tracks, np.zeros(more_tracks, np.int64)])
        self.lost_at = np.concatenate([self.lost_at, np.full(more_tracks, -math.inf)])
        self.place = np.concatenate([self.place, np.zeros((more_tracks, 2))])
        for name, fill in (("odds", s.prior), ("probability", 0.0), ("last_place", np.nan)):
            old = getattr(self, name)
            new = np.full((d, k, *old.shape[2:]), fill)
            new[:devices, :tracks] = old
            setattr(self, name, new)
        self.filters.resize(d, k, self._constant_variance, s.noise)
        self.strangers.resize(d, 2, self._constant_variance, s.noise)
        self.walk_filters.resize(d, k)

    def state(self) -> dict[str, Any]:
        """Return all that is known, as JSON values."""
        return {
            "devices": self.devices,
            "chains": self.chains,
            "former": {str(track): chain for track, chain in self.former.items()},
            "arrays": {name: pack(getattr(self, name)) for name in _ARRAYS},
            "filters": {name: pack(getattr(self.filters, name)) for name in _FILTERS},
            "strangers": {name: pack(getattr(self.strangers, name)) for name in _FILTERS},
            "walk_filters": {name: pack(getattr(self.walk_filters, name)) for name in _WALK_FILTERS},
            "calibration": self.calibration.state(),
            "calibrated": self._calibrated if math.isfinite(self._calibrated) else None,
            "history": self.history.state(),
            "walks": [[device, pack(np.array(astuple(walk)))] for device, walk in self._walks],
            "waiting": [msgspec.Raw(encode(scan)) for scan in self._waiting],
            "decided": self._decided if math.isfinite(self._decided) else None,
            "dirty": self._dirty,
            "ignored": self.ignored,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or one of an area with other access points.
        """
        arrays = {name: unpack(state["arrays"][name]) for name in _ARRAYS}
        filters = PathFilters(**{name: unpack(state["filters"][name]) for name in _FILTERS})
        strangers = PathFilters(**{name: unpack(state["strangers"][name]) for name in _FILTERS})
        if filters.constant.shape[2:] != self._constant_variance.shape:
            raise msgspec.ValidationError("the access points are not those of this site")
        history = PathHistory()
        history.restore(state["history"])
        waiting = [decode(msgspec.json.encode(scan), RadioScan) for scan in state["waiting"]]
        devices = [None if device is None else str(device) for device in state["devices"]]
        chains = [[int(track) for track in chain] for chain in state["chains"]]
        former = {int(track): [int(one) for one in chain] for track, chain in state["former"].items()}
        calibration, calibrated = Calibration.of(self.view.radio), state["calibrated"]
        calibration.restore(state["calibration"])
        walk_filters = WalkFilters(**{name: unpack(state["walk_filters"][name]) for name in _WALK_FILTERS})
        walks = [(str(device), Walk(*unpack(numbers).tolist())) for device, numbers in state["walks"]]
        decided, dirty, ignored = state["decided"], bool(state["dirty"]), int(state["ignored"])
        for name, array in arrays.items():
            setattr(self, name, array)
        self.filters, self.strangers, self.history, self._waiting = filters, strangers, history, waiting
        self.calibration, self._calibrated = calibration, -math.inf if calibrated is None else float(calibrated)
        self.walk_filters, self._walks = walk_filters, walks
        self.devices, self.chains, self.former = devices, chains, former
        self._decided, self._dirty, self.ignored = -math.inf if decided is None else float(decided), dirty, ignored


_ARRAYS = (
    "_constant_variance",
    "device_seen",
    "tracks",
    "lost_at",
    "place",
    "odds",
    "probability",
    "last_place",
    "given",
    "far",
)
_FILTERS = tuple(PathFilters.__dataclass_fields__)
_WALK_FILTERS = tuple(WalkFilters.__dataclass_fields__)
