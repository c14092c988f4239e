"""How often does this person step, and how far? Cadence and length follow from the speed, by a law of their own.

Length = height (a cadence + b) + c [ravel-thesis §6.2, Eq. 4.3/5.2, after Renaudin et al. 2012], and speed = cadence x
length, so that a given speed has one cadence. The published sheet leaves a, b and c open: these give 1.87 steps a
second of 0.70 m at 1.3 m/s, what people in shopping malls do. Steps are counted along the distance truly walked:
however irregular a walk is, the lengths of its steps add up to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.signal import lfilter

from shared.site.site_file import Number, Part

__all__ = ["Steps", "Stride", "StrideParameters", "StrideRhythm"]

Array = NDArray[np.float64]


class StrideParameters(Part):
    """How strides differ between people, and from step to step."""

    height: Number = Field(1.72, ge=1.0, le=2.3, description="mean height of the people, m")
    height_sigma: Number = Field(0.09, ge=0, le=0.3, description="of single people against it, m")
    slope: Number = Field(0.20, ge=0.05, le=0.6, description="a: step length per height and cadence, s")
    slope_sigma: Number = Field(0.015, ge=0, le=0.1, description="of single people, s")
    share: Number = Field(0.03, ge=-0.2, le=0.5, description="b: step length per height")
    share_sigma: Number = Field(0.01, ge=0, le=0.2, description="of single people")
    constant_sigma: Number = Field(0.03, ge=0, le=0.2, description="c, of single people about zero, m")
    irregularity: Number = Field(0.04, ge=0, le=0.3, description="of a step's length against the law, as a share")


@dataclass(frozen=True, slots=True)
class Stride:
    """One person's law.

    Attributes:
        height: m.
        slope: a, s.
        share: b.
        constant: c, m.
        slowest: the lowest cadence of a walk, steps/s; who is slower takes shorter steps instead of fewer.
    """

    height: float
    slope: float
    share: float
    constant: float
    slowest: float = 1.0

    SHORTEST = 0.15
    """m; who shuffles about on the spot takes few steps, not shorter ones still."""

    @classmethod
    def draw(cls, rng: np.random.Generator, parameters: StrideParameters) -> Stride:
        """Return somebody's law; nobody is further than 2.5 standard deviations from the mean."""
        off = np.clip(rng.normal(size=5), -2.5, 2.5)
        return cls(
            height=max(0.9, parameters.height + parameters.height_sigma * off[0]),
            slope=max(0.03, parameters.slope + parameters.slope_sigma * off[1]),
            share=parameters.share + parameters.share_sigma * off[2],
            constant=parameters.constant_sigma * off[3],
            slowest=1.0 + 0.06 * off[4],
        )

    def cadence(self, speed: Array) -> Array:
        """Return steps a second, (n,), at which somebody goes ``speed`` (n,) m/s."""
        speed = np.maximum(speed, 0.0)
        linear = self.height * self.share + self.constant
        quadratic = self.height * self.slope
        by_law = (np.sqrt(linear**2 + 4.0 * quadratic * speed) - linear) / (2.0 * quadratic)
        return np.minimum(np.maximum(by_law, self.slowest), speed / self.SHORTEST)

    def length(self, speed: Array) -> Array:
        """Return the length of a step, (n,) m, at ``speed`` (n,) m/s: speed = cadence x length."""
        return np.where(speed > 1e-6, np.maximum(speed, 1e-6) / self.cadence(np.maximum(speed, 1e-6)), self.SHORTEST)


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps of one stretch of time.

    Attributes:
        count: steps taken by each sample, (n,); its fraction says how far the foot has come.
        t: when each step ended, (k,) seconds.
        length: (k,) metres.
    """

    count: Array
    t: Array
    length: Array


class StrideRhythm:
    """Counts one person's steps along the distance walked, stretch after stretch.

    Args:
        rng: decides how irregular they are.
        stride: the person's law.
        irregularity: standard deviation of a step's length against the law, as a share.
    """

    FORGETS = 1.2
    """Seconds in which one step forgets the ones before."""

    def __init__(self, rng: np.random.Generator, stride: Stride, irregularity: float) -> None:
        self.stride = stride
        self._rng = rng
        self._irregularity = irregularity
        self._off = 0.0
        # Feet begin anywhere in their swing; the walk to the first whole step is no step of this record.
        self._count = float(rng.uniform(0.0, 1.0))
        self._t: float | None = None
        self._walked = 0.0
        self._stepped: float | None = None

    def restart(self) -> None:
        """Go on after a time of which nothing is known."""
        self._t = None
        self._stepped = None

    def follow(self, t: Array, walked: Array, speed: Array) -> Steps:
        """Return the steps of the next n samples.

        Args:
            t: (n,) seconds, increasing.
            walked: (n,) metres walked so far.
            speed: (n,) m/s.
        """
        if self._t is None:
            self._t, self._walked = float(t[0]), float(walked[0])
        seconds = float(t[-1] - self._t) / len(t) if t[-1] > self._t else 0.02
        keep = math.exp(-seconds / self.FORGETS)
        kicks = self._rng.normal(0.0, self._irregularity * math.sqrt(1.0 - keep * keep), len(t))
        off = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * self._off])[0]
        self._off = float(off[-1])
        length = self.stride.length(speed) * np.clip(1.0 + off, 0.5, 1.5)
        stretch = np.maximum(np.diff(walked, prepend=self._walked), 0.0)
        count = self._count + np.cumsum(stretch / length)
        whole = np.arange(math.floor(self._count) + 1, math.floor(count[-1]) + 1)
        counts = np.concatenate([[self._count], count])
        when = np.interp(whole, counts, np.concatenate([[self._t], t]))
        where = np.interp(whole, counts, np.concatenate([[self._walked], self._walked + np.cumsum(stretch)]))
        if len(whole):
            lengths = np.diff(where, prepend=where[0] if self._stepped is None else self._stepped)
            if self._stepped is None:  # where the first one began is not known
                when, lengths = when[1:], lengths[1:]
            self._stepped = float(where[-1])
        else:
            lengths = np.empty(0)
        self._count, self._t, self._walked = float(count[-1]), float(t[-1]), float(walked[-1])
        return Steps(count, when, lengths)
