"""How strong should each of these readings be, and how sure is that? Path loss and map, of one access point each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.radio.path_loss import PathLoss
from shared.radio.shadowing_map import ShadowingMap

__all__ = ["expected_level"]

Array = NDArray[np.float64]


def expected_level(
    places: Array, access_point: NDArray[np.int64], radio: PathLoss, shadowing: ShadowingMap | None
) -> tuple[Array, Array | None]:
    """Return the levels (…, n), dBm, to be expected of n readings, and their variance (…, n), dB²; None without a map.

    Args:
        places: (…, n, 2) metres, where each was taken, on one path or several.
        access_point: (n,) which access point each is of.
        radio: the model of the access points.
        shadowing: what it leaves out.
    """
    level = radio.rssi_of(places, access_point)
    if shadowing is None:
        return level, None
    mean, variance = shadowing.of(places, access_point)
    return level + mean, variance
