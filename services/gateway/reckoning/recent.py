"""What did a phone measure in the last seconds? Steps are told late, and their headings need what was measured then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State

__all__ = ["KEPT", "RECENT", "Recent", "remember"]

KEPT = 10 * HOP
"""Samples remembered of each phone: the longest delay of a step, and a stride on either side."""

RECENT = np.dtype(
    [
        ("count", np.int64),
        ("acceleration", np.float32, (KEPT, 3)),
        ("rate", np.float32, (KEPT, 3)),
        ("attitude", np.float32, (KEPT, 3, 3)),
        ("field", np.float32, (KEPT,)),
    ]
)
"""32 kB of one phone."""

Single = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Recent:
    """The last ``KEPT`` samples of each of p phones, newest last.

    Attributes:
        t: (p,) time of the newest sample, s.
        count: (p,) how many of them, counted from the newest, were measured since the phone began anew.
        acceleration: (p, KEPT, 3) m/s², gravity included, phone axes.
        rate: (p, KEPT, 3) rad/s, bias removed, phone axes.
        attitude: (p, KEPT, 3, 3) rotations from the phone's axes to (east, north, up).
        field: (p, KEPT) µT, strength of the magnetic field without the phone's own iron; NaN without a compass.
    """

    t: Array
    count: NDArray[np.int64]
    acceleration: Single
    rate: Single
    attitude: Single
    field: Single

    def index(self, phone: NDArray[np.int64], t: Array) -> NDArray[np.int64]:
        """Return the index of the sample nearest to each of m times ``t`` of the phones ``phone``, kept in bounds."""
        back = np.rint((self.t[phone] - t) * RATE).astype(np.int64)
        return np.clip(KEPT - 1 - back, KEPT - self.count[phone], KEPT - 1)


def remember(state: State, hops: Hops, rate: Array, attitude: Array) -> Recent:
    """Append a hop to ``state`` (p,) of ``RECENT`` and return all that is remembered."""
    strength = np.sqrt(np.einsum("pni,pni->pn", hops.field, hops.field))
    columns = (("acceleration", hops.acceleration), ("rate", rate), ("attitude", attitude), ("field", strength))
    for name, values in columns:
        column = state[name]
        column[:, :-HOP] = column[:, HOP:]
        column[:, -HOP:] = values
        state[name] = column
    state["count"] = np.minimum(state["count"] + HOP, KEPT)
    newest = hops.t + (HOP - 1) / RATE
    return Recent(newest, *(state[name] for name in ("count", "acceleration", "rate", "attitude", "field")))
