"""What changed about access points, and what becomes of the evidence from before.

One that only sends otherwise keeps its map and has its old readings moved by as much; one that hangs elsewhere loses
them; behind a new wall they go where they no longer hold.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.radio.evidence import RadioEvidence
from services.learning.radio.placing import HANGS, visits_at
from services.learning.radio.shifts import Shift
from services.learning.radio.wording import moved_words, placed_words, reading_words
from shared.radio import PathLoss, RadioFit, RadioPrior, Whereabouts, locate_access_point

__all__ = ["Change", "Changes"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

GONE = 0.02
"""How much stays of an access point's evidence from before it moved, or in the lee of a new wall."""
SHIFTED = 0.5
"""The same where it only sends otherwise: the map keeps its shape."""
REACH = 2.0
"""Metres around a block that reads otherwise in which older evidence goes."""
SENT = (2.0, 0.15)
"""dB, and of the exponent: how well it is known what an access point sends, wherever it hangs now."""
MOVED, MOVED_NATS = 2.0, 6.0
"""Metres and nats from which one counts as moved. Readings of 52 that were not never said so by more than 4.4 nats."""
KNOWN = 3.0
"""Metres to which its new place must be known."""
TOLD = 1800.0
"""Seconds for which an operator is told of a change, and its access point looked for elsewhere."""
FEWEST = 12
"""Visits."""


@dataclass(frozen=True)
class Change:
    """What was found of an access point at ``found``: it reads ``by`` dB otherwise ``since`` then, or its place."""

    state: Literal["changed", "moved", "placed"]
    found: float
    since: float
    by: float
    words: str


class Changes:
    """Of one area's access points.

    Args:
        file: the path loss as the site file says.
        lower: (2,) corner of where access points may hang, metres; ``upper`` the other.
        upper: see above.
        prior: of the radio.

    Attributes:
        guess: path loss from which lessons start: the site file's, moved access points where they hang now, and those
            it does not place where they were found.
        found: what changed lately, by access point.
        located: the new places of those that moved, and those of which no place was known.
    """

    def __init__(self, file: PathLoss, lower: Array, upper: Array, prior: RadioPrior) -> None:
        self._file, self._lower, self._upper, self._prior = file, lower, upper, prior
        self.guess = file
        self.found: dict[int, Change] = {}
        self.located: dict[int, Whereabouts] = {}

    def take(self, shifts: Sequence[Shift], evidence: RadioEvidence, reference: RadioFit, now: float) -> bool:
        """Note what reads otherwise, and change evidence accordingly; returns whether it was changed."""
        self.found = {point: change for point, change in self.found.items() if change.found > now - TOLD}
        for shift in shifts:
            self._note(shift, now)
            if shift.whole:
                evidence.shift(shift.point, shift.since, shift.by)
                evidence.fade(shift.point, shift.since, SHIFTED)
            else:
                evidence.fade(shift.point, shift.since, GONE, shift.places, REACH)
        doubtful = [point for point, change in self.found.items() if change.state == "changed"]
        moved = [self._moved(point, evidence, reference, now) for point in doubtful]  # later looks tell more
        return bool(shifts) or any(moved)

    def place(self, point: int, where: Whereabouts, now: float) -> None:
        """Note where an access point hangs that the site file does not place."""
        change = self.found.get(point)
        if point not in self.located:
            self.found[point] = Change("placed", now, now, 0.0, placed_words(self.guess.names[point], live=True))
        elif change is not None and change.state != "placed":
            return  # it hung elsewhere when most of this was heard
        self._hang(point, where)

    def state(self) -> dict[str, Any]:
        """Return all it knows."""
        return {
            "filed": [
                place if placed else None
                for place, placed in zip(self._file.positions.tolist(), self._file.placed.tolist(), strict=True)
            ],
            "found": {str(point): dataclasses.asdict(change) for point, change in self.found.items()},
            "located": {
                str(point): [*where.place.tolist(), *where.covariance.ravel().tolist(), where.gain]
                for point, where in self.located.items()
            },
        }

    def restore(self, state: Mapping[str, Any], columns: Index) -> None:
        """Go on from ``state()``. What the site file says anew of a place is believed, and not what was found before.

        Args:
            state: see there.
            columns: (k,) which access point here each of the k of the state is; what was found of −1 goes.

        Raises:
            ValueError, KeyError, TypeError, AttributeError: it is no such state; nothing is changed then.
        """
        filed = np.array([place or (np.nan,) * 3 for place in state["filed"]], float)
        if filed.reshape(-1, 3).shape != (len(columns), 3):
            raise ValueError(f"filed: found shape {filed.shape}; allowed: {(len(columns), 3)}")
        found = {_number(point, columns): msgspec.convert(change, Change) for point, change in state["found"].items()}
        located = {}
        for name, row in state["located"].items():
            point = _number(name, columns)
            x, y, xx, xy, yx, yy, gain = (float(value) for value in row)
            if point >= 0 and np.allclose(filed[int(name)], self._file.positions[point], equal_nan=True):
                located[point] = Whereabouts(np.array([x, y]), np.array([[xx, xy], [yx, yy]]), gain)
        self.guess, self.located = self._file, {}
        self.found = {point: change for point, change in found.items() if point >= 0}
        for point, where in located.items():
            self._hang(point, where)

    def _note(self, shift: Shift, now: float) -> None:
        since, by, whole = shift.since, shift.by, shift.whole
        before = self.found.get(shift.point)
        if before is not None and before.by * by < 0.0:  # it was taken for the whole of what is so in part only
            since, by, whole = before.since, before.by, False
        words = reading_words(self.guess.names[shift.point], by, since, whole=whole)
        self.found[shift.point] = Change("changed", now, since, by, words)

    def _moved(self, point: int, evidence: RadioEvidence, reference: RadioFit, now: float) -> bool:
        """Return whether what an access point read since it changed says that it hangs elsewhere; believe it then."""
        since, by, here = self.found[point].since, self.found[point].by, self.guess.positions[point]
        where = self._locate(point, since, evidence, reference)
        if where is None or where.gain < MOVED_NATS or where.error > KNOWN:
            return False
        away = float(np.hypot(*(where.place - here[:2])))
        if away < max(MOVED, 2.5 * where.error):
            return False
        self._hang(point, where)
        evidence.fade(point, since, GONE)
        self.found[point] = Change("moved", now, since, by, moved_words(self.guess.names[point], away, since))
        return True

    def _locate(self, point: int, since: float, evidence: RadioEvidence, reference: RadioFit) -> Whereabouts | None:
        visits, _, _ = evidence.visits(since=since, sure=True)
        mine = visits.where(visits.point == point)
        if len(mine) < FEWEST:
            return None
        known, here = reference.model.path_loss, self.guess.positions[point]
        level, weight = visits_at(mine, np.ones(len(mine)), reference)
        return locate_access_point(
            mine.place, level, weight, self._lower, self._upper, height=float(here[2]),
            power=float(known.power_1m[point]), exponent=float(known.exponent[point]), asked=here[:2], sure=SENT,
            prior=self._prior,
        )  # fmt: skip

    def _hang(self, point: int, where: Whereabouts) -> None:
        height = self._file.positions[point, 2]
        positions = self.guess.positions.copy()
        positions[point] = (*where.place, height if np.isfinite(height) else HANGS)
        self.guess = dataclasses.replace(self.guess, positions=positions)
        self.located[point] = where


def _number(point: str, columns: Index) -> int:
    number = int(point)
    if not 0 <= number < len(columns):
        raise ValueError(f"access point {point}: allowed: 0 to {len(columns) - 1}")
    return int(columns[number])
