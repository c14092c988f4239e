"""Where is a phone by radio alone? Horus (Youssef and Agrawala, 2005), its continuous-space estimator.

The strongest radio-only method the original study compares with, given every access point and a survey
[ravel-thesis §10]. Per survey cell and access point a Gaussian of the signal strength; of each scan the probability of
every cell, access points independent; the centre of mass of the most probable cells; a moving average over time.

Missing readings: cell and access point also have a probability of being heard, the share of the survey's samples that
heard it, (heard + 1) / (samples + 2); a missing reading has the probability of not being heard.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.survey import Survey, readings_of
from benchmarks.world_record import WorldRecord

__all__ = ["HorusParameters", "RadioMap", "locate", "locate_phone"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HorusParameters:
    """The settings of the estimator; the original study does not publish its own.

    Attributes:
        top_cells: how many of the most probable cells the centre of mass is taken of.
        average: length of the moving average, seconds.
        least_sigma: dB; a few samples of one surveyor understate how readings vary between phones and bodies.
        pooled_samples: with how many samples' weight each cell's variance is drawn towards that of all cells.
    """

    top_cells: int = 6
    average: float = 4.0
    least_sigma: float = 3.0
    pooled_samples: float = 10.0

    def __post_init__(self) -> None:
        """Refuse settings without a meaning."""
        if self.top_cells < 1:
            raise ValueError(f"top_cells: {self.top_cells} is not allowed; at least 1")
        for name in ("average", "least_sigma"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: {getattr(self, name)} is not allowed; it must be positive")


class RadioMap:
    """How probable are readings in each survey cell?

    Attributes:
        position: (s, 2), metres.
        mean: (s, k), dBm.
        sigma: (s, k), dB.
        heard: (s, k), probability of being heard.
    """

    def __init__(self, survey: Survey, parameters: HorusParameters) -> None:
        readings = survey.readings
        present = np.isfinite(readings)
        count = present.sum(axis=1)
        filled = np.where(present, readings, 0.0)
        # Where an access point was never heard, it is as strong as the weakest reading anywhere.
        weakest = np.where(present, readings, np.inf).min(axis=(0, 1))
        weakest[~np.isfinite(weakest)] = -95.0
        self.position: Array = survey.position
        self.mean: Array = np.where(count > 0, filled.sum(axis=1) / np.maximum(count, 1), weakest)
        squares = (np.where(present, readings - self.mean[:, None], 0.0) ** 2).sum(axis=1)
        pooled = squares.sum() / max(int((count - 1).clip(min=0).sum()), 1)
        weight = parameters.pooled_samples
        variance = (squares + weight * pooled) / (count + weight) if weight > 0 else squares / np.maximum(count, 1)
        self.sigma: Array = np.sqrt(np.maximum(variance, parameters.least_sigma**2))
        self.heard: Array = (count + 1.0) / (readings.shape[1] + 2.0)

    def log_likelihood(self, readings: Array) -> Array:
        """Return log p(scan | cell), (n, s), of readings (n, k) with NaN where not heard."""
        heard = np.isfinite(readings)
        power = np.where(heard, readings, 0.0)
        precision = 1.0 / self.sigma**2
        constant = np.log(self.heard) - np.log(self.sigma * np.sqrt(2.0 * np.pi)) - 0.5 * precision * self.mean**2
        result: Array = (
            power**2 @ (-0.5 * precision).T
            + power @ (precision * self.mean).T
            + heard @ constant.T
            + ~heard @ np.log1p(-self.heard).T
        )
        return result

    def centre_of_mass(self, readings: Array, top_cells: int) -> Array:
        """Return the probability-weighted mean of each scan's most probable cells, (n, 2)."""
        log_likelihood = self.log_likelihood(readings)
        top_cells = min(top_cells, log_likelihood.shape[1])
        top = np.argpartition(-log_likelihood, top_cells - 1, axis=1)[:, :top_cells]
        level = np.take_along_axis(log_likelihood, top, axis=1)
        weight = np.exp(level - level.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        centre: Array = np.einsum("nc,ncd->nd", weight, self.position[top])
        return centre


def locate_phone(radio_map: RadioMap, t: Array, readings: Array, times: Array, parameters: HorusParameters) -> Array:
    """Return where a phone is at each of ``times``, (n, 2), from the scans until then; NaN before the first.

    Args:
        radio_map: of the survey.
        t: (r,) times of the scans, increasing.
        readings: (r, k) in the order of the survey's access points.
        times: (n,).
        parameters: top cells and length of the average are used.

    Scans that heard nothing tell nothing. While no scan came for the length of the average, the last answer is kept.
    """
    told = np.isfinite(readings).any(axis=1)
    t, readings = t[told], readings[told]
    if len(t) == 0:
        return np.full((len(times), 2), np.nan)
    sums = np.vstack([np.zeros(2), np.cumsum(radio_map.centre_of_mass(readings, parameters.top_cells), axis=0)])
    last = np.searchsorted(t, times, side="right")
    newest = np.minimum(times, t[np.maximum(last - 1, 0)])
    first = np.searchsorted(
        t, np.where(times - newest < parameters.average, times, newest) - parameters.average, "right"
    )
    count = last - first
    averages: Array = (sums[last] - sums[np.minimum(first, last)]) / np.maximum(count, 1)[:, None]
    averages[last == 0] = np.nan
    return averages


def locate(
    record: WorldRecord, survey: Survey, times: Array, parameters: HorusParameters | None = None
) -> Mapping[str, Array]:
    """Return where each phone is at ``times``, (n, 2) by device; causal.

    Args:
        record: its radio scans are used and nothing else.
        survey: readings at known places.
        times: (n,) seconds since the epoch.
        parameters: of the estimator.
    """
    chosen = parameters or HorusParameters()
    radio_map = RadioMap(survey, chosen)
    return {
        device: locate_phone(radio_map, *readings_of(scans, survey.access_points), np.asarray(times, float), chosen)
        for device, scans in record.scans.items()
    }
