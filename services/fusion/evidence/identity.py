"""Who is who? Every device's belief about where it is, moved by what cameras and phones tell, and the decisions made.

Evidence moves each device's own filter (``belief``); which device is on which track is then decided for all of them
together, one device per track and one track per device (``association``), and what was said of the last seconds is
compared with what the best explanation now says of them (``revision``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from services.fusion.evidence.association import assign, association_marginals
from services.fusion.evidence.devices import Devices
from services.fusion.evidence.estimates import estimates
from services.fusion.evidence.hearing import Gathered, Hearing
from services.fusion.evidence.radio_evidence import novelty, scan_likelihood
from services.fusion.evidence.workload import due_now
from services.fusion.walks.stretches import Walk, stretches
from shared.messages import MotionBatch, RadioScan

__all__ = ["IdentityLayer"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_ABOUT = 0.3
"""A device less likely to be about teaches nothing."""
SURE = 0.8
"""A device likelier than that to be on one track teaches how noisy readings are."""
SLOT = 0.2
"""Seconds of a slot of the lineage."""


class IdentityLayer(Devices):
    """All devices of one area, moved by what cameras and phones tell, and the decisions made of them."""

    def step(
        self,
        t: float,
        ids: Integers,
        places: Array,
        coasting: NDArray[np.bool_],
        scans: tuple[RadioScan, ...] = (),
        motions: tuple[MotionBatch, ...] = (),
    ) -> set[str]:
        """Take in where the tracks are and what phones heard and did; return the devices whose news counted.

        Args:
            t: time of the positions; one before the last means that the clock was set back, and all begins anew.
            ids: (n,), ids of the tracks.
            places: (n, 2), metres.
            coasting: (n,), whether no camera sees them now.
            scans: in any order; those newer than ``t`` wait, and so do those of a burst (``due_now``).
            motions: likewise; batches of phones whose radio was never heard say nothing.
        """
        if t < self.columns.history.newest:
            self._start()
        self._follow(t, ids, places, coasting)
        heard = self._walk(t, motions)
        heard |= self._listen(t, scans)
        self._dirty |= bool(((t - self.told > self.settings.forget) & np.isfinite(self.told)).any())
        if self._dirty and not 0.0 <= t - self._decided < self.settings.cycle:
            self._decide(t)
        return heard

    def erase(self, device: str) -> None:
        """Forget a device whose consent was withdrawn, and what of it still waits."""
        self._scans = [scan for scan in self._scans if scan.device != device]
        self._motions = [batch for batch in self._motions if batch.device != device]
        if device in self.devices:
            row = self.devices.index(device)
            if self.given[row] >= 0:
                # Whom its track was before was known by the device alone.
                self.former.pop(int(self.columns.tracks[self.given[row]]), None)
            self._forget(row)
            self._dirty = True

    # -- what phones hear --------------------------------------------------------------------------------------------

    def _listen(self, t: float, scans: tuple[RadioScan, ...]) -> set[str]:
        self._scans.extend(scan for scan in scans if math.isfinite(scan.t))
        due, self._scans = due_now(self._scans, t, self.settings.at_once, self.settings.waiting)
        return {scan.device for scan in due if self._scan(scan)}

    def _scan(self, scan: RadioScan) -> bool:
        """Take in one scan; False if it held nothing to go by."""
        readings = {
            self._column_of_point[name]: level
            for name, level in zip(scan.access_point, scan.rssi, strict=True)
            if name in self._column_of_point and -120.0 <= level <= 0.0
        }
        if not readings:
            self.ignored["radio without a known access point"] += 1
            return False
        row = self.row(scan.device)
        hearing = self.hearing[row][scan.heard_by_site]
        if scan.t <= hearing.newest:
            # Told again (after a lost connection, say): what it said must not count twice.
            self.ignored["radio told again or out of order"] += 1
            return False
        gathered = hearing.take(scan.t, readings, self.settings.gather)
        self.told[row] = max(self.told[row], scan.t)
        if gathered is not None:
            self.scans[row] += 1
            self._weigh(row, hearing, gathered)
        self._dirty = True
        return True

    def _weigh(self, row: int, hearing: Hearing, scan: Gathered) -> None:
        """Move a device's belief by what it heard."""
        s, heard, trust = self.settings, scan.heard, 1.0
        if scan.t - self.walked_until[row] > 3.0 and math.isfinite(scan.elapsed):
            # It tells nothing of its walk: somewhere between standing and walking, and located by what it hears alone.
            trust = s.unwalked_teaches
            self.beliefs.walk(row, np.zeros(2), s.unknown_speed**2 * min(scan.elapsed, 10.0))
            scan = Gathered(scan.t, heard, scan.level, scan.count, scan.elapsed, 0.5 * scan.elapsed)
        weight = novelty(scan.elapsed, scan.walked, s.memory + s.habit * hearing.stood, s.reach)
        hearing.stood = 0.0 if scan.walked > 0.3 else hearing.stood + min(scan.elapsed, 60.0)
        common = hearing.variance + s.common**2
        columns = self.columns.alive
        places = self.columns.place[columns]
        if len(columns):
            then = self.columns.history.at(scan.t)[columns]
            places = np.where(np.isfinite(then), then, places)
        own = s.white**2 / scan.count + self.calibration.variance()[heard]
        distance = self.calibration.guess.log_distance(places)
        residual, variance = self._residual(scan, places, distance, own)
        noise = self.calibration.noise
        tracks = weight * scan_likelihood(residual, noise * variance, hearing.offset, common)
        mean = self._heard_on_grid()
        shadow = s.shadowing**2 if self._map is None else s.shadowing_known**2 + self._map[1][:, heard]
        spread = np.atleast_2d(noise * (own + shadow))
        off = scan.level - mean[:, heard]
        cells = weight * scan_likelihood(off, spread, hearing.offset, common)
        volume = np.log(spread).sum(axis=1).mean() + math.log1p(common * float((1.0 / spread[0]).sum()))
        far = -0.5 * weight * (len(heard) - 1 + s.strange + volume)
        floor = self.beliefs.floor[row].ravel()
        some = np.flatnonzero(floor > 0.02 * floor.max())
        self._learn(
            hearing,
            trust * weight,
            scan,
            np.concatenate([distance[:, heard], self._distance[np.ix_(some, heard)]]),
            np.concatenate([residual, off[some]]),
            np.concatenate([self.beliefs.share[row, columns], floor[some]]),
        )
        share = self.beliefs.share[row, columns]
        if len(columns) and share.max() > SURE:
            best = int(share.argmax())
            self.calibration.learn_noise(
                residual[best], np.broadcast_to(variance, residual.shape)[best], trust * weight
            )
        self.beliefs.weigh(row, columns, tracks, cells, far)

    def _residual(self, scan: Gathered, places: Array, distance: Array, own: Array) -> tuple[Array, Array]:
        """Return heard minus expected at (n, 2) places and its variance, (n, h)."""
        s = self.settings
        residual = scan.level - self.calibration.rssi_at(distance)[:, scan.heard]
        if self.view.shadowing is None:
            return residual, np.broadcast_to(own + s.shadowing**2, residual.shape)
        mean, variance = self.view.shadowing.at(places)
        return residual - mean[:, scan.heard], own + s.shadowing_known**2 + variance[:, scan.heard]

    def _learn(
        self,
        hearing: Hearing,
        weight: float,
        scan: Gathered,
        distance: Array,
        residual: Array,
        chance: Array,
    ) -> None:
        """Learn from where the device may be what it reads too much, and what the access points really send.

        What a reading says counts the less, the more the expectation differs among the places.
        """
        s, heard = self.settings, scan.heard
        total = float(chance.sum())
        if total < LEAST_ABOUT:
            return
        chance = chance / total
        mean = chance @ residual
        doubt = chance @ (residual - mean) ** 2 + s.shadowing**2
        known = self.calibration.variance()[heard]
        # The offset, as if it were the mean of all readings …
        information = weight / (doubt + known)
        variance = 1.0 / (1.0 / hearing.variance + float(information.sum()))
        offset = variance * (hearing.offset / hearing.variance + float((mean * information).sum()))
        # … and the access points, by what is left.
        self.calibration.learn(heard, chance @ distance, mean - hearing.offset, weight / (doubt + hearing.variance))
        hearing.offset, hearing.variance = offset, variance

    def _calibrate(self, t: float) -> None:
        """Put to use what was learned of the access points."""
        self._calibrated = t
        self.calibration.solve()
        self._expected = self.calibration.rssi_at(self._distance)

    # -- how phones move ---------------------------------------------------------------------------------------------

    def _walk(self, t: float, motions: tuple[MotionBatch, ...]) -> set[str]:
        for batch in motions:
            if math.isfinite(batch.t_start) and math.isfinite(batch.t):
                self._motions.append(batch)
            else:
                self.ignored["motion without a time"] += 1
        if not self._motions:
            return set()
        due, self._motions = due_now(self._motions, t, self.settings.at_once, self.settings.waiting)
        counted = set()
        for batch in due:
            if batch.device not in self.devices:
                continue
            row = self.devices.index(batch.device)
            if batch.t <= self.walked_until[row]:
                self.ignored["motion told again or out of order"] += 1
                continue
            self.told[row] = max(self.told[row], batch.t)
            self._move(row, batch)
            self._dirty = True
            counted.add(batch.device)
        return counted

    def _move(self, row: int, batch: MotionBatch) -> None:
        """Take in what a phone tells of its walk."""
        s = self.settings
        walks = stretches(batch, float(self.stepped[row]))
        for walk in walks:
            self._take_walk(row, walk)
        if walks and walks[-1].length > 0.0:
            self.stepped[row] = walks[-1].t
        if not walks:
            # Neither standing nor walking for sure: it may go slowly, or have begun a walk that is told later.
            duration = min(max(batch.t - batch.t_start, 0.0), 10.0)
            self.beliefs.walk(row, np.zeros(2), (s.vague_speed * duration) ** 2)
            for hearing in self.hearing[row]:
                hearing.walked += s.vague_novelty * duration
        self.walking[row] = float(batch.activity == "walking")
        self.walked_until[row] = batch.t

    def _take_walk(self, row: int, walk: Walk) -> None:
        s, filters = self.settings, self.walk_filters
        filters.begin(row, walk)
        moved = self.columns.history.at(walk.t) - self.columns.history.at(walk.t_start)
        alive = self.columns.alive
        known = alive[np.isfinite(moved[alive, 0])]
        evidence = filters.walk(row, known, walk, moved[known])
        bias, bias_variance, scale = 0.0, walk.bias_variance, 1.0
        held = int(self.beliefs.share[row].argmax()) if len(alive) else -1
        if held >= 0 and self.beliefs.share[row, held] > 0.3:
            bias, bias_variance = float(filters.bias[row, held]), float(filters.bias_variance[row, held])
            scale = float(filters.scale[row, held])
        self.beliefs.favour(row, known, s.trust_motion * evidence)
        duration = walk.t - walk.t_start
        displacement, variance = np.zeros(2), s.still_speed**2 * duration
        if walk.length > 0.0 and math.isfinite(walk.heading):
            heading, length = walk.heading - bias, walk.length / max(scale, 0.5)
            displacement = length * np.array([math.cos(heading), math.sin(heading)])
            variance = length**2 * (s.step_error**2 + 0.5 * (bias_variance + walk.heading_variance))
        elif walk.length > 0.0:
            variance = walk.length**2
        self.beliefs.walk(row, displacement, variance)
        for hearing in self.hearing[row]:
            hearing.walked += walk.length

    # -- decisions ---------------------------------------------------------------------------------------------------

    def _decide(self, t: float) -> None:
        s, beliefs = self.settings, self.beliefs
        elapsed = min(max(t - self._decided, 0.0), 1.0) if math.isfinite(self._decided) else 0.0
        self._decided, self._dirty = t, False
        for row in np.flatnonzero((t - self.told > s.forget) & np.isfinite(self.told)).tolist():
            self._forget(row)
        alive, rows = self.columns.alive, self.rows
        self.probability = np.zeros((len(self.devices), len(self.columns.tracks)))
        self.estimates = {}
        if not len(rows):
            return
        if not 0.0 <= t - self._calibrated < s.calibrate_every:
            self._calibrate(t)
        walks = t - self.walked_until[rows] <= s.claim_walked
        beliefs.pass_time(
            rows, alive, self.columns.place[alive], self.columns.coasting[alive], self.walking[rows], walks, elapsed
        )
        beliefs.remember(math.floor(t / SLOT), self.columns.tracks)
        self._assign(t, rows, alive)
        self.estimates = self._estimates(rows[self.given[rows] < 0])

    def _assign(self, t: float, rows: Integers, alive: Integers) -> None:
        """Decide for all devices together which track each is on."""
        s, beliefs = self.settings, self.beliefs
        if not len(alive):
            self.given[:] = -1
            return
        pairs = np.ix_(rows, alive)
        unseen = beliefs.floor[rows].sum(axis=(1, 2)) + beliefs.far[rows]
        odds = np.log(np.maximum(beliefs.share[pairs], 1e-30)) - np.log(np.maximum(unseen, 1e-30))[:, None]
        marginals = association_marginals(np.minimum(odds, 20.0))
        self.probability[pairs] = marginals
        holds = self.given[rows][:, None] == alive[None, :]
        # A phone that has said next to nothing, or nothing of late, keeps what it has but gets nothing new: whoever
        # carried it may have left, and somebody must not be taken for them because nobody else is there.
        heard = (self.scans[rows] >= s.claim_scans) & (t - self.told[rows] <= s.claim_fresh)
        walks = t - self.walked_until[rows] <= s.claim_walked
        claim = np.where(walks, s.claim, s.claim_unwalked)
        chosen = assign(marginals, holds, np.where(heard, claim, 2.0), s.keep)
        for row, column in zip(rows.tolist(), np.where(chosen >= 0, alive[chosen], -1).tolist(), strict=True):
            self._give(row, column)

    def _give(self, row: int, column: int) -> None:
        self.given[row] = column
        if column < 0:
            return
        track = int(self.columns.tracks[column])
        chain = self.chains[row]
        if not chain or chain[-1] != track:
            chain = [earlier for earlier in chain if earlier != track][-self.settings.longest_chain :]
            self.chains[row] = [*chain, track]
            self.former[track] = chain

    def _estimates(self, rows: Integers) -> dict[int, tuple[Array, Array, float]]:
        """Return by device where it is likely to be, (2,), its covariance (2, 2) and how likely it is about at all."""
        alive, beliefs = self.columns.alive, self.beliefs
        mean, covariance, about = estimates(
            self.probability[np.ix_(rows, alive)],
            self.columns.place[alive],
            beliefs.floor[rows].reshape(len(rows), len(self.grid.centres)),
            self.grid.centres,
            beliefs.rest[rows],
            beliefs.far[rows],
        )
        return dict(zip(rows.tolist(), zip(mean, covariance, about.tolist(), strict=True), strict=True))
