"""Where do access points hang whose place the site file does not say? Looked for as what is heard of them grows.

Until then they are heard and kept, and taught nothing about. A place found from few readings is looked for anew when
there are a quarter more: what most readings say is believed, not what the first few said by chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.learning.radio.evidence import RadioEvidence
from shared.radio import PathLoss, RadioFit, RadioPrior, Visits, Whereabouts, locate_access_point

__all__ = ["HANGS", "NEEDED", "Placing", "visits_at"]

Array = NDArray[np.float64]

NEEDED = 40
"""Visits without which a place is not looked for."""
KNOWN = 3.0
"""Metres to which it must be known to be believed. On training worlds such places were as far off as they claimed; of
those known less well some by 13 m."""
HANGS = 2.5
"""Metres above the floor at which one is believed to hang: phones are all at one height and tell little of it."""
MORE = 1.25
"""Times the visits from before the last look that are still kept, until the next."""


class Placing:
    """Of one area's access points that the site file does not place.

    Args:
        file: the path loss as the site file says.
        lower: (2,) corner of where they may hang, metres; ``upper`` the other.
        upper: see above.
        prior: of the radio.

    Attributes:
        unclear: by access point, metres to which its place is known where that is too little.
    """

    def __init__(self, file: PathLoss, lower: Array, upper: Array, prior: RadioPrior) -> None:
        self._file, self._lower, self._upper, self._prior = file, lower, upper, prior
        self._points: list[int] = np.flatnonzero(~file.placed).tolist()
        self._looked: dict[int, float] = {}
        """By access point, the newest visit at the last look, seconds: their number may have become smaller since."""
        self.unclear: dict[int, float] = {}

    def look(self, evidence: RadioEvidence, reference: RadioFit) -> dict[int, Whereabouts]:
        """Return where access points hang of which enough more was heard since the last look, if that is told."""
        found: dict[int, Whereabouts] = {}
        if not self._points:
            return found
        visits, _, kept = evidence.visits(sure=True)
        for point in self._points:
            mine = visits.point == point
            t = visits.t[mine]
            if len(t) < max(NEEDED, MORE * int((t <= self._looked.get(point, -np.inf)).sum())):
                continue
            self._looked[point] = float(t.max())
            level, weight = visits_at(visits.where(mine), kept[mine], reference)
            where = locate_access_point(
                visits.place[mine], level, weight, self._lower, self._upper, height=HANGS,
                power=float(self._file.power_1m[point]), exponent=float(self._file.exponent[point]), prior=self._prior,
            )  # fmt: skip
            if where.error > KNOWN:
                self.unclear[point] = where.error
            else:
                self.unclear.pop(point, None)
                found[point] = where
        return found


def visits_at(visits: Visits, kept: Array, reference: RadioFit) -> tuple[Array, Array]:
    """Return levels (n,) of visits in dBm, phones' offsets taken off as far as they are known, and weights (n,), dB⁻².

    Args:
        visits: n.
        kept: (n,) how much of each counts, 0 to 1.
        reference: says what each phone reads too much, and what a visit's readings have in common.
    """
    offset = np.append(
        reference.offset, np.zeros(max(0, int(visits.device.max(initial=-1)) + 1 - len(reference.offset)))
    )
    weight = kept * visits.weight / (1.0 + max(reference.visit, 2.0) ** 2 * visits.weight)
    return visits.level - offset[visits.device], weight
