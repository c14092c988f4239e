"""Which way on the plan is a compass heading? The one place where the two meet."""

from __future__ import annotations

from services.gateway.reckoning.hops import Array
from shared.angles import wrap

__all__ = ["plan_heading"]


def plan_heading(compass_heading: Array, north: float) -> Array:
    """Return headings counter-clockwise from the plan's +x axis, in (-π, π].

    A compass counts clockwise from **magnetic** north; the thesis' yaw counts counter-clockwise from it, and its
    Eq. 3.28 takes that for an angle from east [self-calibrating-rss-thesis §3.7, the heading trap]. Plans count
    counter-clockwise from +x. ``north`` turns one into the other, and the site's magnetic declination is part of it:
    where a compass points 3° east of true north, a plan with true north along +y has ``north`` = 87°.

    Args:
        compass_heading: radians clockwise from magnetic north: north 0, east π/2.
        north: direction of magnetic north on the plan, radians counter-clockwise from +x (``Site.north_radians``).
    """
    return wrap(north - compass_heading)
