"""The same phone held against everybody who was about: how well do its radio and steps fit each of their paths?"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.radio_evidence import Fit, RadioBelief, gather, radio_fit
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.walk_evidence import walk_fit, walked_of
from shared.radio import PathLoss, ShadowingMap, expected_level

__all__ = ["Comparison", "compare"]

Array = NDArray[np.float64]

ALIVE = 0.5
"""Share of the time another track must have been about to be held against the phone."""
APART = 1.0
"""Metres; who was nearer on average is no mistake that matters."""


@dataclass(frozen=True)
class Comparison:
    """A phone against k paths, its own track's first; nats.

    Attributes:
        seconds: how long.
        radio: (k,) by which its readings speak for each path, against no places.
        walk: (k,) by which its steps do, against what people's paths are like.
        paths: (k, n, 2) metres, where they were about every second.
        fit: of the readings; None where there are none.
        stepped: share of the seconds of which the phone said how it walked.
    """

    seconds: float
    radio: Array
    walk: Array
    paths: Array
    fit: Fit | None
    stepped: float

    @property
    def total(self) -> Array:
        """(k,) both together."""
        return self.radio + self.walk

    @property
    def away(self) -> Array:
        """(k,) metres (root mean square) from its own track."""
        away: Array = np.sqrt(((self.paths - self.paths[0]) ** 2).sum(axis=2).mean(axis=1))
        return away

    @property
    def away_first(self) -> Array:
        """(k,) metres from its own track when it began."""
        away: Array = np.hypot(*(self.paths[:, 0] - self.paths[0, 0]).T)
        return away

    @property
    def others(self) -> NDArray[np.int64]:
        """Which of the paths are other people, far enough away to matter."""
        return np.flatnonzero(self.away > APART)

    @property
    def own_probability(self) -> float:
        """Of the own track being the phone's by this alone, everybody being as likely beforehand."""
        rivals = np.minimum(self.total[self.others] - self.total[0], 50.0)
        return float(1.0 / (1.0 + np.exp(rivals).sum()))

    def as_if_on(self, other: int) -> Comparison:
        """Return what would be found had the phone been named on one of the others' tracks, and its own not been about:
        a wrong name, and the hardest one to find out."""
        order = np.concatenate([[other], np.delete(np.arange(1, len(self.paths)), other - 1)])
        fit = self.fit
        if fit is not None:
            fit = dataclasses.replace(fit, gain=fit.gain[order], chi2=fit.chi2[order], offset=fit.offset[order])
        return dataclasses.replace(
            self, radio=self.radio[order], walk=self.walk[order], paths=self.paths[order], fit=fit
        )


def compare(
    stretch: Stretch,
    radio: PathLoss,
    shadowing: ShadowingMap | None,
    belief: RadioBelief,
    begin: float | None = None,
    end: float | None = None,
) -> Comparison:
    """Return how well the phone fits its own track and the others, between two times; None: the stretch's.

    Args:
        stretch: of the phone.
        radio: the model of the m access points; what is heard of those it does not place is passed over.
        shadowing: what it leaves out.
        belief: what earlier stretches tell.
        begin: s.
        end: s.
    """
    begin, end = stretch.t[0] if begin is None else begin, stretch.t[-1] if end is None else end
    t = np.linspace(begin, end, max(round(end - begin), 1) + 1)
    paths = _paths(stretch, t)
    step = (stretch.step_t >= begin) & (stretch.step_t < end)
    steps = (stretch.step_t[step], stretch.length[step], stretch.heading[step], stretch.heading_variance[step])
    walked = walked_of(t, *steps, stretch.still)
    read = (stretch.scan_t >= begin) & (stretch.scan_t <= end) & (stretch.point < len(radio.names))
    read[read] = radio.placed[stretch.point[read]]
    fit = None
    if read.any():
        heard = gather(stretch.scan_t[read], stretch.point[read], stretch.level[read], steps[0], steps[1])
        expected, _ = expected_level(_at(paths, t, heard.t), heard.point, radio, shadowing)
        fit = radio_fit(heard, expected, belief)
    return Comparison(
        seconds=float(end - begin),
        radio=np.zeros(len(paths)) if fit is None else fit.gain,
        walk=walk_fit(walked, paths),
        paths=paths,
        fit=fit,
        stepped=float(walked.known.mean()),
    )


def _paths(stretch: Stretch, t: Array) -> Array:
    """Return (k, n, 2) places of the own track and of others at (n,) times; a gap is bridged, an end held."""
    paths = [_between(t, stretch.t, stretch.place)]
    slack = 1.0
    during = (stretch.other_t >= t[0] - slack) & (stretch.other_t <= t[-1] + slack)
    for place in stretch.other_place[:, during]:
        alive = np.isfinite(place[:, 0])
        if alive.any() and alive.mean() >= ALIVE:
            paths.append(_between(t, stretch.other_t[during][alive], place[alive]))
    return np.stack(paths)


def _between(t: Array, known: Array, place: Array) -> Array:
    return np.column_stack([np.interp(t, known, place[:, axis]) for axis in (0, 1)])


def _at(paths: Array, t: Array, when: Array) -> Array:
    """Return (k, r, 2) places at (r,) times between the evenly spaced (n,) times ``t`` of (k, n, 2) paths."""
    spot = np.clip((when - t[0]) / (t[1] - t[0]), 0.0, len(t) - 1.0)
    left = np.minimum(spot.astype(np.int64), len(t) - 2)
    share = (spot - left)[:, None]
    found: Array = (1.0 - share) * paths[:, left] + share * paths[:, left + 1]
    return found
