"""Who is who? Evidence for every pair of device and track, gathered along the tracks' own paths.

For each device the hypotheses are "carried along track k" for every track, against "on none of them". Each scan and
each second of a phone's walk moves the log-odds of every pair by what it says for that path beyond what it says for a
stranger's. The odds live in a small Markov model: when two tracks meet they may have exchanged persons, a new track may
continue one that was lost near by, and evidence fades as the path goes on; standing still neither adds nor loses any.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import astuple
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.evidence.association import assign, association_marginals
from services.fusion.evidence.hypotheses import Hypotheses
from services.fusion.evidence.identity_settings import IdentitySettings
from services.fusion.evidence.motion_evidence import Walk, walks_of
from services.fusion.snapshot import counts, unpack
from shared.messages import MotionBatch, RadioScan, decode

__all__ = ["IdentityLayer"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class IdentityLayer(Hypotheses):
    """The hypotheses, moved by what phones tell, and the decisions made of them."""

    def __init__(self, view: AreaView, settings: IdentitySettings | None = None) -> None:
        self._column_of_point = {name: index for index, name in enumerate(view.radio.names)}
        super().__init__(view, settings)
        self._elsewhere, self._elsewhere_variance = self._anywhere()
        self.ignored: Counter[str] = Counter()

    def _start(self) -> None:
        super()._start()
        self._waiting: list[RadioScan] = []
        self._walks: list[tuple[str, Walk]] = []
        self._decided = self._calibrated = -math.inf
        self._dirty = False

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
        self._dirty |= self.follow(t, ids, places)
        heard = self._listen(t, scans) if scans or self._waiting else set()
        for batch in motions:
            self._note_walk(batch)
        if self._walks:
            heard |= self._walk(t)
        # Nothing may happen for long where a person stands still: silence is news as well.
        self._dirty |= bool((np.isfinite(self.device_seen) & (t - self.device_seen > self.settings.forget)).any())
        if self._dirty and not 0.0 <= t - self._decided < self.settings.cycle:
            self._decide(t)
        return heard

    def erase(self, device: str) -> None:
        """Forget a device whose consent was withdrawn, and what of it still waits."""
        self._waiting = [scan for scan in self._waiting if scan.device != device]
        self._walks = [entry for entry in self._walks if entry[0] != device]
        if device in self.devices:
            self._forget(self.devices.index(device))
            self._dirty = True

    def _forget(self, row: int) -> None:
        self.devices[row] = None
        self.device_seen[row] = self.device_told[row] = -math.inf
        self.given[row] = -1

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
            self.ignored["radio without a known access point"] += 1
            return False
        row = self.row(scan.device)
        elapsed = float(scan.t - self.device_seen[row])
        if elapsed <= 0.0:
            # Told again (after a lost connection, say): what it said must not count twice.
            self.ignored["radio told again or out of order"] += 1
            return False
        self.device_seen[row] = scan.t
        self.device_told[row] = max(self.device_told[row], scan.t)
        self.device_scans[row] += 1
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
            self.ignored["motion without a time"] += 1
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
            self.device_told[row] = max(self.device_told[row], walk.t)
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

    # -- decisions ---------------------------------------------------------------------------------------------------

    def _decide(self, t: float) -> None:
        s = self.settings
        elapsed = min(max(t - self._decided, 0.0), 1.0) if math.isfinite(self._decided) else 0.0
        self._decided, self._dirty = t, False
        for row in np.flatnonzero(t - self.device_seen > s.forget).tolist():
            self._forget(row)
        alive = np.flatnonzero(self.alive)
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
        # A phone that has said next to nothing, or nothing of late, keeps what it has but gets nothing new: whoever
        # carried it may have left, and somebody must not be taken for them because nobody else is there.
        heard = (self.device_scans[rows] >= s.claim_scans) & (t - self.device_told[rows] <= s.claim_fresh)
        chosen = assign(marginals, holds, np.where(heard, s.claim, 2.0), s.keep)
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
        source, target = np.nonzero(flow > 1e-4)
        if not len(source):
            return
        flowing = flow[source, target]
        pairs = np.ix_(rows, alive)
        odds = self.odds[pairs]
        best = odds.max(axis=1, keepdims=True)
        weight = np.exp(odds - best)
        leaving = np.zeros(len(alive))
        np.add.at(leaving, source, flowing)
        mixed = weight * (1.0 - np.minimum(leaving, 0.5))
        np.add.at(mixed.T, target, (weight[:, source] * flowing).T)
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

    # -- before and after --------------------------------------------------------------------------------------------

    def _anywhere(self) -> tuple[Array, Array]:
        """Mean (m,) and variance (m,) of what is heard at a random place of the floor, shadowing included."""
        radio, view, s = self.view.radio, self.view, self.settings
        if not radio.names:
            return np.zeros(0), np.zeros(0)
        x, y = (np.linspace(low, high, 20) for low, high in zip(view.lower, view.upper, strict=True))
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        level = radio.rssi(places)
        return level.mean(axis=0), level.var(axis=0) + s.noise.shadowing**2

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        return {
            **super().state(),
            "waiting": list(self._waiting),
            "walks": [[device, np.array(astuple(walk))] for device, walk in self._walks],
            "calibrated": self._calibrated if math.isfinite(self._calibrated) else None,
            "decided": self._decided if math.isfinite(self._decided) else None,
            "dirty": self._dirty,
            "ignored": dict(self.ignored),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``; see ``Hypotheses.restore`` for the errors."""
        waiting = [decode(msgspec.json.encode(scan), RadioScan) for scan in state["waiting"]]
        walks = [(str(device), Walk(*unpack(numbers).tolist())) for device, numbers in state["walks"]]
        calibrated, decided = (
            -math.inf if state[name] is None else float(state[name]) for name in ("calibrated", "decided")
        )
        dirty, ignored = bool(state["dirty"]), counts(state["ignored"])
        super().restore(state)
        self._waiting, self._walks, self._dirty, self.ignored = waiting, walks, dirty, ignored
        self._calibrated, self._decided = calibrated, decided
