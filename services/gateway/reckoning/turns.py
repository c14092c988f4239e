"""When did the phone's carrier turn a corner, and by how much? [self-calibrating-rss-thesis §3.5, §5.4].

From the phone's yaw and not from the walking direction: the sign of the phone's offset may be wrong, its turning not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State

__all__ = ["TurnDetection", "Turns"]


@dataclass(frozen=True, slots=True)
class Turns:
    """Turns that m phones have completed.

    Attributes:
        phone: (m,) row of the phone, ascending.
        t: (m,) when half of the turn was done, phone clock, s.
        angle: (m,) rad, left is positive.
    """

    phone: NDArray[np.int64]
    t: Array
    angle: Array


class TurnDetection:
    """A turn is told when the direction is settled again and differs by more than 30° from where it had settled before.

    Directions are means of a second each, so that the sway of steps cancels; one is settled that differs by less than
    10° from the second before. A settled direction is followed slowly, so that a drifting gyroscope makes no turn. Who
    turns while standing has turned, but no corner.
    """

    STATE = np.dtype(
        [
            ("seconds", np.int64),
            ("attitude", np.float64, (3, 3)),
            ("yaw", np.float64),
            ("means", np.float64, (8,)),
            ("settled", np.float64),
        ]
    )
    """``means``: yaw in the last seconds, newest last; ``settled``: where it was when it last did not change."""
    LEAST = np.radians(30.0)
    SETTLED = np.radians(10.0)
    FOLLOW = 0.3

    def advance(self, state: State, hops: Hops, attitude: Array, walking: NDArray[np.bool_]) -> Turns:
        """Take one hop of each of p phones, change ``state`` (p,) in place and return the turns completed in it.

        Args:
            state: (p,) of ``STATE``.
            hops: the samples.
            attitude: (p, HOP, 3, 3) rotations from the phone's axes to (east, north, up).
            walking: (p,) whose turns count.
        """
        begun = state["seconds"] > 0
        before = np.concatenate([state["attitude"][:, None], attitude[:, :-1]], axis=1)
        before[~begun, 0] = attitude[~begun, 0]
        yaw = state["yaw"][:, None] + np.cumsum(_turned_left(before, attitude), axis=1)
        mean = yaw.mean(axis=1)
        means = state["means"]
        means[:, :-1] = np.where(begun[:, None], means[:, 1:], mean[:, None])
        means[:, -1] = mean
        state["settled"] = np.where(begun, state["settled"], mean)
        state["attitude"], state["yaw"] = attitude[:, -1], yaw[:, -1]
        state["seconds"] += 1

        calm = np.abs(mean - means[:, -2]) < self.SETTLED
        turned = mean - state["settled"]
        whole = 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
        corner = calm & (np.abs(turned - whole) > self.LEAST)
        phone = np.flatnonzero(corner & walking)
        t = np.array([hops.t[row] + _half_done(means[row], state["settled"][row]) for row in phone])
        follow = np.where(corner, turned, whole + self.FOLLOW * (turned - whole))
        state["settled"] += np.where(calm, follow, 0.0)
        return Turns(phone, t, (turned - whole)[phone])


def _turned_left(before: Array, after: Array) -> Array:
    """Return by how much phones turned about the vertical from one attitude (..., 3, 3) to the next, rad."""
    (east, north), (east_after, north_after) = (np.moveaxis(matrix[..., :2, :], -2, 0) for matrix in (before, after))
    sine = np.sum(north_after * east - east_after * north, axis=-1)
    cosine = np.sum(east_after * east + north_after * north, axis=-1)
    turned: Array = np.arctan2(sine, cosine)
    return turned


def _half_done(means: Array, settled: float) -> float:
    """Return when yaw last crossed the middle between ``settled`` and the newest mean, s from where the hop begins."""
    middle = 0.5 * (means[-1] + settled)
    side = (means > middle) == (means[-1] > middle)
    others = np.flatnonzero(~side)
    low = int(others[-1]) if len(others) else 0
    share = (middle - means[low]) / (means[low + 1] - means[low]) if len(others) else 0.0
    return float(low + share - (len(means) - 1) + 0.5 * HOP / RATE)
