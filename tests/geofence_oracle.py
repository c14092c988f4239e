"""Who enters, leaves and crosses, said slowly: one track and one border at a time, plain numbers, shapely's distances.

It knows no grid, no slots and no arrays; what is fast is held to it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import shapely
from scipy.special import ndtri

Point = tuple[float, float]


def depth_of(course: Sequence[Point], line: bool, at: Point) -> float:
    """Return the signed distance: inside, or left of the nearest piece of a straight line, is positive."""
    point = shapely.Point(at)
    if not line:
        polygon = shapely.Polygon(course)
        return polygon.exterior.distance(point) * (1.0 if polygon.intersects(point) else -1.0)
    (x0, y0), (x1, y1) = course
    left = (x1 - x0) * (at[1] - y0) - (y1 - y0) * (at[0] - x0)
    return math.copysign(shapely.LineString(course).distance(point), left)


def log_odds(z: float) -> float:
    z = max(-5.0, min(5.0, z))
    return max(-4.0, min(4.0, z * (1.5976 + 0.07056 * z * z))) / 4.0


def gather(evidence: float, z: float, seconds: float, least: float) -> float:
    if z >= 5.0:
        return 1.0
    return max(0.0, evidence + min(log_odds(z) * seconds / least, 0.5))


class SlowArea:
    """One track and one area, without passes through it: those are geometry's business."""

    def __init__(self, course: Sequence[Point], margin: float, least: float, confidence: float) -> None:
        polygon = shapely.Polygon(course)
        self.course, self.least, self.demand = course, least, float(ndtri(confidence))
        self.ring = polygon.exterior
        self.margin = min(margin, 0.5 * polygon.area / polygon.length)
        self.inside, self.evidence = False, 0.0
        self.before: tuple[float, Point] | None = None
        self.since: float | None = None
        """When it was last surely outside; None: it is."""
        self.touched, self.away = False, 0.0

    def step(self, t: float, at: Point, sigma: float) -> str | None:
        depth = depth_of(self.course, False, at)
        before, place = self.before or (t, at)
        self.before = t, at
        seconds, sure = t - before, self.margin + 2.0 * sigma
        if self.since is None and -depth < max(sure, math.dist(place, at)):
            self.since = before
        if self.since is None:
            return None
        if self.inside:
            z, least = (-depth - self.margin) / sigma, 1.5 * self.least
        else:
            z = (depth - 0.1 * self.margin) / sigma - self.demand
            least = self.least * (1.0 + 0.5 * math.log1p(max(t - self.since - 2.0, 0.0) / 2.0))
        self.evidence = gather(self.evidence, z, seconds, least)
        turns = self.evidence >= 1.0
        self._look_outside(t, depth, sigma, seconds, shapely.LineString([place, at]), turns)
        if not turns:
            return None
        self.evidence, self.inside = 0.0, not self.inside
        return "enter" if self.inside else "exit"

    def _look_outside(
        self, t: float, depth: float, sigma: float, seconds: float, way: shapely.LineString, turns: bool
    ) -> None:
        self.touched |= depth >= 0.0 or bool(way.intersects(self.ring))
        out = (-depth - self.margin) / sigma - 1.0
        self.away = gather(self.away, out, seconds, 1.5 * self.least) if self.touched else 0.0
        if self.inside and turns:
            self.since, self.touched, self.away = t, False, 0.0
            return
        surely_out = not self.inside and not turns and depth < -self.margin - 2.0 * sigma
        if surely_out and (not self.touched or self.away >= 1.0):
            self.since, self.evidence, self.touched, self.away = None, 0.0, False, 0.0
