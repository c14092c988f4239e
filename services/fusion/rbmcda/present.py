"""Where is everybody now? The filter is a cycle behind, because steps come a second late; links and walks bridge it.

Whether a sighting moved as a phone says is the best evidence there is, and it takes the steps, not a guess at them.
So a cycle is worked on when the next has come. Whoever was seen in it is by now where the link leads; anybody else
goes on at the pace of the last steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from services.fusion.rbmcda.association import linked_to
from services.fusion.rbmcda.particles import Estimate, Particles
from services.fusion.rbmcda.sightings import Sightings

__all__ = ["carried_on"]

Array = NDArray[np.float64]


def carried_on(
    particles: Particles, estimate: Estimate, seen: Sightings, pace: Array, lag: float, guessed: float
) -> Estimate:
    """Return the mixture as it is ``lag`` seconds after the particles' cycle.

    Args:
        particles: after their cycle.
        estimate: of it.
        seen: what cameras see now.
        pace: (2, X) metres per second.
        lag: seconds.
        guessed: metres per second by which a walk may differ.
    """
    mean, covariance = particles.positions()
    mean += lag * pace[:, None, :]
    covariance[[0, 1], [0, 1]] += (guessed * lag) ** 2
    partner = linked_to(seen.link, particles.link)
    linked = partner >= 0
    if linked.any():
        which = partner[linked]
        mean[:, linked] = seen.places[which].T
        covariance[:, :, linked] = np.moveaxis(seen.noise[which], 0, -1)
    weight = particles.weight
    centre = np.einsum("nx,inx->ix", weight, mean)
    apart = mean - centre[:, None, :]
    spread = np.einsum("nx,ijnx->ijx", weight, covariance)
    spread += np.einsum("nx,inx,jnx->ijx", weight, apart, apart)
    agreed = (weight * (apart[0] ** 2 + apart[1] ** 2 < 1.0)).sum(axis=0)
    return replace(estimate, mean=centre, covariance=spread, agreed=np.minimum(agreed, 1.0))
