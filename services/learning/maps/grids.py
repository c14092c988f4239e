"""Maps as they travel: grids of rounded numbers, None where nothing is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.learning_command import MapKind
from shared.learning_report import MapGrid
from shared.radio.radio_model import RadioModel

__all__ = ["grid_of", "radio_grid", "shadowing_grid"]

Array = NDArray[np.float64]

HEARD = -100.0
"""dBm; where less is expected, hardly a phone hears anything."""
TOLD = 0.5
"""Share of the largest variance of a shadowing map above which a cell is told as unknown: nobody has read it."""


def grid_of(
    area: str, kind: MapKind, unit: str, origin: Array, cell: float, values: Array, subject: str = ""
) -> MapGrid:
    """Return (rows, columns) ``values`` as a grid; NaN is not known. ``origin``: (2,) centre of the first cell."""
    rounded = np.round(values, 2).tolist()
    rows = [[None if value != value else value for value in row] for row in rounded]
    return MapGrid(
        area=area,
        kind=kind,
        subject=subject,
        unit=unit,
        origin=(float(origin[0]), float(origin[1])),
        cell=cell,
        rows=rows,
    )


def radio_grid(area: str, model: RadioModel, access_point: str, centres: Array, indoors: NDArray[np.bool_]) -> MapGrid:
    """Return what a phone is expected to hear of one access point, path loss and shadowing, dBm.

    Args:
        area: whose map it is.
        model: that holds the access point.
        access_point: its id.
        centres: (rows, columns, 2) metres.
        indoors: (rows, columns) where people can be; elsewhere nothing is told.
    """
    point = model.path_loss.names.index(access_point)
    places = centres.reshape(-1, 2)
    level = (
        model.path_loss.power_1m[point]
        - model.path_loss.exponent[point] * (model.path_loss.log_distance(places)[:, point])
    )
    level = (level + model.shadowing.at(places)[0][:, point]).reshape(indoors.shape)
    level = np.where(indoors & (level >= HEARD), level, np.nan)
    cell = float(centres[0, 1, 0] - centres[0, 0, 0]) if centres.shape[1] > 1 else 1.0
    return grid_of(area, "radio", "dBm", centres[0, 0], cell, level, access_point)


def shadowing_grid(area: str, model: RadioModel, access_point: str) -> MapGrid:
    """Return what the path loss of one access point gets wrong by place, dB; None where hardly anything was heard."""
    shadowing = model.shadowing
    point = shadowing.names.index(access_point)
    variance = shadowing.variance[point]
    known = variance < TOLD * variance.max()
    values = np.where(known, shadowing.mean[point], np.nan)
    return grid_of(area, "shadowing", "dB", shadowing.origin, shadowing.cell, values, access_point)
