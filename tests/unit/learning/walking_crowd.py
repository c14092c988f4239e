"""A small hall with people who walk about, phones that hear it and step with them: stretches made to order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch
from shared.radio import PathLoss

__all__ = ["POINTS", "Crowd"]

Array = NDArray[np.float64]
POINTS = 8
SIZE = (24.0, 14.0)


class Crowd:
    """People whose paths over a minute are known; ``still`` ones never move."""

    def __init__(self, seed: int, people: int = 8, seconds: int = 60, *, still: bool = False) -> None:
        self.rng = np.random.default_rng(seed)
        corners = [
            (0.0, 0.0),
            (24.0, 0.0),
            (0.0, 14.0),
            (24.0, 14.0),
            (12.0, 0.0),
            (12.0, 14.0),
            (0.0, 7.0),
            (24.0, 7.0),
        ]
        self.radio = PathLoss(
            tuple(f"ap{k}" for k in range(POINTS)),
            np.array([(*corner, 2.8) for corner in corners]),
            np.full(POINTS, -40.0),
            np.full(POINTS, 2.4),
        )
        self.bias = self.rng.normal(0.0, 3.0, POINTS)
        self.t = np.arange(0.0, seconds + 0.1, 0.2)
        self.paths = np.stack([self._path(still=still) for _ in range(people)])

    def _path(self, *, still: bool) -> Array:
        place = self.rng.uniform((2.0, 2.0), (SIZE[0] - 2.0, SIZE[1] - 2.0))
        if still:
            return np.repeat(place[None], len(self.t), axis=0)
        path, goal, rest = [], place, 0.0
        for _ in self.t:
            if np.hypot(*(goal - place)) < 0.3:
                goal = self.rng.uniform((1.0, 1.0), (SIZE[0] - 1.0, SIZE[1] - 1.0))
                rest = self.rng.uniform(0.0, 6.0)
            rest -= 0.2
            if rest <= 0.0:
                place = place + 0.24 * (goal - place) / max(float(np.hypot(*(goal - place))), 0.24)
            path.append(place)
        return np.array(path)

    def readings(self, person: int) -> tuple[Array, NDArray[np.int64], Array]:
        """Return t, access point and dBm (r,) of one scan a second: shadowing that walks along, and quick noise."""
        rows = np.arange(0, len(self.t), 5)
        level = self.radio.rssi(self.paths[person, rows]) + self.bias
        moved = np.concatenate([[0.0], np.hypot(*np.diff(self.paths[person, rows], axis=0).T)])
        shade = self.rng.normal(0.0, 3.0, POINTS)
        noisy = np.empty_like(level)
        for k in range(len(rows)):
            kept = np.exp(-moved[k] / 3.0 - 1.0 / 20.0)
            shade = kept * shade + np.sqrt(1.0 - kept**2) * self.rng.normal(0.0, 3.0, POINTS)
            noisy[k] = level[k] + shade + self.rng.normal(0.0, 2.0, POINTS)
        point = np.tile(np.arange(POINTS), len(rows))
        return np.repeat(self.t[rows], POINTS), point.astype(np.int64), np.round(noisy.ravel())

    def stretch(
        self,
        carrier: int,
        track: int | None = None,
        *,
        start: float = 0.0,
        readings: tuple[Array, NDArray[np.int64], Array] | None = None,
        path: Array | None = None,
        sight: float = 1.0,
    ) -> Stretch:
        """Return the stretch of person ``carrier``'s phone on the track of person ``track`` (or along ``path``)."""
        track = carrier if track is None else track
        own = self.paths[track] if path is None else path
        t = self.t + start
        noisy = own + self.rng.normal(0.0, 0.08, own.shape)
        scan_t, point, level = self.readings(carrier) if readings is None else readings
        rows = np.arange(0, len(self.t), 5)
        way = np.diff(self.paths[carrier, rows], axis=0)
        length, heading = np.hypot(*way.T), np.arctan2(way[:, 1], way[:, 0])
        walks = length > 0.3
        ends = t[rows][1:] - 0.05
        stood = np.column_stack([t[rows][:-1], t[rows][1:]])[~walks]
        count = int(walks.sum())
        others = [k for k in range(len(self.paths)) if k != track]
        return Stretch(
            device=f"phone-{carrier}",
            track=track + 1,
            t=t,
            place=noisy,
            covariance=np.tile(0.01 * np.eye(2), (len(t), 1, 1)),
            probability=np.full(len(t), 0.9),
            seen=np.ones(len(t), np.bool_),
            sight=np.full(len(t), sight),
            scan_t=scan_t + start,
            point=point,
            level=level,
            scan_place=np.column_stack([np.interp(scan_t, self.t, noisy[:, axis]) for axis in (0, 1)]),
            scan_spread=np.full(len(scan_t), 0.1),
            step_t=ends[walks],
            length=length[walks] * self.rng.normal(1.0, 0.1, count),
            length_variance=np.full(count, 0.01),
            heading=heading[walks] + 0.2,
            heading_variance=np.full(count, 0.15),
            walk=np.zeros(count, np.int64),
            still=stood,
            other=np.array(others, np.int64) + 1,
            other_t=t[rows],
            other_place=self.paths[others][:, rows],
        )
