"""When does who stands still become background, and what stays where they stood? The law of a learning background.

A background model that renews the share 1 − exp(−r Δt) of itself (learning rate r, per second) gives a body that has
stood at one place for T seconds the *imprint* w = 1 − exp(−r T): the share of that place's past that was body. MOG2
holds as background what makes up the larger part of the past (its background ratio, 0.6 in the camera service), so
people fade once w passes some 0.4; and when they leave, the floor itself looks foreign for as long as w exp(−r t) stays
above some 0.6: a ghost. Real bodies fidget, lean and are found in part, which makes both thresholds soft. Their places
and widths are fitted to the real detector on rendered clips by ``atrium bench fading-fit``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

__all__ = ["FITTED", "STILL_RADIUS", "FadingLaw", "Imprints", "imprint_after"]

Array = NDArray[np.float64]

STILL_RADIUS = 0.25
"""Metres: half a body's width. Who moves farther than this stands somewhere else, on floor that does not know them."""


@dataclass(frozen=True, slots=True)
class FadingLaw:
    """How visible an imprint leaves people, and how visible it is itself once they have gone.

    People fidget: a background that learns slowly sees them in many postures before it knows one, and never knows all;
    one that learns fast learns each. ``slowness`` = 1 / (1 + rate · fidget_time) says which it is.

    Attributes:
        fade_at: imprint at which a still person is found half as often as before, by a fast background.
        fade_delay: how much later a slow one gets there.
        fade_width: scale of the logistic around it.
        residue: share of the time in which a slow background finds somebody wholly faded nevertheless.
        fidget_time: seconds after which a posture comes again.
        ghost_at: imprint at which a left place is taken for a person every other time.
        ghost_width: scale of the logistic around it.
    """

    fade_at: float
    fade_delay: float
    fade_width: float
    residue: float
    fidget_time: float
    ghost_at: float
    ghost_width: float

    def visible(self, imprint: Array, learning_rate: float) -> Array:
        """Return the factor in [0, 1] by which ``imprint`` lowers the probability of finding a person."""
        slowness = 1.0 / (1.0 + learning_rate * self.fidget_time)
        half = self.fade_at + self.fade_delay * slowness
        seen = expit((half - imprint) / self.fade_width) / expit(half / self.fade_width)
        visible: Array = self.residue * slowness + (1.0 - self.residue * slowness) * seen
        return visible

    def ghostly(self, imprint: Array) -> Array:
        """Return the probability that a left place with this imprint is taken for a person."""
        seen: Array = expit((imprint - self.ghost_at) / self.ghost_width)
        return seen


FITTED = FadingLaw(
    fade_at=0.335,
    fade_delay=0.2122,
    fade_width=0.0412,
    residue=0.2232,
    fidget_time=15.8865,
    ghost_at=0.6756,
    ghost_width=0.0485,
)
"""From benchmarks/results/fading-fit.json: MOG2 with a background ratio of 0.6, learning 0.003 to 0.3 per second."""


def imprint_after(learning_rate: float, seconds: Array | float, before: Array | float = 0.0) -> Array:
    """Return the imprint of a body that stood for ``seconds`` on a place whose imprint was ``before``."""
    return np.asarray(1.0 - (1.0 - np.asarray(before)) * np.exp(-learning_rate * np.asarray(seconds)))


class Imprints:
    """What a learning background knows of p people and of the places they have left; advanced tick after tick.

    Attributes:
        anchor: (p, 2) where each stands, metres; NaN for who is nowhere.
        imprint: (p,).
        ghost: (g, 2) left places that may be taken for people, metres.
        ghost_imprint: (g,).
        ghost_person: (g,) whose they are.
        ghost_number: (g,) counted from 0 as they come up.
    """

    def __init__(self, persons: int, learning_rate: float, law: FadingLaw) -> None:
        self.learning_rate = learning_rate
        self.law = law
        self.anchor = np.full((persons, 2), np.nan)
        self.imprint = np.zeros(persons)
        self.ghost = np.zeros((0, 2))
        self.ghost_imprint = np.zeros(0)
        self.ghost_person = np.zeros(0, np.int64)
        self.ghost_number = np.zeros(0, np.int64)
        self._ghosts = 0

    def make_room(self, persons: int) -> None:
        """Know of more people, who are nowhere yet."""
        more = persons - len(self.imprint)
        if more > 0:
            self.anchor = np.concatenate([self.anchor, np.full((more, 2), np.nan)])
            self.imprint = np.concatenate([self.imprint, np.zeros(more)])

    def step(self, position: Array, t: float, seconds: float) -> None:
        """Let the ``seconds`` up to ``t`` pass after which people are at ``position`` (p, 2), metres; NaN: not there.

        A model that began at time 0 knows t seconds: until it is older than half of 1 / rate it learns 1 / (2 t).
        One with rate 0 learns nothing.
        """
        young = 0.5 / max(t, seconds) if self.learning_rate > 0.0 else 0.0
        kept = float(np.exp(-max(self.learning_rate, young) * seconds))
        with np.errstate(invalid="ignore"):
            still = np.hypot(*(position - self.anchor).T) <= STILL_RADIUS  # NaN compares false
        gone = np.flatnonzero(~still & (self.law.ghostly(self.imprint) > _FORGOTTEN))
        self.ghost_imprint = self.ghost_imprint * kept
        if gone.size:
            self.ghost = np.concatenate([self.ghost, self.anchor[gone]])
            self.ghost_imprint = np.concatenate([self.ghost_imprint, self.imprint[gone]])
            self.ghost_person = np.concatenate([self.ghost_person, gone])
            self.ghost_number = np.concatenate([self.ghost_number, self._ghosts + np.arange(gone.size)])
            self._ghosts += gone.size
        if self.ghost_imprint.size:
            keep = self.law.ghostly(self.ghost_imprint) > _FORGOTTEN
            self.ghost, self.ghost_imprint = self.ghost[keep], self.ghost_imprint[keep]
            self.ghost_person, self.ghost_number = self.ghost_person[keep], self.ghost_number[keep]
        self.imprint = np.where(still, 1.0 - (1.0 - self.imprint) * kept, 0.0)
        self.anchor = np.where(still[:, None], self.anchor, position)


_FORGOTTEN = 0.01
"""Probability below which a ghost is no longer kept."""
