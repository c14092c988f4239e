"""Where is everybody by sight alone, with many guesses at who is who? The vision-only filter, once a second."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.anonymous_tracks import AnonymousTracks, TrackRows
from benchmarks.baselines.sightings import Sightings
from benchmarks.world_record import WorldRecord
from services.fusion.rbmcda.sight_particles import Particles, RbmcdaParameters, View

__all__ = ["Particles", "RbmcdaParameters", "View", "track"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def track(record: WorldRecord, times: Array, parameters: RbmcdaParameters | None = None) -> AnonymousTracks:
    """Return the tracks of the record's detections at ``times`` (n,), not decreasing; causal.

    Cameras of one area are taken together, as if no two saw the same place.
    """
    chosen = parameters or RbmcdaParameters()
    sightings = Sightings.of(record.frames)
    particles = Particles(View(record.view), chosen)
    rows = TrackRows(times)
    told: tuple[float, Indices, Array] | None = None
    for t, detections in _cycles(sightings, chosen.cycle):
        _report(rows, told, until=t)
        particles.scan(t, sightings.position[detections], sightings.noise[detections])
        told = (t, *particles.people())
    _report(rows, told, until=math.inf)
    return rows.tracks()


def _cycles(sightings: Sightings, cycle: float) -> Iterator[tuple[float, Indices]]:
    """Yield the time and the rows of the newest frame of each camera in each cycle; its end, where there is no frame.

    The first cycle ends with the first frame. A frame keeps its own time: at 2 frames/s, one that is a little late for
    the end of its cycle leaves the cycle to a frame half a second old.
    """
    if len(sightings.t) == 0:
        return
    # A thousandth of a cycle forgives what rounding does to frames that fall on the end.
    number = np.ceil((sightings.t - sightings.t[0]) / cycle - 1e-3).astype(np.int64)
    for this in range(int(number[-1]) + 1):
        first, last = np.searchsorted(number, [this, this + 1])
        newest = {int(sightings.camera[frame]): frame for frame in range(first, last)}
        t = sightings.t[last - 1] if last > first else sightings.t[0] + this * cycle
        yield float(t), sightings.rows(newest.values())


def _report(rows: TrackRows, told: tuple[float, Indices, Array] | None, until: float) -> None:
    """Answer for the times before ``until``, carrying people on from the end of the last cycle."""
    for place in rows.due(until):
        if told is not None:
            t, ids, states = told
            rows.add(place, ids, states[:, :2] + (float(rows.times[place]) - t) * states[:, 2:])
