"""Where was this Wi-Fi scan heard? Discretised naive Bayes, the localiser of [self-calibrating-rss-thesis §4.1, §4.3].

Signal strength falls into bins; of each reference point and access point the survey's histogram, smoothed after
Laplace; of each scan the probability of every reference point, access points independent, all points alike before; the
mean of the points, weighted by it. The study first chooses one of seven clusters of points by a classifier; here all
points take part.

The study does not say what a scan tells of an access point it missed. Here it counts as the weakest reading ("floor"),
or as nothing ("skip"), or as a bin of its own ("own_bin").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from benchmarks.baselines.survey import Survey

__all__ = ["NaiveBayes", "NaiveBayesParameters", "bin_width_for"]

Array = NDArray[np.float64]

BIN_WIDTHS = {10: 4, 20: 4, 30: 3, 40: 2, 50: 2}
"""The best bin width in dB by scans at each reference point [self-calibrating-rss-thesis §8.3 E4.5]."""


@dataclass(frozen=True, slots=True)
class NaiveBayesParameters:
    """The settings of the localiser.

    Attributes:
        bin_width: dB, whole; wide bins blur, narrow ones of few scans are empty by chance.
        missing: what a missed access point counts as: "floor", "skip" or "own_bin".
        weakest: dBm, the lower end of the first bin.
        strongest: dBm, within the last bin; what lies outside belongs to the outermost bins.
    """

    bin_width: int = 4
    missing: Literal["floor", "skip", "own_bin"] = "floor"
    weakest: int = -100
    strongest: int = -34

    def __post_init__(self) -> None:
        """Refuse settings without a meaning."""
        if self.bin_width < 1:
            raise ValueError(f"bin_width: {self.bin_width} is not allowed; at least 1")
        if self.missing not in ("floor", "skip", "own_bin"):
            raise ValueError(f"missing: {self.missing!r} is not allowed; floor, skip or own_bin")
        if self.weakest >= self.strongest:
            raise ValueError(f"weakest: {self.weakest} is not allowed; it must be below strongest, {self.strongest}")

    @property
    def bins(self) -> int:
        """How many bins of signal strength there are."""
        return math.ceil((self.strongest - self.weakest + 1) / self.bin_width)


class NaiveBayes:
    """The radio map of a survey, and where scans were heard by it.

    Attributes:
        position: (s, 2) reference points, metres.
        log_probability: (s, k, b), log Pr(reading of the access point falls into the bin | point); equations 2.7, 2.8.
    """

    def __init__(self, survey: Survey, parameters: NaiveBayesParameters | None = None) -> None:
        self.parameters = parameters or NaiveBayesParameters()
        self.position: Array = survey.position
        places, points = len(survey.position), len(survey.access_points)
        bins = self.parameters.bins + (self.parameters.missing == "own_bin")
        counts = np.zeros((places, points, bins))
        fallen = self._bins(survey.readings)
        place, sample, point = np.nonzero(fallen >= 0)
        np.add.at(counts, (place, point, fallen[place, sample, point]), 1.0)
        self.log_probability: Array = np.log((counts + 1.0) / (counts.sum(axis=2, keepdims=True) + bins))

    def log_likelihood(self, readings: Array) -> Array:
        """Return log Pr(scan | point), (n, s), of readings (n, k) in dBm, NaN where not heard."""
        fallen = self._bins(readings)
        total = np.zeros((len(readings), len(self.position)))
        for point in range(readings.shape[1]):
            counted = fallen[:, point] >= 0
            total[counted] += self.log_probability[:, point, fallen[counted, point]].T
        return total

    def posterior(self, readings: Array) -> Array:
        """Return Pr(point | scan), (n, s), all points alike before; equations 2.4, 2.5."""
        level = self.log_likelihood(readings)
        probability: Array = np.exp(level - logsumexp(level, axis=1, keepdims=True))
        return probability

    def locate(self, readings: Array) -> Array:
        """Return the mean of the points weighted by the posterior, (n, 2) metres; equation 4.3."""
        place: Array = self.posterior(readings) @ self.position
        return place

    def _bins(self, readings: Array) -> NDArray[np.int64]:
        """Return the bins, counted from 0, into which readings of any shape fall; -1 for what does not count."""
        chosen = self.parameters
        absent = {"floor": 0, "skip": -1, "own_bin": chosen.bins}[chosen.missing]
        heard = np.isfinite(readings)
        number = np.floor((np.where(heard, readings, chosen.weakest) - chosen.weakest) / chosen.bin_width)
        fallen: NDArray[np.int64] = np.where(heard, np.clip(number, 0, chosen.bins - 1), absent).astype(np.int64)
        return fallen


def bin_width_for(samples: int) -> int:
    """Return the bin width in dB that the study found best for so many scans at each reference point."""
    return BIN_WIDTHS[max([10, *(count for count in BIN_WIDTHS if count <= samples)])]
