"""Where is somebody whom receivers hear, and nothing else is known? A particle filter on radio alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radio import RadioModel

__all__ = ["RadioFilter"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RadioFilter:
    """A walk whose velocity wanders, seen through a radio model.

    Attributes:
        white: of a reading beyond what the map does not know, dB.
        freedom: degrees of freedom of its Student's t; infinity: Gaussian.
        worth: how much of a reading each is, 0 to 1: successive ones share body and shadowing.
        speed: usual speed, m/s; ``memory``: seconds for which a velocity lasts.
        memory: see above.
        mapped: whether the model's map speaks; without, its path loss alone.
        particles: how many.
    """

    white: float = 4.0
    freedom: float = np.inf
    worth: float = 1.0
    speed: float = 0.5
    memory: float = 3.0
    mapped: bool = True
    particles: int = 2000

    def follow(
        self, model: RadioModel, t: Array, level: Array, lower: Array, upper: Array, rng: np.random.Generator,
        lag: float = 0.0,
    ) -> Array:  # fmt: skip
        """Return where somebody was, (n, 2) metres, each told by what was heard until then.

        Args:
            model: of the m receivers.
            t: (n,) seconds, increasing.
            level: (n, m) dBm; NaN where not heard.
            lower: (2,) corner of the room, metres; ``upper`` the other.
            upper: see above.
            rng: draws.
            lag: seconds for which what is told waits for more to be heard: a fixed-lag smoother.
        """
        count = self.particles
        place = rng.uniform(lower, upper, (count, 2))
        velocity = rng.normal(0.0, self.speed / np.sqrt(2.0), (count, 2))
        told = np.empty((len(t), 2))
        past: list[tuple[int, Array]] = []
        for row in range(len(t)):
            step = float(t[row] - t[row - 1]) if row else 0.0
            keep = np.exp(-step / self.memory)
            kick = self.speed / np.sqrt(2.0) * np.sqrt(1.0 - keep**2)
            velocity = keep * velocity + rng.normal(0.0, kick, (count, 2))
            place = place + step * velocity
            outside = (place < lower) | (place > upper)
            velocity[outside] *= -1.0
            place = np.clip(place, lower, upper)
            likelihood = self._likelihood(model, place, level[row])
            weight = np.exp(likelihood - likelihood.max())
            weight /= weight.sum()
            past.append((row, place))
            drawn = np.searchsorted(np.cumsum(weight), (np.arange(count) + rng.uniform()) / count)
            drawn = np.minimum(drawn, count - 1)
            place, velocity = place[drawn], velocity[drawn]
            past = [(when, where[drawn]) for when, where in past]
            while past and t[row] - t[past[0][0]] >= lag:
                when, where = past.pop(0)
                told[when] = where.mean(axis=0)
        for when, where in past:
            told[when] = where.mean(axis=0)
        return told

    def _likelihood(self, model: RadioModel, place: Array, level: Array) -> Array:
        heard = np.flatnonzero(np.isfinite(level))
        expected = model.path_loss.rssi(place)[:, heard]
        variance: Array = np.full(expected.shape, self.white**2)
        if self.mapped:
            mean, unknown = model.shadowing.at(place)
            expected, variance = expected + mean[:, heard], variance + unknown[:, heard]
        squared = (level[heard] - expected) ** 2 / variance
        if np.isfinite(self.freedom):
            off = (self.freedom + 1.0) / 2.0 * np.log1p(squared / self.freedom)
        else:
            off = squared / 2.0
        likelihood: Array = -self.worth * (off + 0.5 * np.log(variance)).sum(axis=1)
        return likelihood
