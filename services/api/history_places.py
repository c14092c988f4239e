"""From where is an exhibit looked at? The floor before it, as a polygon that stays can be counted in."""

from __future__ import annotations

import math

__all__ = ["surroundings"]

FRONT = 120.0
"""Degrees of the sector from which something that has a back is looked at."""
CORNERS = 24
"""Of a whole circle."""


def surroundings(x: float, y: float, reach: float, facing: float | None) -> list[tuple[float, float]]:
    """Return the corners of the floor within ``reach`` metres of (x, y).

    Args:
        x: m; ``y`` likewise.
        reach: m.
        facing: where its front looks, degrees counter-clockwise from +x; None: it is looked at from all around.
    """
    if facing is None:
        angles = [2.0 * math.pi * step / CORNERS for step in range(CORNERS)]
        return [(x + reach * math.cos(angle), y + reach * math.sin(angle)) for angle in angles]
    steps = round(CORNERS * FRONT / 360.0)
    angles = [math.radians(facing + FRONT * (step / steps - 0.5)) for step in range(steps + 1)]
    return [(x, y), *((x + reach * math.cos(angle), y + reach * math.sin(angle)) for angle in angles)]
