"""What a camera measured of people's sizes, in words. The options are those of the camera's foreground detector."""

from __future__ import annotations

import math
from collections.abc import Mapping

__all__ = ["differ", "size_words"]

LEAST = 0.01
"""Share by which sizes must differ from those in use to be worth a trial."""
EDGES = (("left", -1.0, 0.0), ("right", 1.0, 0.0), ("upper", 0.0, -1.0), ("lower", 0.0, 1.0))


def differ(sizes: Mapping[str, float], active: Mapping[str, float]) -> bool:
    """Return whether some sizes differ from those in use by enough to be tried."""
    return any(abs(value - active[name]) > LEAST for name, value in sizes.items())


def size_words(sizes: Mapping[str, float]) -> str:
    """Return how people look, for operators, such as "people look 6 % smaller than the camera is configured for"."""
    middle = math.log(sizes.get("height_scale", 1.0))
    right, down = sizes.get("height_scale_right", 0.0), sizes.get("height_scale_down", 0.0)
    wide = math.log(sizes.get("width_scale", 1.0))
    words = f"{_compared(middle, 'taller', 'smaller')} than" if abs(middle) >= LEAST else "as tall as"
    words = f"people look {words} the camera is configured for"
    at = {name: middle + across * right + along * down for name, across, along in EDGES}
    most = max(at, key=lambda name: abs(at[name]))
    if abs(at[most] - middle) >= 2.0 * LEAST:
        words += f", most so at the {most} edge of its picture ({_compared(at[most], 'taller', 'smaller')})"
    return words + (f", and {_compared(wide, 'wider', 'narrower')}" if abs(wide) >= LEAST else "")


def _compared(logarithm: float, more: str, less: str) -> str:
    share = round(100.0 * (math.exp(logarithm) - 1.0))
    return f"{abs(share)} % {more if share > 0 else less}"
