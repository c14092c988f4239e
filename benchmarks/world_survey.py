"""What would a surveyor have heard here on another day? Training data for baselines that need a survey."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.baselines.survey import Survey
from services.simulator.radio.radio_world import RadioWorld
from services.simulator.scenario_file import Scenario
from shared.site import Site

__all__ = ["survey_world"]

Array = NDArray[np.float64]

ANOTHER_DAY = 100_000.0
"""Seconds: what drifts has long forgotten how it was."""
HEADINGS = 4


def survey_world(
    scenario: Scenario,
    site: Site,
    area: str,
    seed: int,
    *,
    within: Array | None = None,
    spacing: float = 1.0,
    samples: int = 20,
    every: float = 0.5,
) -> Survey:
    """Return a survey of the same radio world before anything of the run changed it.

    A surveyor with a phone of their own stands at each point of a grid over the area's floor, a fourth of the samples
    facing each of four ways [self-calibrating-rss-thesis §4.1].

    Args:
        scenario: whose radio; its mid-run changes have not happened yet.
        site: where.
        area: whose floor.
        seed: of the world.
        within: corners (c, 2) of what is surveyed, half a metre more on each side; None: the whole floor.
        spacing: metres between points.
        samples: scans at each point.
        every: seconds between scans.
    """
    radio = RadioWorld(site, seed, scenario.radio.model_copy(update={"changes": []}))
    floor = site.floor(site.area(area).floor)
    plan = floor.plan()
    west, south, east, north = plan.outline.bounds
    x, y = np.meshgrid(np.arange(west + 0.5 * spacing, east, spacing), np.arange(south + 0.5 * spacing, north, spacing))
    points = np.column_stack([x.ravel(), y.ravel()])
    wanted = plan.outline if within is None else shapely.Polygon(within).buffer(0.5)
    points = points[plan.walkable(points) & shapely.contains_xy(wanted, points[:, 0], points[:, 1])]
    count = len(points) * samples
    facing = 2.0 * math.pi / HEADINGS * np.floor(HEADINGS * (np.arange(count) % samples) / samples)
    readings = radio.phone("surveyor").scan(
        ANOTHER_DAY + every * np.arange(count), np.repeat(points, samples, axis=0), floor.id, facing
    )
    return Survey(radio.access_points, points, readings.reshape(len(points), samples, -1))
