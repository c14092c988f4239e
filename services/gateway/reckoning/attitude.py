"""How is the phone turned? The protocol of the attitude filters, and the choice between them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from services.gateway.reckoning.hops import Array, Hops, State

__all__ = ["Attitude"]


class Attitude(Protocol):
    """Follows how each of p phones is turned against the ground.

    ``STATE`` declares what is remembered of one phone; zeros are a phone of whom nothing is known.
    """

    @property
    def STATE(self) -> np.dtype[np.void]:  # noqa: N802
        """Of one phone; all zeros: nothing known yet."""

    def advance(self, state: State, hops: Hops, rate: Array) -> Array:
        """Take one hop of each of p phones and change ``state`` (p,) in place.

        Args:
            state: (p,) of ``STATE``.
            hops: the samples.
            rate: (p, HOP, 3) rad/s, the gyroscope's with its bias removed.

        Returns:
            (p, HOP, 3, 3) rotations from the phone's axes to (east, north, up), north being magnetic. A phone without
            a compass is level but turned by an unknown angle that does not change.
        """
