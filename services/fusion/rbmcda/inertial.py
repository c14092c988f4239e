"""Where did a phone's steps lead in a cycle? Whole and partial steps, and a guess while the newest are on their way.

Prediction is driven by time, steps by people: a step counts for the share of it that lies in the cycle
[ravel-thesis §6.2, eq. 4.2]. Phones tell of steps a second late. Until they do, the walk of the second before is
believed to go on; a device that no camera corrects meanwhile makes up the difference once the steps are known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from services.fusion.rbmcda.settings import RbmcdaSettings
from shared.messages import MotionBatch

__all__ = ["Displacement", "WalkLog"]

KEPT = 8.0
"""Seconds of steps remembered."""
LONGEST_STEP = 1.5
"""Seconds; a step after a longer pause began ``USUAL_STEP`` before its end."""
USUAL_STEP = 0.55
PACE = 1.2
"""Seconds over which the pace that is believed to go on is taken."""
STALE = 3.0
"""Seconds without a report after which nothing is known of a phone's motion."""
LARGEST_STEP = 2.0
"""Metres; and m² of a length, and radians² of a heading, that says nothing."""
LARGEST_SPREAD = 1.0
LARGEST_VARIANCE = 3.0
LATEST = 1.0
"""Seconds after a report's end beyond which a step in it has no time."""


@dataclass(frozen=True, slots=True)
class Displacement:
    """What is known of one device's motion in one cycle.

    Attributes:
        shift: metres, x and y.
        owed: metres by which what was guessed in the cycle before was wrong.
        variance: xx, xy, yy in m², of ``shift`` where it is known.
        haste: m² along each axis, of the part that was guessed.
        path: metres walked.
    """

    shift: tuple[float, float]
    owed: tuple[float, float]
    variance: tuple[float, float, float]
    haste: float
    path: float


@dataclass
class WalkLog:
    """A device's steps of the last seconds.

    Attributes:
        steps: begin, end, dx, dy, and variances xx, xy, yy, oldest first.
        known_until: the end of the newest report.
        activity: what it said.
        still_since: since when the phone rests; NaN while it does not.
        guess: from when, dx, dy: what was guessed in the last cycle.
    """

    steps: list[tuple[float, ...]] = field(default_factory=list)
    known_until: float = -math.inf
    activity: str = "other"
    still_since: float = math.nan
    guess: tuple[float, float, float] = (math.inf, 0.0, 0.0)

    def take(self, motion: MotionBatch) -> bool:
        """Note a report; False if it makes no sense."""
        if not (math.isfinite(motion.t) and math.isfinite(motion.t_start) and motion.t_start <= motion.t):
            return False
        if motion.revises_from is not None:
            self.steps = [step for step in self.steps if step[1] <= motion.revises_from]
        before = self.steps[-1][1] if self.steps else -math.inf
        for index, end in enumerate(motion.step_t):
            length, heading = motion.length[index], motion.heading[index]
            spread, turn = motion.length_variance[index], motion.heading_variance[index]
            if not (before < end <= motion.t + LATEST and 0.0 <= length <= LARGEST_STEP and math.isfinite(heading)):
                continue
            spread = min(spread, LARGEST_SPREAD) if math.isfinite(spread) and spread >= 0.0 else 0.1
            turn = min(turn, LARGEST_VARIANCE) if math.isfinite(turn) and turn >= 0.0 else LARGEST_VARIANCE
            begin = before if end - before <= LONGEST_STEP else end - USUAL_STEP
            other = motion.other_probability[index] if motion.other_probability else 0.0
            self.steps.append((begin, end, *_step(length, heading, spread, turn)))
            if other > 0.0 and math.isfinite(motion.other_heading[index]):
                self.steps[-1] = (begin, end, *_either(length, heading, motion.other_heading[index], other, turn))
            before = end
        if motion.t >= self.known_until:
            if motion.activity != "still" or motion.step_t:
                self.still_since = math.nan
            elif not math.isfinite(self.still_since):
                self.still_since = motion.t_start
            self.known_until, self.activity = motion.t, motion.activity
        self.steps = [step for step in self.steps if step[1] > self.known_until - KEPT]
        return True

    def advance(self, begin: float, end: float, settings: RbmcdaSettings) -> Displacement:
        """Return the motion in the cycle (``begin``, ``end``] and remember what of it is a guess."""
        duration = end - begin
        fresh = end - self.known_until <= STALE
        known = min(max(self.known_until, begin), end)
        x, y, xx, xy, yy, path = self._walked(begin, known)
        pace = self._pace() if fresh else (0.0, 0.0)
        gap = end - known
        owed = (0.0, 0.0)
        since, guessed_x, guessed_y = self.guess
        if since < begin:
            right = min(max(self.known_until, since), begin)
            late_x, late_y, *_ = self._walked(since, right)
            owed = (
                late_x + pace[0] * (begin - right) - guessed_x,
                late_y + pace[1] * (begin - right) - guessed_y,
            )
        self.guess = (known, pace[0] * gap, pace[1] * gap) if gap > 0.0 else (math.inf, 0.0, 0.0)
        walking = path > 0.0 or pace != (0.0, 0.0)
        if not fresh:
            level, haste = settings.unknown, 0.0
        elif walking:
            level, haste = settings.walking, (settings.guessed * gap) ** 2
        elif self.activity == "still":
            level, haste = settings.standing, (0.3 * settings.guessed * gap) ** 2
        else:
            level, haste = settings.restless, (0.5 * settings.guessed * gap) ** 2
        open_ = level**2 * duration
        return Displacement(
            shift=(x + pace[0] * gap, y + pace[1] * gap),
            owed=owed,
            variance=(xx + open_, xy, yy + open_),
            haste=haste,
            path=path + math.hypot(*pace) * gap if fresh else settings.unknown * duration,
        )

    def still_for(self, t: float) -> float:
        """Return for how many seconds the phone has rested."""
        return max(t - self.still_since, 0.0) if math.isfinite(self.still_since) else 0.0

    def pace(self, t: float) -> tuple[float, float]:
        """Return the velocity with which it is believed to go on until ``t``, m/s."""
        return self._pace() if t - self.known_until <= STALE else (0.0, 0.0)

    def state(self) -> dict[str, Any]:
        """Return what is known, as plain values."""
        return {
            "steps": list(self.steps),
            "known_until": _told(self.known_until),
            "activity": self.activity,
            "still_since": _told(self.still_since),
            "guess": [_told(self.guess[0]), *self.guess[1:]],
        }

    @classmethod
    def of(cls, state: dict[str, Any]) -> WalkLog:
        """Return the log of ``state()``."""
        since, x, y = state["guess"]
        return cls(
            steps=[tuple(float(value) for value in step) for step in state["steps"]],
            known_until=-math.inf if state["known_until"] is None else state["known_until"],
            activity=state["activity"],
            still_since=math.nan if state["still_since"] is None else state["still_since"],
            guess=(math.inf if since is None else since, x, y),
        )

    def _walked(self, begin: float, end: float) -> tuple[float, ...]:
        """Return dx, dy, xx, xy, yy and the path of the steps between two times, partial steps in part."""
        x = y = xx = xy = yy = path = 0.0
        for step in self.steps:
            first, last = step[0], step[1]
            if first >= end or last <= begin:
                continue
            _, _, dx, dy, *variance = step
            share = min((min(last, end) - max(first, begin)) / max(last - first, 1e-3), 1.0)
            x, y, path = x + share * dx, y + share * dy, path + share * math.hypot(dx, dy)
            xx, xy, yy = xx + share * variance[0], xy + share * variance[1], yy + share * variance[2]
        return x, y, xx, xy, yy, path

    def _pace(self) -> tuple[float, float]:
        """Return the velocity that is believed to go on, m/s: nothing once steps have ceased."""
        if not self.steps or self.known_until - self.steps[-1][1] > 0.8:
            return 0.0, 0.0
        x, y, *_ = self._walked(self.known_until - PACE, self.known_until)
        return x / PACE, y / PACE


def _step(length: float, heading: float, spread: float, turn: float) -> tuple[float, ...]:
    """Return dx, dy, xx, xy, yy of a step."""
    cos, sin = math.cos(heading), math.sin(heading)
    across = length**2 * turn
    return (
        length * cos,
        length * sin,
        spread * cos**2 + across * sin**2,
        (spread - across) * cos * sin,
        spread * sin**2 + across * cos**2,
    )


def _either(length: float, heading: float, other: float, chance: float, turn: float) -> tuple[float, ...]:
    """Return the mean and spread of a step of which two headings are possible."""
    one, two = _step(length, heading, 0.02, turn), _step(length, other, 0.02, turn)
    x, y = one[0] + chance * (two[0] - one[0]), one[1] + chance * (two[1] - one[1])
    apart_x, apart_y = two[0] - one[0], two[1] - one[1]
    between = chance * (1.0 - chance)
    xx, xy, yy = (one[k] + chance * (two[k] - one[k]) for k in (2, 3, 4))
    return x, y, xx + between * apart_x**2, xy + between * apart_x * apart_y, yy + between * apart_y**2


def _told(value: float) -> float | None:
    return value if math.isfinite(value) else None
