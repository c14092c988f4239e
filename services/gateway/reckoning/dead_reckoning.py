"""Where did the phones' steps lead? Inertial samples of many phones in, steps with length and heading out.

The order of work on a hop: calibration of gyroscope and compass, attitude, steps, then for each step its heading and
its length, and the turns. Every algorithm is one file with a ``STATE``; the states of one phone are one record, in
``Walk``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.bounce import bounce
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.carrying import Carrying, CarryingDetection
from services.gateway.reckoning.complementary import ComplementaryFilter, trusted_field
from services.gateway.reckoning.hand_heading import HandHeading
from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State
from services.gateway.reckoning.plan_heading import plan_heading
from services.gateway.reckoning.pocket_heading import PocketHeading
from services.gateway.reckoning.recent import RECENT, Recent, remember
from services.gateway.reckoning.resampling import InertialSamples, SingleHop, stack
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE, StepHeading, StepHeadings
from services.gateway.reckoning.turns import TurnDetection, Turns
from services.gateway.reckoning.walk import Activity, Motion, Walk
from services.gateway.reckoning.walking_detection import WalkingDetection
from services.gateway.steps.detector import Steps
from services.gateway.steps.detectors import DETECTORS, SHIPPED
from shared.walking.stride import StepLengths, StrideLine, step_lengths

__all__ = ["Carrying", "DeadReckoner", "InertialSamples", "Motion", "Walk"]

LONG_STOP = 10.0
"""Seconds without a step after which a new walk begins: by then the phone may be held another way."""
INTERVALS = (0.2, 1.4)
"""Seconds between which a step follows the one before it."""
STEP_T_VARIANCE = 0.13**2
"""s², of when a foot struck: on the step counter recordings steps are told 0.10 s early (their switches' polling taken
off) and scatter by 0.08 s. With the 0.10 s taken off, headings of the mall's legs would be worse by half a degree."""
STILL_SIGMA = 0.25
"""m/s²: a phone whose acceleration varies less is lying or held still."""
TURN_AFTER_STEP = 4.0
"""Seconds after a step in which a turn is still a corner: a sharp one breaks the rhythm of steps."""
COMPASS_SECONDS = 1.0
"""Of a trusted field before a compass heading is believed."""

SHORT_HOLE = 2.0
"""Seconds without samples after which the phone may be turned any way."""
HOLE_TURN = 0.3
"""rad/s, by which nobody knows where a phone turned in a hole."""
FORGETS_HOLES = np.exp(-2.0 / 15.0)
"""Of that variance in a second of a trusted compass: the attitude filter follows it with 15 s."""
NO_GYROSCOPE_VARIANCE = np.radians(15.0) ** 2
"""rad², of headings that the compass alone tells: it sways with the steps."""
PLACES: dict[Carrying, int] = {"hand": 1, "unknown": 1, "pocket": 2, "bag": 3}

_WALKED = np.dtype(
    [
        ("end", np.float64),
        ("last_step", np.float64),
        ("begun", np.float64),
        ("compass", np.float64),
        ("holes", np.float64),
        ("place", np.int64),
    ]
)
"""End of the samples, newest step, first step of the walk, s; trusted field, s; variance of turns in holes, rad²; where
the phone was (of ``PLACES``) at the newest step, 0 before."""
_THROUGH_HOLES = ("calibration", "walked", "carrying", "hand", "pocket")
_THROUGH_SHORT_HOLES = ("attitude", "turns")


class DeadReckoner:
    """Pedestrian dead reckoning of many phones, streaming. It holds no state of any phone: that is in each ``Walk``.

    Args:
        north: direction of magnetic north on the plan, radians counter-clockwise from +x.
        attitude: which attitude filter.
        detector: name of the step detector; None: the one that counts best, by how a phone is carried.
        hand: heading of steps whose phone is held.
        pocket: heading of steps whose phone is in a pocket.
        calibration: what takes the gyroscope's bias and the phone's own iron out.
    """

    def __init__(
        self,
        north: float,
        attitude: Attitude | None = None,
        detector: str | None = None,
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
        self._names = {carrying: detector or name for carrying, name in SHIPPED.items()}
        self._detectors = {name: DETECTORS[name]() for name in self._names.values()}
        self._hand = hand or HandHeading()
        self._pocket = pocket or PocketHeading()
        self._records = {name: self._record(name) for name in self._detectors}

    def _record(self, detector: str) -> np.dtype[np.void]:
        states = {
            "calibration": self._calibration.STATE,
            "walked": _WALKED,
            "attitude": self._attitude.STATE,
            "recent": RECENT,
            "detector": self._detectors[detector].STATE,
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
        detector = self._names[carrying]
        for walk in walks:
            self._open(walk, detector)
        bytes_ = np.stack([walk.record for walk in walks if walk.record is not None])
        record = bytes_.view(self._records[detector])[:, 0]
        if hops.fresh.any():
            _restart(record, hops)
        record["walked"]["end"] = hops.t + (hops.count - 0.5) / RATE
        if "delta" in (record["detector"].dtype.names or ()):
            thresholds = np.array([walk.thresholds or (0.0, 0.0) for walk in walks])
            record["detector"]["delta"], record["detector"]["rho"] = thresholds.T
        motions = self._reckon(carrying, walks, record, hops)
        for row, walk in zip(bytes_, walks, strict=True):
            walk.record = row.copy()
        return motions

    def _open(self, walk: Walk, detector: str) -> None:
        """Give a phone a record for this step detector; what it remembers beside its steps stays."""
        if walk.record is not None and walk.detector == detector:
            return
        new = np.zeros(1, self._records[detector])
        if walk.record is not None and walk.detector in self._records:
            old = walk.record.view(self._records[walk.detector])
            for name in set(new.dtype.names or ()) - {"detector"}:
                new[name] = old[name]
        elif walk.calibration is not None:
            new["calibration"] = walk.calibration.view(self._calibration.STATE)
        walk.record, walk.detector = new.view(np.uint8), detector

    def _reckon(self, carrying: Carrying, walks: Sequence[Walk], record: State, hops: Hops) -> list[Motion]:
        rate, hops = self._calibration.advance(record["calibration"], hops)
        attitude = self._attitude.advance(record["attitude"], hops, rate)
        recent = remember(record["recent"], hops, rate, attitude)
        steps = self._detectors[self._names[carrying]].advance(record["detector"], hops)
        since = self._walking.advance(record["walking"], hops)
        walked = record["walked"]
        since_step = np.where(walked["last_step"] > 0.0, hops.t - walked["last_step"], np.inf)
        lately = steps.walking | (since_step < TURN_AFTER_STEP)
        turns = self._turns.advance(record["turns"], hops, attitude, lately)
        seen = trusted_field(hops.field).sum(axis=1) / RATE
        walked["compass"] += seen
        walked["holes"] *= FORGETS_HOLES**seen
        in_pocket = np.full(len(walks), carrying in ("pocket", "bag"))
        if carrying == "unknown":
            in_pocket = self._carrying.advance(record["carrying"], rate, attitude, steps.walking)
        stepped = _Stepped.none()
        if len(steps.phone) or steps.walking.any():
            cadence = _cadence(walked["last_step"], steps)
            bounces = np.where(in_pocket[steps.phone], np.nan, bounce(recent, steps))
            lengths = step_lengths(cadence, bounces, _lines(walks, steps.phone))
            place = np.where(in_pocket & (carrying != "bag"), PLACES["pocket"], PLACES[carrying])
            _count_walks(walks, record, steps, place)
            doubt = self._calibration.heading_variance(record["calibration"]) + walked["holes"]
            doubt += np.where(record["calibration"]["gyroscope"] > 0, 0.0, NO_GYROSCOPE_VARIANCE)
            headings = _more_doubtful(self._headings(record, recent, steps, in_pocket), doubt[steps.phone])
            blind = (walked["compass"] < COMPASS_SECONDS) | (carrying == "bag")  # how a bag swings nobody has measured
            drifted = self._calibration.drift_variance(record["calibration"])[steps.phone]
            drifted = drifted * (steps.t - walked["begun"][steps.phone]) ** 2
            strength = recent.field[steps.phone, recent.index(steps.phone, steps.t)].astype(np.float64)
            stepped = _Stepped(steps, lengths, _admitted(headings, blind[steps.phone], drifted), strength)
        # By the second, of the step counter recordings: 97 % of walking and 5 % of handling are told as walking; by the
        # spectrum alone it would be 93 and 13 %.
        since_step = np.where(walked["last_step"] > 0.0, hops.t - walked["last_step"], np.inf)
        moves = steps.walking | (np.isfinite(since) & (since_step < 1.0))
        return self._motions(walks, hops, moves, _still(hops), stepped, turns)

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
                    magnetic=stepped.magnetic[of],
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
    magnetic: Array

    @classmethod
    def none(cls) -> _Stepped:
        empty = np.empty(0)
        steps = Steps(np.empty(0, np.int64), empty, np.empty(0, np.bool_), empty)
        return cls(steps, StepLengths(empty, empty, empty), StepHeadings(empty, empty, empty, empty, empty), empty)


def _still(hops: Hops) -> NDArray[np.bool_]:
    """Return which phones were still, (p,); of less than half a second nobody can say."""
    norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
    measured = hops.measured() / hops.count[:, None]
    off = norm - np.sum(measured * norm, axis=1, keepdims=True)
    still: NDArray[np.bool_] = np.sum(measured * off**2, axis=1) < STILL_SIGMA**2
    return still & (2 * hops.count >= HOP)


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


def _admitted(headings: StepHeadings, blind: NDArray[np.bool_], drifted: Array) -> StepHeadings:
    """Return headings of which those of blind phones are unknown, by an error that the whole walk has in common.

    What single steps err by, and what the gyroscope has ``drifted`` (m,) rad² since the walk began, is not in common.
    """
    if not blind.any():
        return headings
    own = np.minimum(headings.variance - headings.bias_variance + drifted, UNKNOWN_VARIANCE)
    return StepHeadings(
        headings.heading,
        np.where(blind, UNKNOWN_VARIANCE, headings.variance),
        np.where(blind, UNKNOWN_VARIANCE - own, headings.bias_variance),
        headings.other,
        np.where(blind, 0.0, headings.other_probability),
    )


def _restart(record: State, hops: Hops) -> None:
    """Let phones whose samples begin anew forget what a hole of its length makes worthless."""
    walked = record["walked"]
    hole = np.where(walked["end"] > 0.0, hops.t - walked["end"], np.inf)
    goes_on = (hole >= 0.0) & (hole < LONG_STOP)
    turned = hops.fresh & ~(goes_on & (hole < SHORT_HOLE))
    for name in record.dtype.names or ():
        forgets = hops.fresh
        if name in _THROUGH_SHORT_HOLES:
            forgets = turned
        elif name in _THROUGH_HOLES:
            forgets = hops.fresh & ~goes_on
        if name != "calibration":
            record[name][forgets] = np.zeros((), record.dtype[name])
    walked["compass"][turned] = 0.0
    walked["holes"][hops.fresh & ~turned] += (HOLE_TURN * hole[hops.fresh & ~turned]) ** 2


def _count_walks(walks: Sequence[Walk], record: State, steps: Steps, place: NDArray[np.int64]) -> None:
    """Begin a new walk where steps come after a long stop or with the phone elsewhere; remember the newest step.

    A phone that was put elsewhere lies there another way: its body vector is forgotten.
    """
    walked = record["walked"]
    first = np.flatnonzero(np.diff(steps.phone, prepend=-1))
    phones = steps.phone[first]
    last = walked["last_step"][phones]
    moved = (walked["place"][phones] > 0) & (walked["place"][phones] != place[phones])
    anew = (last <= 0.0) | (steps.t[first] - last > LONG_STOP) | moved
    record["pocket"][phones[moved]] = np.zeros((), record["pocket"].dtype)
    walked["begun"][phones[anew]] = steps.t[first][anew]
    walked["place"][phones] = place[phones]
    for phone in phones[anew]:
        walks[phone].walks += 1
    walked["last_step"][steps.phone] = steps.t
