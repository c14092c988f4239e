"""What a phone measures that is turned in a known way: the truth of the attitude tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.hops import HOP, RATE, Hops

Array = NDArray[np.float64]

EARTH = np.array([0.0, 20.0, -43.0])
"""East, north, up, µT."""
GRAVITY = np.array([0.0, 0.0, 9.81])


def held(compass: Array, pitch: Array | float = 0.0, roll: Array | float = 0.0) -> Array:
    """Return rotations (n, 3, 3) from the phone to (east, north, up); its top points along ``compass`` (n,), rad."""
    zero = np.zeros(len(compass))
    turned = Rotation.from_euler("ZXY", np.stack([-compass, pitch + zero, roll + zero], axis=1))
    matrices: Array = turned.as_matrix()
    return matrices


def hops_of(attitude: Array, push: Array | None = None, field: Array | None = None) -> list[Hops]:
    """Return hops of one phone: exact sensors that are turned as ``attitude`` (n, 3, 3), n whole hops.

    Args:
        attitude: from the phone to (east, north, up).
        push: (n, 3) m/s² east, north, up, by which it is moved about.
        field: (n, 3) µT east, north, up; NaN where the compass is silent.
    """
    n = len(attitude)
    back = np.swapaxes(attitude, 1, 2)
    acceleration = np.einsum("nij,nj->ni", back, GRAVITY + (np.zeros((n, 3)) if push is None else push))
    magnetic = np.einsum("nij,nj->ni", back, np.broadcast_to(EARTH, (n, 3)) if field is None else field)
    before = np.concatenate([attitude[:1], attitude[:-1]])
    rate = Rotation.from_matrix(np.swapaxes(before, 1, 2) @ attitude).as_rotvec() * RATE
    return [
        Hops(
            t=np.array([1000.0 + begin / RATE]),
            count=np.array([HOP]),
            fresh=np.array([begin == 0]),
            acceleration=acceleration[None, begin : begin + HOP],
            rotation=rate[None, begin : begin + HOP],
            field=magnetic[None, begin : begin + HOP],
        )
        for begin in range(0, n, HOP)
    ]


def side_by_side(phones: list[list[Hops]]) -> list[Hops]:
    """Return the hops of several phones that have equally many as hops of all of them."""
    names = Hops.__dataclass_fields__
    return [
        Hops(*(np.concatenate([getattr(hop, name) for hop in hops]) for name in names))
        for hops in zip(*phones, strict=True)
    ]


def followed(filter_: Attitude, hops: list[Hops]) -> Array:
    """Return what a filter makes of the hops of p phones, (p, n, 3, 3)."""
    state = np.zeros(len(hops[0].t), filter_.STATE)
    return np.concatenate([filter_.advance(state, hop, hop.rotation) for hop in hops], axis=1)


def apart(one: Array, other: Array) -> Array:
    """Return the angles, degrees, between rotations (..., 3, 3)."""
    cosine = 0.5 * (np.einsum("...ij,...ij->...", one, other) - 1.0)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
