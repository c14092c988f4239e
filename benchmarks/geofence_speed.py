"""How many positions a second does the geofence test against 100 zones, beside methods without a memory?"""

from __future__ import annotations

import time

import numpy as np
import shapely
from numpy.typing import NDArray

from services.geofence.borders import Borders
from services.geofence.crossings import Crossings
from services.geofence.evidence import SURE
from services.geofence.settings import GeofenceSettings
from services.geofence.zone_index import ZoneIndex
from services.geofence.zone_plan import MOST_SPREAD

__all__ = ["speeds"]

Array = NDArray[np.float64]

HALL = np.array([100.0, 60.0])
ZONES, LINES = 100, 10
PEOPLE = 10_000
FRAMES, WARM_UP = 40, 10
RATE = 15.0
SIGMA, CORRELATED = 0.3, 0.5
"""Metres and seconds: errors of a tracker's positions last."""


def speeds(seed: int, people: int = PEOPLE) -> dict[str, float]:
    """Return positions per second: ours with state and steps, and shapely's without, one polygon after the other and
    by its tree.
    """
    random = np.random.default_rng(seed)
    rings, lines = _zones(random)
    frames = _frames(random, people)
    defaults = {name: field.default for name, field in GeofenceSettings.model_fields.items()}
    reach = defaults["geofence_margin"] + SURE * MOST_SPREAD
    index = ZoneIndex(rings + lines, ["floor"] * ZONES, reach, [False] * len(rings) + [True] * len(lines))
    crossings = Crossings(Borders(index, defaults["geofence_margin"], defaults["geofence_min_seconds"]), 2.0)
    track, floor = np.arange(people), np.zeros(people, np.int64)
    covariance = np.tile([SIGMA**2, 0.0, SIGMA**2], (people, 1))
    shapes = np.array([shapely.Polygon(ring) for ring in rings] + [shapely.LineString(line) for line in lines], object)
    shapely.prepare(shapes)
    tree = shapely.STRtree(shapes)
    seconds: dict[str, list[float]] = {"": [], "naive_": [], "strtree_": []}
    for number, place in enumerate(frames):
        x, y = place[:, 0].copy(), place[:, 1].copy()
        began = time.perf_counter()
        crossings.step(number / RATE, track, floor, x, y, covariance=covariance)
        ours = time.perf_counter()
        for shape in shapes.tolist():
            shapely.contains_xy(shape, x, y)
        singly = time.perf_counter()
        tree.query(shapely.points(x, y), predicate="intersects")
        done = time.perf_counter()
        if number >= WARM_UP:
            for name, passed in (("", ours - began), ("naive_", singly - ours), ("strtree_", done - singly)):
                seconds[name].append(passed)
    return {f"{name}positions_per_s": people / float(np.median(passed)) for name, passed in seconds.items()}


def _zones(random: np.random.Generator) -> tuple[list[list[tuple[float, float]]], list[list[tuple[float, float]]]]:
    rings, lines = [], []
    for _ in range(ZONES - LINES):
        middle = random.uniform(3.0, HALL - 3.0)
        round_it = np.sort(random.uniform(0.0, 2.0 * np.pi, 8))
        corners = middle + 2.5 * np.column_stack([np.cos(round_it), np.sin(round_it)])
        rings.append([(float(x), float(y)) for x, y in corners])
    for _ in range(LINES):
        middle, angle = random.uniform(3.0, HALL - 3.0), random.uniform(0.0, np.pi)
        half = 2.5 * np.array([np.cos(angle), np.sin(angle)])
        lines.append([(float(x), float(y)) for x, y in (middle - half, middle + half)])
    return rings, lines


def _frames(random: np.random.Generator, people: int) -> list[Array]:
    """Return positions of people who walk straight on and turn at walls."""
    place = random.uniform(0.0, 1.0, (people, 2)) * HALL
    velocity = random.normal(0.0, 0.8, (people, 2))
    error = random.normal(0.0, SIGMA, (people, 2))
    keep = float(np.exp(-1.0 / RATE / CORRELATED))
    frames = []
    for _ in range(FRAMES + WARM_UP):
        place = place + velocity / RATE
        velocity = np.where((place < 0.0) | (place > HALL), -velocity, velocity)
        error = keep * error + np.sqrt(1.0 - keep**2) * random.normal(0.0, SIGMA, (people, 2))
        frames.append(place + error)
    return frames
