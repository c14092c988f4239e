"""Which part of the magnetic field turns with the phone? Its own iron's, which the compass must not follow.

The field in the phone is ``m = Rᵀ E + b``: the Earth's and the building's E stands still while the phone turns by R,
and the iron's b does not. With R from the gyroscope, least squares tell the two apart as soon as somebody turns a
corner. On the traces of ``indoor-location`` b is 12 µT, the same in every trace that turns, and without it nine in
ten headings are right within 21° instead of 17° (``atrium bench dead-reckoning``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.complementary import trusted_field, turned_since
from services.gateway.reckoning.hops import Array, Hops, State

__all__ = ["HardIron"]


class HardIron:
    """Follows b of each phone, and forgets.

    Args:
        forgets: s; the gyroscope's R drifts, buildings differ from place to place and phones are put into cases.
        doubt: s of evidence that the belief in ``b = 0`` is worth.
        settles: s, with which the field without b draws R back, lest the gyroscope's own bias turns it away.
    """

    STATE = np.dtype(
        [
            ("frame", np.float64, (3, 3)),
            ("seconds", np.float64),
            ("turned", np.float64, (3, 3)),
            ("field", np.float64, (3,)),
            ("still", np.float64, (3,)),
            ("before", np.float64, (3,)),
        ]
    )
    """Rows of R at the end of the last hop, the decaying sums of 1, R, m and R m, and b as it was before a hole."""
    SIGMA = 6.0
    """µT, of each component of what a phone's own calibration leaves."""
    WEAKEST = 10.0
    """µT; a weaker horizontal field is taken for this strong."""
    GRAVITY_SHARE = 0.3
    """Of a hop's mean acceleration in the upward row of R."""

    DOUBT = 3.0
    """s; see above."""

    def __init__(self, forgets: float = 120.0, doubt: float = DOUBT, settles: float = 40.0) -> None:
        self._keep = float(np.exp(-1.0 / forgets))
        self._doubt = doubt
        self._settles = settles

    def advance(self, state: State, hops: Hops, rate: Array) -> Hops:
        """Take one hop of each of p phones, change ``state`` (p,) in place and return the hops with b taken away.

        Args:
            state: (p,) of ``STATE``; kept where a hop is fresh, since the iron belongs to the phone.
            hops: the samples.
            rate: (p, HOP, 3) rad/s, bias removed.
        """
        self._begin_anew(state, hops.fresh)
        turned = turned_since(rate)
        use = hops.measured() & trusted_field(hops.field)
        field = np.where(use[..., None], hops.field, 0.0)
        frame = self._levelled(state["frame"], np.einsum("pnij,pnj->pi", turned, hops.acceleration))
        share = 1.0 / use.shape[1]
        fade = np.where(use.any(axis=1), self._keep, 1.0)
        state["seconds"] = fade * state["seconds"] + share * use.sum(axis=1)
        state["turned"] = fade[:, None, None] * state["turned"] + share * frame @ np.einsum("pn,pnij->pij", use, turned)
        state["field"] = fade[:, None] * state["field"] + share * field.sum(axis=1)
        still = np.einsum("pnij,pnj->pi", turned, field)
        state["still"] = fade[:, None] * state["still"] + share * np.einsum("pij,pj->pi", frame, still)
        state["frame"] = frame @ turned[:, -1]
        iron = self.iron(state)
        self._settle(state, hops.field[:, -1] - iron, iron, use[:, -1])
        return replace(hops, field=hops.field - iron[:, None])

    def iron(self, state: State) -> Array:
        """Return b of each of p phones, (p, 3) µT in the phone's axes; zeros where nothing is known."""
        # seconds E + turned b = still and turnedᵀ E + (seconds + doubt) b = field + doubt b_before; E is eliminated.
        still = np.einsum("pji,pj->pi", state["turned"], state["still"]) / self._seconds(state)[:, None]
        right = state["field"] + self._doubt * state["before"] - still
        solved: Array = np.linalg.solve(self._evidence(state), right[..., None])[..., 0]
        return solved

    def heading_variance(self, state: State) -> Array:
        """Return how far compass headings of p phones may be turned by what is not known of b, (p,) rad²."""
        iron = self.iron(state)
        earth = self._earth(state, iron)
        strength = np.maximum(np.hypot(earth[:, 0], earth[:, 1]), self.WEAKEST)
        # Only what lies across the horizontal field turns the compass.
        across = np.stack([-earth[:, 1], earth[:, 0], np.zeros(len(earth))], axis=1)
        across = np.einsum("pji,pj->pi", state["frame"], _unit(across))
        unknown = np.linalg.solve(self._evidence(state), across[..., None])[..., 0]
        variance: Array = self.SIGMA**2 * self._doubt * np.sum(across * unknown, axis=1) / strength**2
        return variance

    def _earth(self, state: State, iron: Array) -> Array:
        """Return E of each of p phones, (p, 3) µT in the axes of R."""
        earth: Array = state["still"] - np.einsum("pij,pj->pi", state["turned"], iron)
        return earth / self._seconds(state)[:, None]

    def _settle(self, state: State, field: Array, iron: Array, known: NDArray[np.bool_]) -> None:
        """Turn R about the vertical towards where ``field`` (p, 3), without iron, would be E."""
        now = np.einsum("pij,pj->pi", state["frame"], np.where(known[:, None], field, 0.0))
        east, north, _ = self._earth(state, iron).T
        off = np.arctan2(now[:, 1] * east - now[:, 0] * north, now[:, 0] * east + now[:, 1] * north)
        cos, sin = np.cos(off / self._settles)[:, None], np.sin(off / self._settles)[:, None]
        x, y = state["frame"][:, 0], state["frame"][:, 1]
        state["frame"][:, 0], state["frame"][:, 1] = cos * x + sin * y, cos * y - sin * x

    def _evidence(self, state: State) -> Array:
        """Return how much is known of b, (p, 3, 3) s; ``doubt`` times the identity where nothing is."""
        turned = state["turned"]
        of_earth = np.swapaxes(turned, 1, 2) @ turned / self._seconds(state)[:, None, None]
        evidence: Array = (state["seconds"][:, None, None] + self._doubt) * np.eye(3) - of_earth
        return evidence

    @staticmethod
    def _seconds(state: State) -> Array:
        seconds: Array = np.maximum(state["seconds"], 1e-6)
        return seconds

    def _begin_anew(self, state: State, fresh: NDArray[np.bool_]) -> None:
        """Forget where the phone was turned to, not its iron."""
        if fresh.any():
            iron = self.iron(state[fresh])
            anew = np.zeros(int(fresh.sum()), self.STATE)
            anew["before"] = iron
            state[fresh] = anew

    def _levelled(self, frame: Array, upward: Array) -> Array:
        """Return ``frame`` (p, 3, 3) with its third row drawn towards ``upward`` (p, 3), orthonormal."""
        known = np.any(frame[:, 2], axis=1, keepdims=True)
        measured = _unit(upward)
        up = _unit(np.where(known, (1.0 - self.GRAVITY_SHARE) * frame[:, 2] + self.GRAVITY_SHARE * measured, measured))
        lying = np.abs(up[:, :1]) < 0.9
        ahead = np.where(known, frame[:, 0], np.where(lying, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
        level = _unit(ahead - np.sum(ahead * up, axis=1, keepdims=True) * up)
        return np.stack([level, np.cross(up, level), up], axis=1)


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit
