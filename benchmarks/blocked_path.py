"""How far off is a prediction whose way an obstacle blocks, by how hard obstacles push? [ravel-thesis §11.3].

The study does not say how it was done; here somebody walks up to a disc and stops there, while the phone goes on
telling steps for half a cycle, and nobody looks. Without contact the prediction walks into the disc.
"""

from __future__ import annotations

import math

import numpy as np

from services.fusion.forces import ForceSettings, Obstacles, displacement

__all__ = ["blocked_path_error"]

RADIUS = 0.5
"""Metres, of the disc."""
SIDE = 0.2
"""Metres by which its centre may lie beside the way."""
SPEED = 1.0
CYCLES = (1.0, 0.5)
"""Share of each second in which steps are told."""
START = 0.1
"""Metres along each axis by which the position is off when the camera loses sight."""
HEADING = math.radians(8.0)


def blocked_path_error(settings: ForceSettings, walkers: int, rng: np.random.Generator) -> float:
    """Return the root mean squared error in metres of the predictions of two cycles.

    Args:
        settings: of the forces.
        walkers: how many walk up to the disc, each alone.
        rng: draws where they come from and by how much phones are wrong.
    """
    obstacles = Obstacles.build(discs=np.array([[0.0, 0.0, RADIUS]]))
    beside = rng.uniform(-SIDE, SIDE, walkers)
    stop = -np.sqrt((RADIUS + settings.radius) ** 2 - beside**2)
    truth = np.column_stack([stop, beside])[:, None]
    at = truth - np.array([1.0, 0.0]) * rng.uniform(0.0, SPEED, (walkers, 1, 1))
    at = at + rng.normal(0.0, START, at.shape)
    heading = rng.normal(0.0, HEADING, (walkers, 1))
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    alone = np.ones((walkers, 1), np.bool_)
    squared = []
    for share in CYCLES:
        walk = share * SPEED * ahead
        shift, _ = displacement(at, alone, heading, obstacles, settings, walk)
        at = at + walk + shift
        squared.append(((at - truth) ** 2).sum(axis=-1))
    return math.sqrt(float(np.mean(squared)))
