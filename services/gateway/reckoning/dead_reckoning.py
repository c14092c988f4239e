"""Where did the phones' steps lead? Inertial samples of many phones in, steps with length and heading out.

The order of work on a hop: calibration of gyroscope and compass, attitude, steps, then for each step its heading and
its length, and the turns. Every algorithm is one file with a ``STATE``; the states of one phone are one record, in
``Walk``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.bounce import bounce
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.carrying import Carrying, CarryingDetection
from services.gateway.reckoning.complementary import ComplementaryFilter, trusted_field
from services.gateway.reckoning.hand_heading import HandHeading
from services.gateway.reckoning.hops import RATE, Array, Hops, State
from services.gateway.reckoning.plan_heading import plan_heading
from services.gateway.reckoning.pocket_heading import PocketHeading
from services.gateway.reckoning.recent import RECENT, Recent, remember
from services.gateway.reckoning.resampling import InertialSamples, SingleHop, stack
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE, StepHeading, StepHeadings
from services.gateway.reckoning.turns import TurnDetection, Turns
from services.gateway.reckoning.walk import Activity, Motion, Walk
from services.gateway.reckoning.walking_detection import WalkingDetection
from services.gateway.steps.detector import StepDetector, Steps
from services.gateway.steps.gated_peaks import GatedPeaks
from shared.walking.stride import StepLengths, StrideLine, step_lengths

__all__ = ["Carrying", "DeadReckoner", "InertialSamples", "Motion", "Walk"]

LONG_STOP = 10.0
"""Seconds without a step after which a new walk begins: by then the phone may be held another way."""
INTERVALS = (0.2, 1.4)
"""Seconds between which a step follows the one before it."""
STEP_T_VARIANCE = 0.07**2
"""s², of when a foot struck: on the step counter recordings 0.076 s, of which 0.03 s are the truth's polling."""
STILL_SIGMA = 0.25
"""m/s²: a phone whose acceleration varies less is lying or held still."""
TURN_AFTER_STEP = 4.0
"""Seconds after a step in which a turn is still a corner: a sharp one breaks the rhythm of steps."""
COMPASS_SECONDS = 1.0
"""Of a trusted field before a compass heading is believed."""

_WALKED = np.dtype([("last_step", np.float64), ("compass", np.float64), ("walk", np.int64)])


class DeadReckoner:
    """Pedestrian dead reckoning of many phones, streaming. It holds no state of any phone: that is in each ``Walk``.

    Args:
        north: direction of magnetic north on the plan, radians counter-clockwise from +x.
        attitude: which attitude filter.
        detectors: which step detector for which way of carrying.
        hand: heading of steps whose phone is held.
        pocket: heading of steps whose phone is in a pocket.
        calibration: what takes the gyroscope's bias and the phone's own iron out.
    """

    def __init__(
        self,
        north: float,
        attitude: Attitude | None = None,
        detectors: Mapping[Carrying, StepDetector] | None = None,
        hand: StepHeading | None = None,
        pocket: StepHeading | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        self._north = north
        self._attitude = attitude or ComplementaryFilter()
        self._calibration = calibration or Calibration()
        self._walking = WalkingDetection()
        self._carrying = CarryingDetection()
        self._turns = TurnDetection()
        gated = GatedPeaks()
        everywhere: dict[Carrying, StepDetector] = {"hand": gated, "pocket": gated, "bag": gated, "unknown": gated}
        self._detectors = {**everywhere, **(detectors or {})}
        self._hand = hand or HandHeading()
        self._pocket = pocket or PocketHeading()
        self._records = {carrying: self._record(carrying) for carrying in self._detectors}

    def _record(self, carrying: Carrying) -> np.dtype[np.void]:
        states = {
            "calibration": self._calibration.STATE,
            "walked": _WALKED,
            "attitude": self._attitude.STATE,
            "recent": RECENT,
            "detector": self._detectors[carrying].STATE,
            "walking": self._walking.STATE,
            "carrying": self._carrying.STATE,
            "turns": self._turns.STATE,
            "hand": self._hand.STATE,
            "pocket": self._pocket.STATE,
        }
        ends = np.cumsum([-(-state.itemsize // 8) * 8 for state in states.values()])  # NumPy likes fields aligned
        return np.dtype(
            {
                "names": list(states),
                "formats": list(states.values()),
                "offsets": [0, *ends[:-1].tolist()],
                "itemsize": int(ends[-1]),
            }
        )

    def advance(self, walks: Sequence[Walk], samples: Sequence[InertialSamples]) -> list[list[Motion]]:
        """Take samples of p phones, at any rate and with any jitter; ``walks`` are changed in place.

        Returns:
            for each phone the reports that are complete, one for each second or part of it between two holes.
        """
        return self._work(walks, [walk.resampler.push(part) for walk, part in zip(walks, samples, strict=True)])

    def finish(self, walks: Sequence[Walk]) -> list[list[Motion]]:
        """Return what is left at the end of p recordings; what comes next begins anew."""
        return self._work(walks, [walk.resampler.finish() for walk in walks])

    def _work(self, walks: Sequence[Walk], hops: Sequence[Sequence[SingleHop]]) -> list[list[Motion]]:
        told: list[list[Motion]] = [[] for _ in walks]
        done = 0
        while True:
            groups: dict[Carrying, list[int]] = {}
            for row, waiting in enumerate(hops):
                if len(waiting) > done:
                    groups.setdefault(walks[row].carrying, []).append(row)
            if not groups:
                return told
            for carrying, rows in groups.items():
                motions = self._hop(carrying, [walks[row] for row in rows], stack([hops[row][done] for row in rows]))
                for row, motion in zip(rows, motions, strict=True):
                    told[row].append(motion)
            done += 1

    def _hop(self, carrying: Carrying, walks: Sequence[Walk], hops: Hops) -> list[Motion]:
        """Take one hop of each of p phones that are carried the same way."""
        dtype = self._records[carrying]
        for walk in walks:
            if walk.record is None or len(walk.record) != dtype.itemsize:
                walk.record = np.zeros(dtype.itemsize, np.uint8)
        bytes_ = np.stack([walk.record for walk in walks if walk.record is not None])
        record = bytes_.view(dtype)[:, 0]
        for name in dtype.names or ():
            if name != "calibration":
                record[name][hops.fresh] = np.zeros((), dtype[name])
        motions = self._reckon(carrying, walks, record, hops)
        for row, walk in zip(bytes_, walks, strict=True):
            walk.record = row.copy()
        return motions

    def _reckon(self, carrying: Carrying, walks: Sequence[Walk], record: State, hops: Hops) -> list[Motion]:
        rate, hops = self._calibration.advance(record["calibration"], hops)
        attitude = self._attitude.advance(record["attitude"], hops, rate)
        recent = remember(record["recent"], hops, rate, attitude)
        steps = self._detectors[carrying].advance(record["detector"], hops)
        since = self._walking.advance(record["walking"], hops)
        walked = record["walked"]
        since_step = np.where(walked["last_step"] > 0.0, hops.t - walked["last_step"], np.inf)
        lately = steps.walking | (since_step < TURN_AFTER_STEP)
        turns = self._turns.advance(record["turns"], hops, attitude, lately)
        walked["compass"] += trusted_field(hops.field).sum(axis=1) / RATE
        in_pocket = np.full(len(walks), carrying in ("pocket", "bag"))
        if carrying == "unknown":
            in_pocket = self._carrying.advance(record["carrying"], rate, attitude, steps.walking)
        stepped = _Stepped.none()
        if len(steps.phone) or steps.walking.any():
            cadence = _cadence(walked["last_step"], steps)
            bounces = np.where(in_pocket[steps.phone], np.nan, bounce(recent, steps))
            lengths = step_lengths(cadence, bounces, _lines(walks, steps.phone))
            doubt = self._calibration.heading_variance(record["calibration"])
            headings = _more_doubtful(self._headings(record, recent, steps, in_pocket), doubt[steps.phone])
            blind = (walked["compass"] < COMPASS_SECONDS) | (carrying == "bag")  # how a bag swings nobody has measured
            stepped = _Stepped(steps, lengths, _admitted(headings, blind[steps.phone]))
            _count_walks(walks, walked, steps)
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        # By the second, of the step counter recordings: 97 % of walking and 5 % of handling are told as walking; by the
        # spectrum alone it would be 93 and 13 %.
        since_step = np.where(walked["last_step"] > 0.0, hops.t - walked["last_step"], np.inf)
        moves = steps.walking | (np.isfinite(since) & (since_step < 1.0))
        return self._motions(walks, hops, moves, norm.std(axis=1) < STILL_SIGMA, stepped, turns)

    def _headings(self, record: State, recent: Recent, steps: Steps, in_pocket: NDArray[np.bool_]) -> StepHeadings:
        if not in_pocket.any():
            return self._hand.advance(record["hand"], recent, steps)
        if in_pocket.all():
            return self._pocket.advance(record["pocket"], recent, steps)
        held = self._hand.advance(record["hand"], recent, _of(steps, ~in_pocket))
        swung = self._pocket.advance(record["pocket"], recent, _of(steps, in_pocket))
        pocket = in_pocket[steps.phone]
        order = np.argsort(np.concatenate([np.flatnonzero(~pocket), np.flatnonzero(pocket)]))
        names = StepHeadings.__dataclass_fields__
        return StepHeadings(*(np.concatenate([getattr(held, n), getattr(swung, n)])[order] for n in names))

    def _motions(
        self,
        walks: Sequence[Walk],
        hops: Hops,
        moves: NDArray[np.bool_],
        still: NDArray[np.bool_],
        stepped: _Stepped,
        turns: Turns,
    ) -> list[Motion]:
        begins = hops.t - 0.5 / RATE
        ends = begins + hops.count / RATE
        rows = np.arange(len(walks) + 1)
        cut, turn_cut = np.searchsorted(stepped.steps.phone, rows), np.searchsorted(turns.phone, rows)
        heading, other = (plan_heading(h, self._north) for h in (stepped.headings.heading, stepped.headings.other))
        motions = []
        for row, walk in enumerate(walks):
            begin, end = float(begins[row]), float(ends[row])
            of, turn = slice(cut[row], cut[row + 1]), slice(turn_cut[row], turn_cut[row + 1])
            if of.stop == of.start:
                activity: Activity = "walking" if moves[row] else "still" if still[row] else "other"
                motions.append(
                    Motion(begin, end, activity, walk=walk.walks, turn_t=turns.t[turn], turn=turns.angle[turn])
                )
                continue
            step_t = stepped.steps.t[of]
            motions.append(
                Motion(
                    t_start=min(begin, float(step_t[0])),
                    t=max(end, float(step_t[-1])),
                    activity="walking",
                    step_t=step_t,
                    step_t_variance=np.full(len(step_t), STEP_T_VARIANCE),
                    length=stepped.lengths.length[of],
                    length_variance=stepped.lengths.variance[of],
                    heading=heading[of],
                    heading_variance=stepped.headings.variance[of],
                    other_heading=other[of],
                    other_probability=stepped.headings.other_probability[of],
                    walk=walk.walks,
                    heading_bias_variance=float(stepped.headings.bias_variance[of][-1]),
                    length_scale_variance=float(stepped.lengths.scale_variance[of][-1]),
                    turn_t=turns.t[turn],
                    turn=turns.angle[turn],
                )
            )
        return motions


@dataclass(frozen=True, slots=True)
class _Stepped:
    steps: Steps
    lengths: StepLengths
    headings: StepHeadings

    @classmethod
    def none(cls) -> _Stepped:
        empty = np.empty(0)
        steps = Steps(np.empty(0, np.int64), empty, np.empty(0, np.bool_), empty)
        return cls(steps, StepLengths(empty, empty, empty), StepHeadings(empty, empty, empty, empty, empty))


def _of(steps: Steps, phones: NDArray[np.bool_]) -> Steps:
    """Return the steps of the phones marked in (p,)."""
    which = phones[steps.phone]
    return Steps(steps.phone[which], steps.t[which], steps.walking & phones, steps.period)


def _cadence(last_step: Array, steps: Steps) -> Array:
    """Return steps per second (m,) from the time since the step before; at the beginning, from what comes next."""
    first = np.diff(steps.phone, prepend=-1) != 0
    interval = np.diff(steps.t, prepend=np.nan)
    before = last_step[steps.phone[first]]
    interval[first] = np.where(before > 0.0, steps.t[first] - before, np.nan)
    interval = np.where((interval > INTERVALS[0]) & (interval < INTERVALS[1]), interval, np.nan)
    after = np.append(np.where(first[1:], np.nan, interval[1:]), np.nan)
    interval = np.where(np.isfinite(interval), interval, after)
    period = steps.period[steps.phone]
    return 1.0 / np.where(np.isfinite(interval), interval, np.where(period > 0.0, period, np.nan))


def _lines(walks: Sequence[Walk], phone: NDArray[np.int64]) -> StrideLine | None:
    """Return the stride models of the steps' people."""
    if all(walk.line is None for walk in walks):
        return None
    nobody = (0.0, 0.0, 0.0)
    lines = [(w.line.slope, w.line.offset, w.line.scale_variance) if w.line else nobody for w in walks]
    return StrideLine(*np.array(lines, float)[phone].T)


def _more_doubtful(headings: StepHeadings, variance: Array) -> StepHeadings:
    """Return headings of m steps with ``variance`` (m,) rad² more of error that the walk has in common."""
    return replace(
        headings,
        variance=np.minimum(headings.variance + variance, UNKNOWN_VARIANCE),
        bias_variance=np.minimum(headings.bias_variance + variance, UNKNOWN_VARIANCE),
    )


def _admitted(headings: StepHeadings, blind: NDArray[np.bool_]) -> StepHeadings:
    """Return headings of which those of blind phones are unknown, by an error that the whole walk has in common."""
    if not blind.any():
        return headings
    return StepHeadings(
        headings.heading,
        np.where(blind, UNKNOWN_VARIANCE, headings.variance),
        np.where(blind, UNKNOWN_VARIANCE, headings.bias_variance),
        headings.other,
        np.where(blind, 0.0, headings.other_probability),
    )


def _count_walks(walks: Sequence[Walk], walked: State, steps: Steps) -> None:
    """Begin a new walk where steps come after a restart or a long stop, and remember the newest step."""
    first = np.flatnonzero(np.diff(steps.phone, prepend=-1))
    phones = steps.phone[first]
    last = walked["last_step"][phones]
    anew = (last <= 0.0) | (steps.t[first] - last > LONG_STOP)
    for phone in phones[anew]:
        walks[phone].walks += 1
    walked["last_step"][steps.phone] = steps.t
