"""How does the light of a rendered hall change? It swings slowly, and now and then a lamp or a cloud makes it jump."""

from __future__ import annotations

import bisect
import math

import numpy as np
from pydantic import Field

from shared.site.site_file import Number, Part

__all__ = ["Light", "VideoParameters"]


class VideoParameters(Part):
    """The part ``video`` of a scenario: what rendered pictures are like."""

    frames_per_s: Number = Field(15.0, gt=0, le=60, description="pictures per second")
    light_change: Number = Field(
        0.04, ge=0, lt=1, description="how far the light swings up and down in a minute or so, share"
    )
    light_steps: Number = Field(0.0, ge=0, le=60, description="how often the light jumps, per minute")
    light_step: Number = Field(
        0.15, ge=0, le=0.6, description="standard deviation of the level it jumps to about the middle one, share"
    )
    shadows: Number = Field(1.0, ge=0, le=1.5, description="strength of shadows; 0: none")
    noise: Number = Field(2.5, ge=0, le=50, description="standard deviation of the sensor noise, grey levels")


class Light:
    """The level of the light at any time, 1 on average; the same whatever was asked for before."""

    def __init__(self, video: VideoParameters, rng: np.random.Generator) -> None:
        self._swing = video.light_change
        self._rate = video.light_steps / 60.0
        self._spread = video.light_step
        self._rng = rng
        self._times = [0.0]
        self._levels = [1.0]

    def at(self, t: float) -> float:
        """Return the level at ``t`` seconds."""
        swing = 1.0 + self._swing * (0.7 * math.sin(t / 11.0) + 0.3 * math.sin(t / 3.7))
        while self._rate > 0.0 and self._times[-1] <= t:
            self._times.append(self._times[-1] + float(self._rng.exponential(1.0 / self._rate)))
            self._levels.append(float(np.clip(1.0 + self._spread * self._rng.standard_normal(), 0.4, 1.6)))
        return swing * self._levels[max(0, bisect.bisect_right(self._times, t) - 1)]
