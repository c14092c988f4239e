"""How many people are in each zone, minute by minute: counted by the geofence on fusion's tracks, beside the truth."""

from __future__ import annotations

import zoneinfo
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.fusion_run import run_fusion
from benchmarks.world_run import load, record_world
from services.geofence.service import sighting_of
from services.geofence.settings import GeofenceSettings
from services.geofence.watch import Watch
from services.geofence.zone_plan import ZonePlan, of_site

__all__ = ["minute_counts", "occupancy_error"]

Array = NDArray[np.float64]

MINUTE = 60.0


def minute_counts(
    scenario: str, seed: int, seconds: float | None = None, progress: Callable[[float], None] = lambda t: None
) -> tuple[Array, Array]:
    """Return the people in each zone, (minutes, zones) each: counted, and really there; means over whole minutes."""
    world, site = load(scenario)
    record = record_world(world, site, seed, seconds=seconds, progress=progress)[site.areas[0].id]
    frames = run_fusion(record).frames
    defaults = {name: field.default for name, field in GeofenceSettings.model_fields.items()}
    plan = ZonePlan.of(of_site(site.zones), site, defaults["geofence_margin"], defaults["geofence_min_seconds"])
    watch = Watch(plan, [record.area], zoneinfo.ZoneInfo(site.time_zone), defaults["geofence_grace"])
    floor = site.area(record.area).floor
    zones = [zone for zone in site.zones if zone.floor == floor]
    counted = []
    for frame in frames:
        watch.step(record.area, sighting_of(frame, plan))
        now = watch.counts()
        counted.append([now[zone.id][0] for zone in zones])
    truth = record.truth
    x, y = truth.position[..., 0], truth.position[..., 1]
    really = np.stack([shapely.contains_xy(shapely.Polygon(zone.polygon), x, y).sum(axis=1) for zone in zones], axis=1)
    start = truth.t[0]
    told = np.array([frame.t for frame in frames])
    minutes = int((min(told[-1], truth.t[-1]) - start) // MINUTE)
    means = [
        _means(when - start, np.array(values, float), minutes) for when, values in ((told, counted), (truth.t, really))
    ]
    return means[0], means[1]


def occupancy_error(counted: Array, really: Array) -> dict[str, float]:
    """Return by how much (minutes, zones) counts are wrong, as shares of the people really there.

    ``occupancy_error``: the mean over minutes of all zones' errors of the minute by all people in zones in it.
    """
    some = really.sum(axis=1) > 0.0
    error = np.abs(counted - really)[some].sum(axis=1) / really[some].sum(axis=1)
    return {
        "occupancy_error": float(error.mean()),
        "occupancy_error_p90": float(np.percentile(error, 90)),
        "occupancy_bias": float(counted.sum() / really.sum() - 1.0),
    }


def _means(t: Array, values: Array, minutes: int) -> Array:
    minute = np.floor(t / MINUTE).astype(int)
    return np.array([values[minute == number].mean(axis=0) for number in range(minutes)])
