"""Which access point is which column, after the site file was edited: by name, never by place in the list."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["columns_today"]


def columns_today(saved: Sequence[str], today: Sequence[str]) -> NDArray[np.int64]:
    """Return (k,) of which column today each of k saved columns is; −1: of an access point that is no more.

    Args:
        saved: names of the access points when it was saved, in the order of the columns.
        today: the same now.

    Raises:
        ValueError: ``saved`` is no list of names, or one is named twice.
    """
    if isinstance(saved, str) or not all(isinstance(name, str) for name in saved) or len(set(saved)) != len(saved):
        raise ValueError(f"access_points: found {saved!r}; allowed: a list of names, each once")
    column = {name: number for number, name in enumerate(today)}
    return np.array([column.get(name, -1) for name in saved], np.int64)
