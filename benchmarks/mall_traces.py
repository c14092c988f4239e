"""What did a phone measure that was walked through a real shopping mall, and where was it? (``indoor-location``)

80 traces of surveyors with one phone model, held flat in the hand; way-points in metres, x east and y north of the
plan, stamped as they were passed. The straight line between two of them is a leg; people may have bent it.
"""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["NORTH", "Legs", "Trace", "load_traces", "read_trace"]

Array = NDArray[np.float64]

NORTH = np.pi / 2
"""Direction of north on this plan, radians counter-clockwise from +x."""
SENSORS = {
    "TYPE_ACCELEROMETER": "acceleration",
    "TYPE_GYROSCOPE": "rotation",
    "TYPE_MAGNETIC_FIELD": "field",
    "TYPE_ROTATION_VECTOR": "vector",
}


@dataclass(frozen=True, slots=True)
class Legs:
    """The k - 1 legs between k way-points.

    Attributes:
        begin: (k - 1,) s, when the first way-point was passed; ``end`` likewise.
        end: (k - 1,) s.
        length: (k - 1,) m.
        heading: (k - 1,) radians counter-clockwise from the plan's +x.
    """

    begin: Array
    end: Array
    length: Array
    heading: Array


@dataclass(frozen=True, slots=True)
class Trace:
    """One walk.

    Attributes:
        name: of its file.
        t: (n,) s, increasing; zero at the first way-point.
        acceleration: (n, 3) m/s², phone axes.
        rotation: (n, 3) rad/s.
        field: (n, 3) µT.
        vector: (n, 3) the phone's own rotation vector: x, y, z of the quaternion that turns phone axes to (east, north,
            up).
        way: (k, 3): s, x, y of the way-points.
    """

    name: str
    t: Array
    acceleration: Array
    rotation: Array
    field: Array
    vector: Array
    way: Array

    def legs(self) -> Legs:
        """Return the legs between neighbouring way-points."""
        step = np.diff(self.way[:, 1:], axis=0)
        return Legs(self.way[:-1, 0], self.way[1:, 0], np.hypot(*step.T), np.arctan2(step[:, 1], step[:, 0]))

    def samples(self) -> Array:
        """Return time and the nine channels that phones send, (n, 10)."""
        return np.column_stack([self.t, self.acceleration, self.rotation, self.field])


def read_trace(path: Path) -> Trace:
    """Return the trace in one file; what is no number, or lacks a sensor, is left out."""
    rows: dict[int, dict[str, list[float]]] = {}
    way = []
    with gzip.open(path, "rt", errors="replace") as lines:
        for line in lines:
            cell = line.rstrip("\n").split("\t")
            if len(cell) > 4 and cell[1] in SENSORS:
                rows.setdefault(int(cell[0]), {})[SENSORS[cell[1]]] = [float(value) for value in cell[2:5]]
            elif len(cell) > 3 and cell[1] == "TYPE_WAYPOINT":
                way.append((int(cell[0]), float(cell[2]), float(cell[3])))
    way.sort()
    stamps = sorted(stamp for stamp, row in rows.items() if len(row) == len(SENSORS))
    columns = {name: np.array([rows[stamp][name] for stamp in stamps]) for name in SENSORS.values()}
    start = way[0][0]
    return Trace(
        name=path.name.removesuffix(".txt.gz"),
        t=(np.array(stamps) - start) * 1e-3,
        way=np.array([((stamp - start) * 1e-3, x, y) for stamp, x, y in way]),
        **columns,
    )


def load_traces(data: Path) -> list[Trace]:
    """Return all traces, in order of their file names."""
    folder = data / "indoor-location" / "site1" / "F1" / "path_data_files"
    return [read_trace(path) for path in sorted(folder.glob("*.txt.gz"))]
