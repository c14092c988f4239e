"""People who follow a recorded file: a ``t,id,x,y`` table, truth in the form of PETS 2009, or annotated ETH walkers.

Between two rows a person is where linear interpolation says. Speed and heading come from a smoothed path, because
annotated positions jitter by centimetres and a phone's gyroscope must not shake with them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from services.simulator.people import Movement

__all__ = ["ETH_RATE", "LINGER", "MOT_RATE", "Trajectories", "TrajectoryError"]

Array = NDArray[np.float64]

MOT_RATE = 7.0
"""Frames per second of PETS 2009: time of frame k, counted from 1, is (k - 1) / 7."""
ETH_RATE = 15.0
"""Frames per second of the ETH walkers; every sixth frame is annotated, the first of them is at 0 s."""
LINGER = 8.0
"""Seconds for which a person is still followed, walking on, before the first and after the last row, and into gaps."""
_GAP = 2.0  # rows further apart than this, seconds, leave the person absent in between
_STEP = 0.1  # spacing of the smoothed path, seconds
_SMOOTHING = 0.45  # standard deviation of the smoothing, seconds
_MOVING = 0.25  # below this speed, m/s, a person keeps facing where they did


class TrajectoryError(ValueError):
    """The file cannot be used: the text names file, line, field, value and what is allowed."""


@dataclass(frozen=True, slots=True)
class _Path:
    """One person: the rows as recorded, and the smoothed path on a regular grid."""

    t: Array
    xy: Array
    grid: Array
    heading: Array
    speed: Array
    walked: Array

    @classmethod
    def build(cls, t: Array, xy: Array) -> _Path:
        count = max(2, math.ceil((t[-1] - t[0]) / _STEP) + 1)
        grid = np.linspace(t[0], max(t[-1], t[0] + _STEP), count)
        spacing = grid[1] - grid[0]
        resampled = np.column_stack([np.interp(grid, t, xy[:, axis]) for axis in (0, 1)])
        # Mirrored about its own ends a straight walk stays straight, where "nearest" would brake at both ends.
        mirrored = _extend_oddly(resampled, min(count - 1, math.ceil(4 * _SMOOTHING / spacing)))
        smooth = gaussian_filter1d(mirrored, _SMOOTHING / spacing, axis=0)
        pad = (len(smooth) - count) // 2
        velocity = np.gradient(smooth, spacing, axis=0)[pad : pad + count]
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        heading = _steady_heading(np.arctan2(velocity[:, 1], velocity[:, 0]), speed)
        heading = gaussian_filter1d(heading, 0.3 / spacing, mode="nearest")
        return cls(t, xy, grid, heading, speed, np.concatenate([[0.0], np.cumsum(speed[1:] * spacing)]))

    def position(self, times: Array) -> Array:
        """Return (n, 2); outside the rows the person walks straight on."""
        xy = np.column_stack([np.interp(times, self.t, self.xy[:, axis]) for axis in (0, 1)])
        for end, side in ((0, np.minimum(times - self.t[0], 0.0)), (-1, np.maximum(times - self.t[-1], 0.0))):
            direction = np.array([math.cos(self.heading[end]), math.sin(self.heading[end])])
            xy += side[:, None] * self.speed[end] * direction
        return xy

    def present(self, times: Array) -> NDArray[np.bool_]:
        """Whether the rows say that the person is there, (n,)."""
        inside: NDArray[np.bool_] = (times >= self.t[0]) & (times <= self.t[-1])
        if len(self.t) > 1:
            after = np.searchsorted(self.t, times, side="left").clip(1, len(self.t) - 1)
            at_a_row = (times == self.t[after]) | (times == self.t[after - 1])
            inside &= at_a_row | (self.t[after] - self.t[after - 1] <= _GAP)
        return inside

    def known(self, times: Array) -> NDArray[np.bool_]:
        """Whether a row is near enough in time, (n,)."""
        after = np.searchsorted(self.t, times, side="left")
        to_next = self.t[np.minimum(after, len(self.t) - 1)] - times
        since_last = times - self.t[np.maximum(after - 1, 0)]
        near: NDArray[np.bool_] = (np.abs(to_next) <= LINGER) | (np.abs(since_last) <= LINGER)
        return near


class Trajectories:
    """The people of one table.

    Args:
        rows: (m, 4) of t, person number, x, y in seconds and metres, in any order.
        floor: id of the floor they walk on.

    Raises:
        TrajectoryError: there are no rows.
    """

    def __init__(self, rows: Array, floor: str) -> None:
        rows = np.asarray(rows, float).reshape(-1, 4)
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        if not len(rows):
            raise TrajectoryError("no rows: a trajectory file needs at least one")
        self._times = np.unique(rows[:, 0])
        self._paths: dict[str, _Path] = {}
        numbers, starts = np.unique(rows[:, 1], return_index=True)
        for number, own in zip(numbers, np.split(rows, starts[1:]), strict=True):
            t, first = np.unique(own[:, 0], return_index=True)
            self._paths[f"{number:g}"] = _Path.build(t, own[first, 2:])
        self._persons = tuple(self._paths)
        self._floors = (floor,)
        ends = np.array([(path.t[0], path.t[-1]) for path in self._paths.values()])
        self._first, self._last = ends[:, 0] - LINGER, ends[:, 1] + LINGER

    @property
    def persons(self) -> Sequence[str]:
        """Ids as in the file, ascending."""
        return self._persons

    @property
    def floors(self) -> Sequence[str]:
        """The floor."""
        return self._floors

    @property
    def end(self) -> float:
        """Time of the last row."""
        return float(self._times[-1])

    def longest_present(self, count: int) -> list[str]:
        """Return the ``count`` people with the most time in the table, longest first; ties go to the smaller id."""

        def duration(person: str) -> float:
            intervals = np.diff(self._paths[person].t)
            return float(intervals[intervals <= _GAP].sum())

        return sorted(self._persons, key=lambda person: (-duration(person), float(person)))[:count]

    def movement(self, times: Array, persons: Sequence[int] | NDArray[np.int64] | None = None) -> Movement:
        """Return how people moved; known from ``LINGER`` seconds before their first row to as long after the last."""
        times = np.asarray(times, float)
        chosen = range(len(self._persons)) if persons is None else [int(person) for person in persons]
        shape = (len(times), len(chosen))
        values = np.full((*shape, 5), np.nan)
        known, present = np.zeros(shape, bool), np.zeros(shape, bool)
        for column, person in enumerate(chosen):
            if not len(times) or times[-1] < self._first[person] or times[0] > self._last[person]:
                continue
            path = self._paths[self._persons[person]]
            known[:, column], present[:, column] = path.known(times), path.present(times)
            values[:, column, :2] = path.position(times)
            for place, curve in enumerate((path.heading, path.speed, path.walked), 2):
                values[:, column, place] = np.interp(times, path.grid, curve)
        values[~known] = np.nan
        return Movement(
            position=values[..., :2],
            heading=values[..., 2],
            speed=values[..., 3],
            walked=values[..., 4],
            floor=np.where(known, 0, -1).astype(np.int16),
            present=present,
        )

    def instants(self, after: float, until: float) -> Array:
        """Return the table's own times in (after, until]."""
        chosen: Array = self._times[(self._times > after) & (self._times <= until)]
        return chosen

    @classmethod
    def from_csv(cls, path: Path, floor: str) -> Trajectories:
        """Read a table with the header ``t,id,x,y`` (more columns are ignored): seconds, a number, metres.

        Raises:
            TrajectoryError: the file is missing or a line cannot be used.
        """
        lines = _lines(path)
        header = [name.strip() for name in next(lines, (0, []))[1]]
        missing = [name for name in ("t", "id", "x", "y") if name not in header]
        if missing:
            raise TrajectoryError(f"{path}: line 1: the header must hold t,id,x,y; {', '.join(missing)} missing")
        columns = [header.index(name) for name in ("t", "id", "x", "y")]
        rows = [_numbers(path, line, row, columns, ("t", "id", "x", "y")) for line, row in lines]
        return cls._from_rows(path, floor, rows)

    @classmethod
    def from_mot(cls, path: Path, floor: str) -> Trajectories:
        """Read ``frame,id,left,top,width,height,confidence,x,y,z``; frame k is at (k - 1) / 7 seconds.

        Raises:
            TrajectoryError: the file is missing or a line cannot be used.
        """
        rows = [_numbers(path, line, row, [0, 1, 7, 8], ("frame", "id", "x", "y")) for line, row in _lines(path)]
        return cls._from_rows(path, floor, [((frame - 1.0) / MOT_RATE, who, x, y) for frame, who, x, y in rows])

    @classmethod
    def from_eth(cls, path: Path, floor: str) -> Trajectories:
        """Read ``frame id x z y vx vz vy``, separated by blanks; the first frame is at 0 s, 15 frames are a second.

        Raises:
            TrajectoryError: the file is missing or a line cannot be used.
        """
        lines = _lines(path, blanks=True)
        rows = [_numbers(path, line, row, [0, 1, 2, 4], ("frame", "id", "x", "y")) for line, row in lines]
        first = min((row[0] for row in rows), default=0.0)
        return cls._from_rows(path, floor, [((frame - first) / ETH_RATE, who, x, y) for frame, who, x, y in rows])

    @classmethod
    def _from_rows(cls, path: Path, floor: str, rows: Sequence[tuple[float, ...]]) -> Trajectories:
        try:
            return cls(np.array(rows, float), floor)
        except TrajectoryError as error:
            raise TrajectoryError(f"{path}: {error}") from error


def _lines(path: Path, blanks: bool = False) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise TrajectoryError(f"{path}: cannot be read: {reason}") from error
    lines = text.splitlines()
    rows = (line.split() for line in lines) if blanks else csv.reader(lines)
    return ((number, row) for number, row in enumerate(rows, 1) if row)


def _numbers(
    path: Path, line: int, row: Sequence[str], columns: Sequence[int], names: Sequence[str]
) -> tuple[float, ...]:
    values = []
    for column, name in zip(columns, names, strict=True):
        if column >= len(row):
            raise TrajectoryError(f"{path}: line {line}: {name} is missing: only {len(row)} fields")
        try:
            value = float(row[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TrajectoryError(f"{path}: line {line}: {name} must be a finite number (found {row[column]!r})")
        values.append(value)
    return tuple(values)


def _extend_oddly(path: Array, count: int) -> Array:
    """Continue a path at both ends by ``count`` points, turned by 180 degrees about its end points."""
    head = 2.0 * path[0] - path[count:0:-1]
    tail = 2.0 * path[-1] - path[-2 : -2 - count : -1]
    return np.concatenate([head, path, tail])


def _steady_heading(heading: Array, speed: Array) -> Array:
    """Unwrap, and while a person hardly moves keep the last heading of real movement."""
    moving = np.flatnonzero(speed > _MOVING)
    if not len(moving):
        return np.full(len(heading), heading[0])
    unwrapped = np.unwrap(heading[moving])
    held: Array = unwrapped[np.searchsorted(moving, np.arange(len(heading)), side="right").clip(1) - 1]
    return held
