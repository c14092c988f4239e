"""How well does a learned radio model foretell readings at true places it never learned from, and how well could it?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from shared.radio import RadioModel, RadioPrior, Visits, fit_radio, gather_visits, novelty

__all__ = ["foretold_rmse", "taught_by_truth", "true_visits"]

Array = NDArray[np.float64]

PASSAGE = 60.0
"""Seconds of a walk that count as one passage."""
SPREAD = 0.1
"""Metres to which true places count as known."""


def true_visits(record: WorldRecord, since: float = -np.inf, until: float = np.inf) -> Visits:
    """Return what carriers in view of the area's cameras heard at their true places, in that time."""
    view = AreaView.of(record.site, record.area)
    column = {name: number for number, name in enumerate(view.radio.names)}
    truth, one = record.truth, 1.0 / RadioPrior().noise(np.array([SPREAD]))[0]
    rows: list[tuple[float, ...]] = []
    for number, person in enumerate(truth.carriers()):
        scans = [scan for scan in record.scans.get(str(truth.device[person]), ()) if since < scan.t <= until]
        at = np.searchsorted(truth.t, [scan.t for scan in scans]).clip(0, len(truth.t) - 1)
        there = truth.in_view[at, person] & np.isfinite(truth.position[at, person, 0])
        places = truth.position[at[there], person].astype(float)
        scans = [scan for scan, kept in zip(scans, there.tolist(), strict=True) if kept]
        for scan, (x, y), share in zip(scans, places.tolist(), novelty(places).tolist(), strict=True):
            for name, level in zip(scan.access_point, scan.rssi, strict=True):
                if name in column:
                    rows.append((scan.t, number, scan.t // PASSAGE, column[name], x, y, level, share * one))
    table = np.array(rows).reshape(-1, 8)
    device, passage, point = (table[:, place].astype(np.int64) for place in (1, 2, 3))
    return gather_visits(table[:, 0], device, passage, point, table[:, 4:6], table[:, 6], table[:, 7])


def taught_by_truth(record: WorldRecord, until: float) -> RadioModel:
    """Return what the same fit learns from true places up to ``until``, seconds since the epoch."""
    view = AreaView.of(record.site, record.area)
    return fit_radio(view.radio, view.lower, view.upper, true_visits(record, until=until), site=record.site.site).model


def foretold_rmse(model: RadioModel, record: WorldRecord, since: float) -> float:
    """Return the RMSE in dB of a model on visits to true places after ``since``, phones' own offsets taken off."""
    visits = true_visits(record, since)
    rows = np.arange(len(visits))
    expected = model.path_loss.rssi(visits.place) + model.shadowing.at(visits.place)[0]
    error = visits.level - expected[rows, visits.point]
    for device in np.unique(visits.device).tolist():
        error[visits.device == device] -= np.median(error[visits.device == device])
    return float(np.sqrt(np.mean(error**2)))
