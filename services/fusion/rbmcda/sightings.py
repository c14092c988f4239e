"""What did the cameras see at the end of a cycle, and which of it is the same person as a cycle before?

A cycle of one second holds up to thirty frames of each camera. From frame to frame a detection moves by centimetres,
so that it is linked to the one before as long as nobody else is near [ravel-thesis §4.1: link only what is
unambiguous]. The filter is given one sighting per person: the newest place, and the link it bears since cycles
before. Detections flicker: who is missing in the newest frame is taken from those just before it, with more noise,
and what only one frame in many shows is no person. Two cameras that see one floor see the same people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.positions.believable import believable
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.snapshot import unpack
from shared.messages import DetectionFrame

__all__ = ["SightingLinks", "Sightings"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

PACE = 1.0
"""Metres per second by which an older detection may be off."""
FASTEST = 2.0
"""Metres per second, and metres of noise, within which a detection is the same person's."""
SLACK = 0.3
FARTHEST = 1.2
"""Metres; beyond, no link is unambiguous."""
ENOUGH, MANY = 3, 8
"""Detections that make a person, where a cycle has so many frames."""
LARGEST_VARIANCE = 1e4


@dataclass(frozen=True)
class Sightings:
    """Who was seen at the end of a cycle, d people.

    Attributes:
        places: (d, 2) metres.
        noise: (d, 2, 2) m².
        link: (d,) numbers that stay the same as long as it is surely the same person.
        cameras: that saw each.
    """

    places: Array
    noise: Array
    link: Indices
    cameras: list[list[str]]

    def state(self) -> dict[str, Any]:
        """Return them as a state holds them."""
        arrays = {name: getattr(self, name) for name in ("places", "noise", "link")}
        return {**arrays, "cameras": self.cameras}

    @classmethod
    def of(cls, state: dict[str, Any]) -> Sightings:
        """Return the sightings of ``state()``."""
        arrays = {name: unpack(state[name]) for name in ("places", "noise", "link")}
        return cls(**arrays, cameras=[[str(name) for name in cameras] for cameras in state["cameras"]])


class SightingLinks:
    """Follows detections from frame to frame."""

    def __init__(self, lower: Array, upper: Array, settings: RbmcdaSettings) -> None:
        self._lower, self._upper, self._settings = lower, upper, settings
        self._next = 1
        self._place, self._noise = np.zeros((0, 2)), np.zeros((0, 2, 2))
        self._t = np.zeros(0)
        self._link, self._hits = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._cameras: list[set[str]] = []

    def cycle(self, frames: Sequence[DetectionFrame], t: float) -> tuple[Sightings, int]:
        """Return what is seen at ``t``, the end of a cycle, and how many detections made no sense."""
        self._hits[:] = 0
        self._cameras = [set() for _ in self._link]
        nonsense = 0
        for frame in sorted(frames, key=lambda frame: (frame.t, frame.camera)):
            nonsense += self._frame(frame)
        most = max(np.unique([frame.camera for frame in frames], return_counts=True)[1], default=0)
        fresh = self._t >= t - self._settings.fresh
        fresh &= self._hits >= (ENOUGH if most >= MANY else 1)
        self._part(np.flatnonzero(fresh))
        told = np.flatnonzero(fresh)
        lag = PACE * np.maximum(t - self._t[told], 0.0)
        extra = self._settings.camera**2 + lag**2
        sightings = Sightings(
            places=self._place[told],
            noise=self._noise[told] + extra[:, None, None] * np.eye(2),
            link=self._link[told],
            cameras=[sorted(self._cameras[index]) for index in told.tolist()],
        )
        self._keep(self._t >= t - 2.0 * self._settings.fresh)
        return sightings, nonsense

    def state(self) -> dict[str, Any]:
        """Return what is followed."""
        return {
            "next": self._next,
            "cameras": [sorted(cameras) for cameras in self._cameras],
            **{name: getattr(self, f"_{name}").copy() for name in _COLUMNS},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        arrays = {name: unpack(state[name]) for name in _COLUMNS}
        self._next, self._cameras = int(state["next"]), [set(cameras) for cameras in state["cameras"]]
        for name, array in arrays.items():
            setattr(self, f"_{name}", array)

    def _frame(self, frame: DetectionFrame) -> int:
        spots, spread, nonsense = _usable(frame, self._lower, self._upper)
        gone = np.maximum(frame.t - self._t, 0.0)
        reach = np.minimum(SLACK + FASTEST * gone, FARTHEST)
        reach[frame.t - self._t > 2.0 * self._settings.fresh] = 0.0
        found = _matches(spots, self._place, reach)
        for index in np.flatnonzero(found >= 0).tolist():
            row = found[index]
            self._place[row], self._noise[row] = spots[index], spread[index]
            self._t[row] = max(self._t[row], frame.t)
            self._hits[row] += 1
            self._cameras[row].add(frame.camera)
        new = found < 0
        count = int(new.sum())
        self._place, self._noise = (
            np.concatenate([self._place, spots[new]]),
            np.concatenate([self._noise, spread[new]]),
        )
        self._t = np.concatenate([self._t, np.full(count, frame.t)])
        self._link = np.concatenate([self._link, self._next + np.arange(count)])
        self._hits = np.concatenate([self._hits, np.ones(count, np.int64)])
        self._cameras += [{frame.camera} for _ in range(count)]
        self._next += count
        return nonsense

    def _part(self, rows: Indices) -> None:
        """Give new links to people who have met: who is who from here on is not known."""
        place = self._place[rows]
        apart = np.linalg.norm(place[:, None] - place[None], axis=2) + 1e6 * np.eye(len(rows))
        met = rows[(apart < self._settings.same).any(axis=1)]
        self._link[met] = self._next + np.arange(len(met))
        self._next += len(met)

    def _keep(self, rows: NDArray[np.bool_]) -> None:
        for name in _COLUMNS:
            setattr(self, f"_{name}", getattr(self, f"_{name}")[rows])
        self._cameras = [self._cameras[index] for index in np.flatnonzero(rows).tolist()]


_COLUMNS = ("place", "noise", "t", "link", "hits")


def _usable(frame: DetectionFrame, lower: Array, upper: Array) -> tuple[Array, Array, int]:
    """Return places and noise of the detections that can be believed, in an order of their own, and how many cannot."""
    spots = np.column_stack([frame.x, frame.y]).reshape(-1, 2)
    packed = np.array(frame.covariance, float).reshape(-1, 3)
    with np.errstate(invalid="ignore", over="ignore"):
        fine = ((spots >= lower) & (spots <= upper)).all(axis=1)
        fine &= believable(packed) & (packed < LARGEST_VARIANCE).all(axis=1)
    spots, packed = spots[fine], packed[fine]
    order = np.lexsort((spots[:, 1], spots[:, 0]))
    spots, packed = spots[order], packed[order]
    spread = np.stack([packed[:, [0, 1]], packed[:, [1, 2]]], axis=1).reshape(-1, 2, 2)
    return spots, spread, int((~fine).sum())


def _matches(spots: Array, places: Array, reach: Array) -> Indices:
    """Return (n,) which place each spot belongs to, nearest pairs first and one to one; -1 for none."""
    found = np.full(len(spots), -1, np.int64)
    if not len(spots) or not len(places):
        return found
    apart = np.linalg.norm(spots[:, None] - places[None], axis=2)
    rows, columns = np.nonzero(apart < reach)
    taken = np.zeros(len(places), np.bool_)
    for pair in np.argsort(apart[rows, columns], kind="stable").tolist():
        row, column = rows[pair], columns[pair]
        if found[row] < 0 and not taken[column]:
            found[row] = column
            taken[column] = True
    return found
