"""What was said of the last seconds, and where the present best explanation says otherwise.

A device's explanation is the lineage of the hypothesis it was given: which track it was on, slot by slot. Where that is
another track than the one published then, the past is told anew: the points of the right track, gaps bridged.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.evidence.belief import SLOTS, UNSEEN
from services.fusion.evidence.identity import SLOT, IdentityLayer
from shared.messages import Covariance, Revision, TrackFrame

__all__ = ["Reviser"]

Array = NDArray[np.float64]

NOTHING = -1
"""In what was said: nothing."""
HORIZON = 24
"""Slots a revision reaches back."""
SEEN_VARIANCE = 0.04
"""m²; of a point on a track."""
BRIDGE = 0.5
"""m²/s by which a place bridged between two tracks may be off, by the seconds from the nearer end."""


class Reviser:
    """Remembers what was published of each device in the last seconds."""

    def __init__(self) -> None:
        self._said: dict[str, list[tuple[int, int, float, float, float]]] = {}
        self._settled: dict[str, int] = {}

    def revise(self, chunk: int, tracker: str, frame: TrackFrame, layer: IdentityLayer) -> Revision | None:
        """Note what a frame said and return what it makes of the past; None where that stands."""
        if not math.isfinite(layer.columns.history.newest):
            return None
        slot = math.floor(layer.columns.history.newest / SLOT)
        self._note(slot, frame)
        revised: list[tuple[str, float, list[tuple[float, int, Array, Covariance, float]]]] = []
        for row in np.flatnonzero(layer.given >= 0).tolist():
            device = layer.devices[row]
            if device is None:
                continue
            found = self._of_device(row, device, slot, layer)
            if found is not None:
                revised.append((device, *found))
        if not revised:
            return None
        points = [(number, *point) for number, (_, _, mine) in enumerate(revised) for point in mine]
        return Revision(
            t=frame.t,
            area=frame.area,
            chunk=chunk,
            tracker=tracker,
            device=[device for device, _, _ in revised],
            since=[since for _, since, _ in revised],
            of=[point[0] for point in points],
            at=[point[1] for point in points],
            track=[point[2] for point in points],
            x=[float(point[3][0]) for point in points],
            y=[float(point[3][1]) for point in points],
            covariance=[point[4] for point in points],
            probability=[point[5] for point in points],
        )

    def _note(self, slot: int, frame: TrackFrame) -> None:
        told = {device: index for index, device in enumerate(frame.device) if device is not None}
        for device in told.keys() | self._said.keys():
            said = self._said.setdefault(device, [])
            index = told.get(device)
            if index is None:
                entry = (slot, NOTHING, 0.0, 0.0, 0.0)
            else:
                track = UNSEEN if frame.state[index] == "unseen" else frame.track[index]
                xx, _, yy = frame.covariance[index]
                entry = (slot, track, frame.x[index], frame.y[index], max(xx, yy))
            if said and said[-1][0] == slot:
                said[-1] = entry
            else:
                said.append(entry)
            del said[:-SLOTS]
        for device in [one for one, said in self._said.items() if all(entry[1] == NOTHING for entry in said)]:
            del self._said[device]

    def _of_device(
        self, row: int, device: str, slot: int, layer: IdentityLayer
    ) -> tuple[float, list[tuple[float, int, Array, Covariance, float]]] | None:
        """Return since when a device's past is another than was said, and its points; None where it is not."""
        column = int(layer.given[row])
        track = int(layer.columns.tracks[column])
        if self._settled.get(device) == track:
            return None
        self._settled[device] = track
        lineage = layer.beliefs.lineage[row, column]
        said = {entry[0]: entry for entry in self._said.get(device, [])}
        slots = list(range(max(slot - HORIZON, layer.beliefs.slot - SLOTS + 1), slot))
        now = {number: int(lineage[number % SLOTS]) for number in slots}
        wrong = [n for n in slots if now[n] != UNSEEN and said.get(n, (n, NOTHING))[1] != now[n]]
        wrong += [n for n in slots if now[n] == UNSEEN and said.get(n, (n, NOTHING))[1] > UNSEEN]
        if not wrong:
            return None
        first = min(wrong)
        points = _points(layer, [n for n in slots if n >= first], now, said, float(layer.probability[row, column]))
        mine = self._said.setdefault(device, [])
        kept = [entry for entry in mine if entry[0] < first]
        placed = {math.floor(at / SLOT + 1e-3): (spot, place) for at, spot, place, _, _ in points}
        for number in range(first, slot):
            spot, place = placed.get(number, (NOTHING, np.zeros(2)))
            kept.append((number, spot, float(place[0]), float(place[1]), SEEN_VARIANCE))
        self._said[device] = [*kept, *(entry for entry in mine if entry[0] >= slot)][-SLOTS:]
        return first * SLOT, points

    def erase(self, device: str) -> None:
        """Forget a device."""
        self._said.pop(device, None)
        self._settled.pop(device, None)

    def state(self) -> dict[str, Any]:
        """Return a copy."""
        return {
            "said": {device: list(said) for device, said in self._said.items()},
            "settled": dict(self._settled),
        }

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Reviser:
        """Return what ``state()`` was taken of."""
        reviser = cls()
        reviser._said = {
            str(device): [(int(n), int(k), float(x), float(y), float(v)) for n, k, x, y, v in said]
            for device, said in state["said"].items()
        }
        reviser._settled = {str(device): int(track) for device, track in state["settled"].items()}
        return reviser


def _points(
    layer: IdentityLayer,
    slots: list[int],
    now: dict[int, int],
    said: dict[int, tuple[int, int, float, float, float]],
    probability: float,
) -> list[tuple[float, int, Array, Covariance, float]]:
    """Return time, track, place, covariance and probability of each slot that is known."""
    known: dict[int, Array] = {}
    for number in slots:
        column = layer.columns.find(now[number])
        if now[number] == UNSEEN or column < 0:
            continue
        place = layer.columns.history.at(number * SLOT)[column]
        if np.isfinite(place[0]):
            known[number] = place
    points = []
    seen = np.array(sorted(known))
    for number in slots:
        if number in known:
            v = SEEN_VARIANCE
            points.append((number * SLOT, now[number], known[number], (v, 0.0, v), probability))
            continue
        before, after = seen[seen < number], seen[seen > number]
        if len(before) and len(after):
            a, b = int(before[-1]), int(after[0])
            place = known[a] + (number - a) / (b - a) * (known[b] - known[a])
            v = SEEN_VARIANCE + BRIDGE * SLOT * min(number - a, b - number)
            points.append((number * SLOT, UNSEEN, place, (v, 0.0, v), probability))
        elif said.get(number, (0, NOTHING))[1] == UNSEEN:
            _, _, x, y, v = said[number]
            points.append((number * SLOT, UNSEEN, np.array([x, y]), (v, 0.0, v), probability))
    return points
