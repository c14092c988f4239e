"""What do readings at known places say of a site's radio? Constants, map, phones' offsets, and how sure they are.

Readings are averaged over visits beforehand: one phone, one access point, one square metre, one passage. What all
readings of a visit have in common (how the carrier faces, a wrong name) is as large as visits to one spot disagree.
A visit that is far off what all others say counts for less (Student's t, by reweighting), and so does a phone whose
visits are. What an access point sends wanders from one hour to the next by as much as sessions disagree; a model that
is used later must be unsure by that.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radio.expected_level import expected_level
from shared.radio.path_loss import PathLoss
from shared.radio.radio_learning import RadioLearner, RadioPrior, device_offsets
from shared.radio.radio_model import RadioModel
from shared.radio.visits import visit_variance

__all__ = ["RadioFit", "Visits", "fit_radio", "gather_visits"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPOT = 1.0
"""Metres; a phone's readings along one track in a square of that side are one visit."""
FREEDOM = 4.0
"""Degrees of freedom of Student's t: how heavy the tails of a visit's error are."""
ROUNDS = 3
SESSION = 1200.0
"""Seconds after which an access point may send otherwise."""
DRIFT = 1.0
"""dB by which it does, as believed beforehand, and as many pairs of sessions as that belief counts."""
BELIEVED = 12.0


@dataclass(frozen=True)
class Visits:
    """n visits.

    Attributes:
        t: (n,) when, seconds.
        device: (n,) whose, 0 … d − 1.
        point: (n,) of which access point.
        place: (n, 2) where, metres.
        level: (n,) mean of what was heard, dBm.
        weight: (n,) inverse variance of that mean where visits share no error, dB⁻².
    """

    t: Array
    device: Index
    point: Index
    place: Array
    level: Array
    weight: Array

    def __len__(self) -> int:
        """How many."""
        return len(self.t)

    def where(self, chosen: NDArray[np.bool_]) -> Visits:
        """Return those that are ``chosen``, (n,)."""
        return Visits(*(getattr(self, column.name)[chosen] for column in dataclasses.fields(self)))


@dataclass(frozen=True)
class RadioFit:
    """What n visits taught.

    Attributes:
        model: of the radio; its variance includes what access points drift.
        offset: (d,) what each phone reads too much, dB.
        error: (n,) heard − foretold by the model, the phone's offset taken off, dB.
        worth: (n,) inverse variance with which each visit taught, dB⁻².
        visit: standard deviation of what a visit's readings have in common, dB.
        drift: of what an access point sends from one session to another, dB.
    """

    model: RadioModel
    offset: Array
    error: Array
    worth: Array
    visit: float
    drift: float


def gather_visits(
    t: Array, device: Index, passage: Index, point: Index, place: Array, level: Array, weight: Array
) -> Visits:
    """Return n readings as visits, in order of time.

    Args:
        t: (n,) seconds.
        device: (n,) whose.
        passage: (n,) which of its passages, for example a track.
        point: (n,) which access point.
        place: (n, 2) metres.
        level: (n,) dBm.
        weight: (n,) inverse variance of each reading by itself, dB⁻².
    """
    fine = np.isfinite(np.column_stack([t, place, level, weight])).all(axis=1) & (weight > 0.0)
    t, device, passage, point = t[fine], device[fine], passage[fine], point[fine]
    place, level, weight = place[fine], level[fine], weight[fine]
    key = np.column_stack([device, passage, point, np.floor(place / SPOT).astype(np.int64)])
    _, first, visit = np.unique(key, axis=0, return_index=True, return_inverse=True)
    visit = visit.ravel()
    total: Array = np.asarray(np.bincount(visit, weight, len(first)), np.float64)

    def mean(values: Array) -> Array:
        means: Array = np.bincount(visit, weight * values, len(first)) / total
        return means

    when = mean(t)
    order = np.argsort(when, kind="stable")
    return Visits(
        when[order],
        device[first][order],
        point[first][order],
        np.column_stack([mean(place[:, 0]), mean(place[:, 1])])[order],
        mean(level)[order],
        total[order],
    )


def fit_radio(
    guess: PathLoss,
    lower: Array,
    upper: Array,
    visits: Visits,
    *,
    kept: Array | None = None,
    prior: RadioPrior | None = None,
    devices: int | None = None,
    site: str = "",
) -> RadioFit:
    """Return what visits teach [ravel-thesis §8.4, robust, with a prior, offsets and a map].

    Args:
        guess: of the path loss, from which constants may be off as the prior says.
        lower: (2,) corner of the floor, metres; ``upper`` the other.
        upper: see above.
        visits: n of them.
        kept: (n,) how much of each is not forgotten, 0 to 1; None: all.
        prior: what is believed beforehand.
        devices: how many phones there are; None: as many as the largest number says.
        site: the site's id.
    """
    prior = prior or RadioPrior()
    count = int(visits.device.max(initial=-1)) + 1 if devices is None else devices
    offset = np.zeros(count)
    if not len(visits):
        return RadioFit(
            _drifting(RadioLearner.over(guess, lower, upper, prior=prior).solve(site), DRIFT),
            offset, np.zeros(0), np.zeros(0), 0.0, DRIFT,
        )  # fmt: skip
    kept = np.ones(len(visits)) if kept is None else kept
    rows = np.arange(len(visits))
    residual = visits.level - guess.rssi_of(visits.place, visits.point)
    spot = _numbered(np.column_stack([visits.point, np.floor(visits.place / SPOT).astype(np.int64)]))
    trust, shared = np.ones(len(visits)), 0.0
    for _ in range(ROUNDS):
        worth = np.maximum(kept * trust * visits.weight / (1.0 + shared * visits.weight), 1e-9)
        offset = device_offsets(guess, prior, visits.device, visits.place, visits.point, residual, 1.0 / worth)
        offset = np.append(offset, np.zeros(count - len(offset)))
        off = residual - offset[visits.device]
        shared = visit_variance(spot, rows, off, visits.weight * np.maximum(kept * trust, 1e-9))
        worth = kept * trust * visits.weight / (1.0 + shared * visits.weight)
        learner = RadioLearner.over(guess, lower, upper, prior=prior)
        learner.add(visits.place, visits.point, off, worth)
        model = learner.solve(site)
        error = visits.level - offset[visits.device] - _foretold(model, visits)
        squared = error**2 / (1.0 / visits.weight + shared)
        trust = (FREEDOM + 1.0) / (FREEDOM + squared) * _reliable(visits.device, squared, kept, count)[visits.device]
        trust = np.minimum(trust, 1.0)
    drift = _drift(visits, error, worth)
    return RadioFit(_drifting(model, drift), offset, error, worth, float(np.sqrt(shared)), drift)


def _foretold(model: RadioModel, visits: Visits) -> Array:
    there, _ = expected_level(visits.place, visits.point, model.path_loss, model.shadowing)
    return there


def _reliable(device: Index, squared: Array, kept: Array, count: int) -> Array:
    """Return (d,) how far to trust each phone: one whose visits fit worse than most phones' do is trusted less."""
    total = np.bincount(device, kept, count)
    mean = np.bincount(device, kept * np.minimum(squared, 25.0), count) / np.maximum(total, 1e-9)
    there = np.sort(mean[total > 0.0])
    usual = max(float(there[(len(there) - 1) // 2]), 0.3)
    reliable: Array = np.minimum(1.0, usual / np.maximum(mean, 1e-9)) ** 2
    return reliable


def _drift(visits: Visits, error: Array, worth: Array) -> float:
    """Return the standard deviation, dB, of what access points send from session to session."""
    session = np.floor(visits.t / SESSION).astype(np.int64)
    pair = _numbered(np.column_stack([visits.point, session]))
    taught = worth > 0.0
    if not taught.any():
        return DRIFT
    pair = _numbered(pair[taught][:, None])
    found = visit_variance(visits.point[taught], pair, error[taught], worth[taught])
    more = int(pair.max()) + 1 - len(np.unique(visits.point[taught]))
    return float(np.sqrt((BELIEVED * DRIFT**2 + more * found) / (BELIEVED + more)))


def _drifting(model: RadioModel, drift: float) -> RadioModel:
    shadowing = dataclasses.replace(model.shadowing, variance=model.shadowing.variance + drift**2)
    return dataclasses.replace(model, shadowing=shadowing)


def _numbered(keys: Index) -> Index:
    """Return the number of each of (n, k) keys among all that differ, (n,)."""
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel().astype(np.int64)
