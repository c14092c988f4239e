"""How are angles brought to one turn?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["wrap"]


def wrap(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles (...) rad in (-π, π]."""
    return -((-angle + np.pi) % (2.0 * np.pi) - np.pi)
