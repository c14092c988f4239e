"""By how much do the cameras' clocks differ? Learned from people whom two cameras see one after the other.

A person who walks with velocity v and is seen by camera a and then by camera b is found displaced by v times the time
between the two pictures. If b's clock is ahead of a's by d, the displacement falls short by v d: the slope of what is
left over v, with a constant for how far the two projections lie apart. Sums per pair of cameras, slowly forgotten.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import unpack

__all__ = ["CameraClocks"]

Array = NDArray[np.float64]

MEMORY = 300.0
"""Seconds after which a pair's old evidence has faded to 1/e."""
SOLVE_EVERY = 5.0
"""Seconds between two looks at the sums."""
LONGEST_GAP = 1.0
"""Seconds between two pictures of which a person's straight way in between is believed."""
FARTHEST = 1.5
"""Metres by which the second place may lie off the expected one; more is another person."""
CORRELATED = 20.0
"""So many pairs of pictures tell as much as one would if errors of position did not last."""
SUREST = 0.05
"""Seconds: standard error above which a pair's difference is not used yet."""
LEAST = 0.04
"""Seconds: smaller offsets are not corrected."""
KEPT = 0.2
"""Share of the evidence that outlives a correction."""
COMPLAIN = 0.1
"""Seconds: larger ones are told."""


class CameraClocks:
    """Offsets of the clocks of the cameras of one area.

    Attributes:
        offsets: (c,) seconds by which each camera's clock is ahead of most cameras' time; 0 where nothing is known.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        self.cameras = list(cameras)
        count = len(self.cameras)
        self.offsets = np.zeros(count)
        self._sums = np.zeros((count, count, 8))
        self._learned = self._solved = -np.inf

    def learn(
        self, camera: int, clock: float, before: NDArray[np.int64], fixes: Array, velocity: Array, places: Array
    ) -> None:
        """Take in people whom ``camera`` sees now and maybe another saw before.

        Args:
            camera: number of the camera.
            clock: what its clock tells, seconds.
            before: (n,) number of the camera that saw each person before.
            fixes: (n, 3) where, and when by that camera's clock.
            velocity: (n, 2) m/s, without what is seen now.
            places: (n, 2) metres, what is seen now.
        """
        gap = clock - fixes[:, 2]
        beyond = places - fixes[:, :2] - gap[:, None] * velocity
        use = (before != camera) & (np.abs(gap) < LONGEST_GAP) & ((beyond**2).sum(axis=1) < FARTHEST**2)
        if not use.any():
            return
        if self._learned > -np.inf:
            self._sums *= np.exp(-max(clock - self._learned, 0.0) / MEMORY)
        self._learned = max(self._learned, clock)
        v, d = velocity[use], beyond[use]
        rows = np.column_stack([np.ones(len(v)), (v * v).sum(axis=1), (v * d).sum(axis=1), v, d, (d * d).sum(axis=1)])
        np.add.at(self._sums, (before[use], np.full(len(v), camera)), rows)
        if not self._solved <= clock < self._solved + SOLVE_EVERY:
            self._solved = clock
            self._solve()

    def complaints(self) -> list[str]:
        """Return, for an operator, which cameras' clocks are to be set right."""
        off = {
            name: float(offset) for name, offset in zip(self.cameras, self.offsets, strict=True) if abs(offset) > 0.0
        }
        if len(off) == 2 and abs(sum(off.values())) < LEAST:
            # Of two that differ nobody knows which is wrong.
            (one, ahead), (other, behind) = off.items()
            apart = abs(ahead - behind)
            return [f"clocks of cameras {one} and {other} differ by {apart:.1f} s"] if apart >= COMPLAIN else []
        return [
            f"clock of camera {name} is {abs(offset):.1f} s {'ahead' if offset > 0.0 else 'behind'}"
            for name, offset in off.items()
            if abs(offset) >= COMPLAIN
        ]

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        finite = self._learned > -np.inf
        return {
            "offsets": self.offsets.copy(),
            "sums": self._sums.copy(),
            "learned": self._learned if finite else None,
            "solved": self._solved if finite else None,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        offsets, sums = unpack(state["offsets"]), unpack(state["sums"])
        if offsets.shape != self.offsets.shape or sums.shape != self._sums.shape:
            raise ValueError("clock offsets of other cameras")
        learned, solved = (-np.inf if state[name] is None else float(state[name]) for name in ("learned", "solved"))
        self.offsets, self._sums, self._learned, self._solved = offsets, sums, learned, solved

    def _solve(self) -> None:
        """Fit offsets to the differences of the pairs known well enough; most cameras are taken to be right."""
        weight, vv, vd = (self._sums[..., place] for place in range(3))
        v, d, dd = self._sums[..., 3:5], self._sums[..., 5:7], self._sums[..., 7]
        count = np.maximum(weight, 1e-9)
        across = vv - (v * v).sum(axis=-1) / count
        slope = (vd - (v * d).sum(axis=-1) / count) / np.maximum(across, 1e-9)
        left = np.maximum(dd - (d * d).sum(axis=-1) / count - slope**2 * across, 0.0) / (2.0 * count)
        error = np.sqrt(CORRELATED * np.maximum(left, 1e-3) / np.maximum(across, 1e-9))
        information = np.where((weight > 50.0) & (error < SUREST), 1.0 / error**2, 0.0)
        pairs = information + information.T
        lag = -slope  # the second camera of the pair is ahead of the first by this
        pulled = (information * lag).sum(axis=0) - (information * lag).sum(axis=1)
        known = pairs.any(axis=1)
        if not known.any():
            return
        laplacian = np.diag(pairs.sum(axis=1)) - pairs
        offsets = np.linalg.pinv(laplacian, rcond=1e-9, hermitian=True) @ pulled
        offsets -= np.median(offsets[known])
        offsets = np.where(known & (np.abs(offsets) >= LEAST), offsets, 0.0)
        if np.abs(offsets - self.offsets).max() >= LEAST:
            # With wrong times tracks zigzag and their velocities are poor: what was learned so is worth little now.
            self._sums *= KEPT
        self.offsets = offsets
