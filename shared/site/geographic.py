"""Where on Earth is a place of the plan, and the other way round? The plan is the plane that touches the ellipsoid.

WGS 84; the anchor is the plan's zero, and ``north`` turns the plan. Exact to the millimetre within ten kilometres.
Source: the usual local east-north-up frame (Farrell, Aided Navigation, §2.4); latitude by Bowring's formula (1976).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.site.site_file import Site

__all__ = ["REACH", "PlanOnEarth"]

Floats = NDArray[np.float64]

A = 6378137.0
F = 1.0 / 298.257223563
B = A * (1.0 - F)
E2 = F * (2.0 - F)
REACH = 10_000.0
"""Metres from the anchor within which a plan may lie."""


@dataclass(frozen=True)
class PlanOnEarth:
    """The tangent plane of one site.

    Attributes:
        latitude: of the plan's zero, degrees.
        longitude: of the plan's zero, degrees.
        north: direction of north on the plan, radians counter-clockwise from +x.
    """

    latitude: float
    longitude: float
    north: float

    @classmethod
    def of(cls, site: Site) -> PlanOnEarth | None:
        """Return where the site lies, None where its file does not say."""
        if site.anchor is None:
            return None
        return cls(site.anchor.latitude, site.anchor.longitude, site.north_radians)

    def to_wgs84(self, points: Floats) -> Floats:
        """Return (n, 2) longitude and latitude in degrees of (n, 2) metres on the plan."""
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        sin, cos = np.sin(self.north), np.cos(self.north)
        local = np.column_stack([x * sin - y * cos, x * cos + y * sin, np.zeros(len(x))])
        earth = self._origin() + local @ self._axes()
        across = np.hypot(earth[:, 0], earth[:, 1])
        theta = np.arctan2(earth[:, 2] * A, across * B)
        latitude = np.arctan2(
            earth[:, 2] + (E2 / (1.0 - E2)) * B * np.sin(theta) ** 3, across - E2 * A * np.cos(theta) ** 3
        )
        longitude = np.arctan2(earth[:, 1], earth[:, 0])
        places: Floats = np.degrees(np.column_stack([longitude, latitude]))
        return places

    def to_plan(self, places: Floats) -> Floats:
        """Return (n, 2) metres on the plan of (n, 2) longitude and latitude in degrees.

        Raises:
            ValueError: a place is farther away than ``REACH``.
        """
        places = np.asarray(places, dtype=float).reshape(-1, 2)
        longitude, latitude = np.radians(places).T
        upright = _upright(longitude, latitude)
        ground = _on_ellipsoid(longitude, latitude)
        axes = self._axes()
        local = (ground - self._origin()) @ axes.T
        # Along its own vertical each place reaches the plane exactly: height is linear in the way along it.
        slope = upright @ axes[2]
        if not np.all(np.isfinite(local)) or not np.all(slope > 0.0):
            raise ValueError(f"a place is more than {REACH / 1000:g} km from the site's anchor")
        local += (upright @ axes.T) * (-local[:, 2] / slope)[:, None]
        if np.any(np.hypot(local[:, 0], local[:, 1]) > REACH):
            raise ValueError(f"a place is more than {REACH / 1000:g} km from the site's anchor")
        sin, cos = np.sin(self.north), np.cos(self.north)
        east, north = local[:, 0], local[:, 1]
        return np.column_stack([east * sin + north * cos, north * sin - east * cos])

    def _origin(self) -> Floats:
        origin: Floats = _on_ellipsoid(np.radians([self.longitude]), np.radians([self.latitude]))[0]
        return origin

    def _axes(self) -> Floats:
        """Rows: east, north and up at the anchor, in the Earth's frame."""
        longitude, latitude = np.radians(self.longitude), np.radians(self.latitude)
        east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
        up = _upright(np.array([longitude]), np.array([latitude]))[0]
        return np.array([east, np.cross(up, east), up])


def _upright(longitude: Floats, latitude: Floats) -> Floats:
    return np.column_stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    )


def _on_ellipsoid(longitude: Floats, latitude: Floats) -> Floats:
    curvature = A / np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
    return _upright(longitude, latitude) * np.column_stack([curvature, curvature, curvature * (1.0 - E2)])
