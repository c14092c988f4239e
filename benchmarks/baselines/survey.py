"""What did a surveyor hear where? The training data of the radio baselines, and readings as tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.messages import RadioScan
from shared.radio import PathLoss
from shared.site import Site

__all__ = ["Survey", "readings_of", "surveyed_path_loss"]

Array = NDArray[np.float64]

EXPONENTS = (1.0, 6.0)
"""The path-loss exponents that a site file allows, too."""


@dataclass(frozen=True)
class Survey:
    """Readings taken at known places.

    Attributes:
        access_points: site ids of the k access points surveyed.
        position: (s, 2), metres.
        readings: (s, samples, k), dBm; NaN where an access point was not heard.

    Raises:
        ValueError: the arrays do not fit together, or nothing was heard at all.
    """

    access_points: Sequence[str]
    position: Array
    readings: Array

    def __post_init__(self) -> None:
        """Refuse what does not fit together where it is made."""
        s, k = len(self.position), len(self.access_points)
        if self.position.shape != (s, 2) or s == 0:
            raise ValueError(f"survey: position has the shape {self.position.shape}; allowed: (s, 2), s > 0")
        if self.readings.ndim != 3 or self.readings.shape[::2] != (s, k):
            raise ValueError(f"survey: readings have the shape {self.readings.shape}; allowed: ({s}, samples, {k})")
        if not np.isfinite(self.readings).any():
            raise ValueError("survey: not one access point was heard anywhere")


def readings_of(scans: Sequence[RadioScan], access_points: Sequence[str]) -> tuple[Array, Array]:
    """Return times (n,) and readings (n, k) in dBm, NaN where not heard, of scans in the order of time.

    Access points that are not asked for are left out.
    """
    scans = sorted(scans, key=lambda scan: scan.t)
    column = {name: place for place, name in enumerate(access_points)}
    readings = np.full((len(scans), len(access_points)), np.nan)
    cells = [
        (row, column[name], power)
        for row, scan in enumerate(scans)
        for name, power in zip(scan.access_point, scan.rssi, strict=True)
        if name in column
    ]
    if cells:
        rows, columns, powers = (np.array(values) for values in zip(*cells, strict=True))
        readings[rows, columns] = powers
    return np.array([scan.t for scan in scans], float), readings


def surveyed_path_loss(site: Site, survey: Survey, floor: str) -> PathLoss:
    """Return the log-distance model that fits the survey best: P₀ and n per access point by least squares.

    Only access points of this floor are in it, since a ceiling is no distance, and of them only those heard at three
    places or more: two fit any line. [ravel-thesis §3.3, §10]

    Raises:
        ValueError: no access point of the floor was heard often enough.
    """
    placed = {point.id: point for point in site.access_points if point.floor == floor}
    known = [(name, column) for column, name in enumerate(survey.access_points) if name in placed]
    geometry = PathLoss.of([placed[name] for name, _ in known])
    distance = geometry.log_distance(survey.position)
    kept, power, exponent = [], [], []
    for place, (_, column) in enumerate(known):
        at, sample = np.nonzero(np.isfinite(survey.readings[:, :, column]))
        if len(np.unique(at)) < 3:
            continue
        level, reading = distance[at, place], survey.readings[at, sample, column]
        spread = level - level.mean()
        slope = -float(spread @ reading) / max(float(spread @ spread), 1e-9)
        # A field of shadows may tilt the line as no building does: it is kept within what physics allows.
        slope = float(np.clip(slope, *EXPONENTS))
        kept.append(place)
        exponent.append(slope)
        power.append(float(reading.mean() + slope * level.mean()))
    if not kept:
        raise ValueError(f"survey: no access point of floor {floor!r} was heard at three places or more")
    return PathLoss(
        names=tuple(known[place][0] for place in kept),
        positions=geometry.positions[kept],
        power_1m=np.array(power),
        exponent=np.array(exponent),
    )
