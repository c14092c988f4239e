"""What an area's live radio model expects, and what is heard beyond it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.messages import RadioModelFile
from shared.radio import PathLoss, RadioModel, Visits, unpack_radio_model

__all__ = ["LiveRadio", "heard_beyond", "own_offsets"]

Array = NDArray[np.float64]


class LiveRadio:
    """The live model of an area.

    Args:
        file: the path loss as the site file says; it is live until something better is.
        site: the site's id.

    Attributes:
        model: what was learned; None: it is as the site file says.
    """

    def __init__(self, file: PathLoss, site: str) -> None:
        self._file, self._site = file, site
        self.model: RadioModel | None = None

    @property
    def loss(self) -> PathLoss:
        """The live path loss."""
        return self._file if self.model is None else self.model.path_loss

    def take(self, model: RadioModelFile | None) -> None:
        """Note what is live from now on.

        Raises:
            RadioModelError: it does not fit the site; what was live before still is.
        """
        self.model = None if model is None else unpack_radio_model(model, self._site, self._file.names).over(self._file)

    def expected(self, places: Array) -> Array:
        """Return levels (n, m) at (n, 2) places, dBm; −inf of access points that it does not place."""
        level = self.loss.rssi(places)
        if self.model is not None:
            level = level + self.model.shadowing.at(places)[0]
        level[:, ~self.loss.placed] = -np.inf
        return level

    def of_placed(self, visits: Visits) -> Visits:
        """Return the visits to which it says anything: of the access points that it places."""
        return visits.where(self.loss.placed[visits.point])

    def beyond(self, visits: Visits, offset: Array) -> Array:
        """Return heard − expected − what a phone reads too much, (n,) dB; visits are of access points it places."""
        return _beyond(visits, self.expected(visits.place), offset)


def heard_beyond(model: RadioModel, visits: Visits, offset: Array) -> Array:
    """Return heard − foretold by a model − what a phone reads too much, (n,) dB."""
    return _beyond(visits, model.path_loss.rssi(visits.place) + model.shadowing.at(visits.place)[0], offset)


def own_offsets(visits: Visits, error: Array) -> Array:
    """Return the errors (n,) with what each phone reads too much lately taken off: the median over access points."""
    error = error.copy()
    for device in np.unique(visits.device).tolist():
        mine = np.flatnonzero(visits.device == device)
        medians = [np.median(error[mine[visits.point[mine] == point]]) for point in np.unique(visits.point[mine])]
        error[mine] -= np.median(medians)
    return error


def _beyond(visits: Visits, expected: Array, offset: Array) -> Array:
    """A phone that came since offsets were learned has none yet."""
    known = np.append(offset, np.zeros(max(0, int(visits.device.max(initial=-1)) + 1 - len(offset))))
    error: Array = visits.level - expected[np.arange(len(visits)), visits.point] - known[visits.device]
    return error
