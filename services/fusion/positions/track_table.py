"""The tracks of one area as columns."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import unpack

__all__ = ["TrackTable"]

Array = NDArray[np.float64]


@dataclass
class TrackTable:
    """All tracks, one row each.

    Attributes:
        ids: (n,), never used twice.
        mean: (n, 4) x, y, vx, vy; metres, m/s.
        covariance: (n, 4, 4) of the filter; ``spread`` says how far off the place may really be.
        common: (n, 2, 2) m², the part of the last detection's variance that its camera's next ones share.
        born: (n,) time of the first detection.
        seen: (n,) time of the newest detection.
        missed: (n,) seconds during which cameras looked and did not see it, since then; 0 while it is seen.
        looked: (n,) up to when ``missed`` was counted.
        hits: (n,) number of detections.
        score: (n,) sum of their confidences.
        confirmed: (n,) whether it is taken for a person.
        existence: (n,) probability that the person is still there; 1 while it is seen.
        resting: (n,) whether it stood still when it was seen last and is missed since: its place is held, its velocity
            is zero, its covariance grows slowly. A detector that learns its background loses people who stand, so they
            are most likely still there; ``existence`` says how likely.
        woke: (n,) time at which it was seen again after having rested; minus infinity where it never did.
        anchor: (n, 2) where it was in the last seconds, on average.
        origin: (n, 2) where it was seen first.
        walked: (n,) whether it ever was far from there: reflections and ghosts never are.
        quality: (n,) share of the last seconds in which it was seen.
        camera: (n,) number of the camera that saw it last.
        fix: (n, 3) x, y and time, by that camera's clock, of the last detection.
        fed: (n,) bits of the cameras that saw it in this chunk.
    """

    ids: NDArray[np.int64]
    mean: Array
    covariance: Array
    common: Array
    born: Array
    seen: Array
    missed: Array
    looked: Array
    hits: NDArray[np.int64]
    score: Array
    confirmed: NDArray[np.bool_]
    existence: Array
    resting: NDArray[np.bool_]
    woke: Array
    anchor: Array
    origin: Array
    walked: NDArray[np.bool_]
    quality: Array
    camera: NDArray[np.int64]
    fix: Array
    fed: NDArray[np.int64]

    @classmethod
    def start(
        cls,
        ids: NDArray[np.int64],
        mean: Array,
        covariance: Array,
        common: Array,
        t: float,
        confidence: Array,
        camera: int,
        clock: float,
    ) -> TrackTable:
        """Return unconfirmed tracks of (n,) detections that ``camera`` made at ``t``, its clock telling ``clock``."""
        count = len(ids)
        return cls(
            ids=ids,
            mean=mean,
            covariance=covariance,
            common=common,
            born=np.full(count, t),
            seen=np.full(count, t),
            missed=np.zeros(count),
            looked=np.full(count, t),
            hits=np.ones(count, np.int64),
            score=confidence,
            confirmed=np.zeros(count, np.bool_),
            existence=np.ones(count),
            resting=np.zeros(count, np.bool_),
            woke=np.full(count, -np.inf),
            anchor=mean[:, :2].copy(),
            origin=mean[:, :2].copy(),
            walked=np.zeros(count, np.bool_),
            quality=np.full(count, 0.5),
            camera=np.full(count, camera),
            fix=np.column_stack([mean[:, :2], np.full(count, clock)]),
            fed=np.full(count, 1 << camera),
        )

    @classmethod
    def empty(cls) -> TrackTable:
        """Return a table without rows."""
        nothing = np.zeros(0)
        return cls.start(
            np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros((0, 2, 2)), 0.0, nothing, 0, 0.0
        )

    def spread(self) -> Array:
        """Return (n, 2, 2) m²: covariance of the places, with the errors that no averaging removes."""
        spread: Array = self.covariance[:, :2, :2] + self.common
        return spread

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drop all other rows."""
        for name in _COLUMNS:
            setattr(self, name, getattr(self, name)[rows])

    def append(self, other: TrackTable) -> None:
        """Add the rows of another table."""
        for name in _COLUMNS:
            setattr(self, name, np.concatenate([getattr(self, name), getattr(other, name)]))

    def state(self) -> dict[str, Any]:
        """Return a copy of the columns by name."""
        return {name: getattr(self, name).copy() for name in _COLUMNS}

    @classmethod
    def restored(cls, state: dict[str, Any]) -> TrackTable:
        """Return the table that ``state()``, encoded and decoded, came from.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        table = cls(**{name: unpack(state[name]) for name in _COLUMNS})
        if {len(getattr(table, name)) for name in _COLUMNS} != {len(table.ids)}:
            raise msgspec.ValidationError("track columns of different lengths")
        return table


_COLUMNS = tuple(field.name for field in fields(TrackTable))
