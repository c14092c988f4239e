"""Which way does somebody walk who has the phone in a trouser pocket? [nonvisual-visual-fusion-dissertation §2.5-2.6].

A swinging thigh says nothing by how the phone points, but along which line it swings. Each stride gives a tentative
line of walking; its sign, and all strides of the walk together, follow from the one vector of the phone that keeps
pointing ahead while the phone stays as it lies in the pocket.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import Array, State
from services.gateway.reckoning.recent import Recent
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE, StepHeadings
from services.gateway.reckoning.strides import FOOTFALLS, SAMPLES, gather, rank, strides
from services.gateway.steps.detector import Steps
from shared.angles import wrap

__all__ = ["PocketHeading", "principal_axis", "principal_harmonic", "swing_asymmetry"]

_HARMONICS = np.exp(-2j * np.pi * np.outer(np.arange(SAMPLES), np.arange(1, 5)) / SAMPLES)  # of a stride


class PocketHeading:
    """Principal frequency, principal axis, constant body vector.

    The dissertation does not say how the line gets its first sign. Here the thigh does: it swings forward faster than
    it goes back, for the leg is longer on the ground than in the air, so that the angular rate is skewed towards
    flexion. The evidence is added up as long as the phone stays where it is and turns the body vector round when it
    speaks against it; until it is clear, ``other`` is the opposite heading. A walk's first strides are spliced to rest,
    lopsided whichever way they go: they have no vote.

    Args:
        memory: steps after which a step counts 1/e in the body vector: a phone slips about in its pocket.
        robust: weigh a step by the inverse of how far it is off: the geometric median, which the printed Eq. 3.4 asks
            for, instead of the mean, which its text asks for.
    """

    STATE = np.dtype(
        [
            ("footfalls", FOOTFALLS),
            ("ahead", np.float64, (3,)),
            ("weight", np.float64),
            ("spread", np.float64),
            ("evidence", np.float64),
            ("votes", np.int64),
            ("last_step", np.float64),
            ("begun", np.int64),
        ]
    )
    BIAS_VARIANCE = np.radians(5.0) ** 2
    """rad², of what all steps have in common: compass, thigh and walk. With what single steps are off by it is as large
    as on the study's real trousers: median 3.8, three quarters within 6.5 degrees."""
    YIELDS = np.radians(3.0) ** 2
    """rad², of a step: cloth yields."""
    FIRST_SPREAD = np.radians(12.0) ** 2
    """rad², of a stride's line, before there were strides to tell."""
    LOG_ODDS = 4.0
    """Of the sign, per unit of the gyroscope's skewness."""
    ODDS_LIMIT = 4.0
    """No sign is surer than exp(this) to one: people differ, and no recording of ours could test it."""

    ODDS_PER_VOTE = 0.5
    """No sign is surer than exp(this x strides that voted): one stride alone proves little."""
    SPLICED = 3
    """Steps of a walk that have no vote: the stride that ends there may have begun at rest."""
    REST = 2.0
    """Seconds without a step after which a walk begins anew, with strides spliced to rest."""

    def __init__(self, memory: float = 20.0, robust: bool = False) -> None:
        self._keep = np.exp(-1.0 / memory)
        self._robust = robust

    def advance(self, state: State, recent: Recent, steps: Steps) -> StepHeadings:
        """Return the headings of ``steps`` and change ``state`` (p,) of ``STATE`` in place."""
        found = strides(state["footfalls"], recent, steps)
        acceleration, rate, attitude = (
            gather(values, recent, steps.phone, found)
            for values in (recent.acceleration, recent.rate, recent.attitude[:, :, :2])  # horizontal rows are enough
        )
        line = principal_axis(np.einsum("mnij,mnj->mni", attitude, principal_harmonic(acceleration)))
        cue = np.einsum("mi,mi->m", swing_asymmetry(np.einsum("mnij,mnj->mni", attitude, rate)), line)
        turned = attitude[:, SAMPLES // 2 :].mean(axis=1)  # the step itself, the stride's second half
        body = np.einsum("mji,mj->mi", attitude.mean(axis=1), line)
        place = rank(steps)
        ahead, variance, odds = np.zeros((len(line), 2)), np.empty(len(line)), np.zeros(len(line))
        for count in range(int(place.max(initial=-1)) + 1):
            row = np.flatnonzero(place == count)
            phone = steps.phone[row]
            use = row[found.known[row]]
            begun = self._since_rest(state, phone, steps.t[row])
            votes = (begun > self.SPLICED)[found.known[row]]
            self._learn(state, steps.phone[use], body[use], cue[use], votes)
            ahead[row] = np.einsum("mij,mj->mi", turned[row], state["ahead"][phone])
            variance[row] = self._variance(state["weight"][phone], state["spread"][phone])
            most = np.minimum(self.ODDS_PER_VOTE * state["votes"][phone], self.ODDS_LIMIT)
            odds[row] = np.minimum(self.LOG_ODDS * state["evidence"][phone], most)
        heading = np.arctan2(ahead[:, 0], ahead[:, 1])
        nothing = np.hypot(*ahead.T) < 1e-6
        variance = np.where(nothing, UNKNOWN_VARIANCE, variance)
        doubt = np.where(nothing, 0.0, 1.0 / (1.0 + np.exp(odds)))
        other = np.where(nothing, heading, wrap(heading + np.pi))
        return StepHeadings(heading, variance, np.full(len(line), self.BIAS_VARIANCE), other, doubt)

    def _since_rest(self, state: State, phone: NDArray[np.int64], t: Array) -> NDArray[np.int64]:
        """Return of one step each of k phones which it is since the phone rested, from 1 on, (k,)."""
        rested = (state["last_step"][phone] <= 0.0) | (t - state["last_step"][phone] > self.REST)
        state["begun"][phone] = begun = np.where(rested, 1, state["begun"][phone] + 1)
        state["last_step"][phone] = t
        return begun

    def _learn(self, state: State, phone: NDArray[np.int64], body: Array, cue: Array, votes: NDArray[np.bool_]) -> None:
        """Take one stride of each of k phones into the body vector; ``body`` (k, 3) has no sign yet.

        ``votes`` (k,) are the strides whose ``cue`` (k,) tells it.
        """
        ahead, weight = state["ahead"][phone], state["weight"][phone]
        sign = np.where(np.einsum("ki,ki->k", body, ahead) < 0.0, -1.0, 1.0)
        body = body * sign[:, None]
        off = np.sum((body - ahead) ** 2, axis=1)
        spread = np.where(weight > 0.0, state["spread"][phone], self.FIRST_SPREAD)
        own = np.ones(len(phone))
        if self._robust:
            own = np.where(weight > 0.0, np.sqrt(spread / np.maximum(off, 0.1 * spread)), 1.0)
        weight = self._keep * weight + own
        gain = own / weight
        state["spread"][phone] = spread + np.maximum(gain, 0.05) * (weight > own) * (off - spread)
        ahead = ahead + gain[:, None] * (body - ahead)
        evidence = self._keep * state["evidence"][phone] + np.where(votes, cue * sign, 0.0)
        turn = np.where(evidence < 0.0, -1.0, 1.0)
        state["ahead"][phone], state["weight"][phone] = ahead * turn[:, None], weight
        state["evidence"][phone] = np.abs(evidence)
        state["votes"][phone] += votes

    def _variance(self, weight: Array, spread: Array) -> Array:
        variance: Array = self.BIAS_VARIANCE + self.YIELDS + spread / np.maximum(weight, 1.0)
        return np.minimum(variance, UNKNOWN_VARIANCE)


def principal_harmonic(acceleration: Array) -> Array:
    """Return the strongest of a stride's harmonics alone, all axes having the same: (m, SAMPLES, 3) in and out."""
    spectrum = np.einsum("mni,nf->mfi", acceleration, _HARMONICS)
    best = np.abs(spectrum).sum(axis=2).argmax(axis=1)
    kept = np.take_along_axis(spectrum, best[:, None, None], axis=1)
    wave: Array = (kept * _HARMONICS.conj().T[best][:, :, None]).real * (2.0 / SAMPLES)
    return wave


def principal_axis(horizontal: Array) -> Array:
    """Return the first axis of the PCA of (m, n, 2), unit vectors (m, 2) without a sign."""
    x, y = np.moveaxis(horizontal - horizontal.mean(axis=1, keepdims=True), 2, 0)
    angle = 0.5 * np.arctan2(2.0 * np.sum(x * y, axis=1), np.sum(x * x, axis=1) - np.sum(y * y, axis=1))
    return np.column_stack([np.cos(angle), np.sin(angle)])


def swing_asymmetry(rate: Array) -> Array:
    """Return which way a thigh swings faster than back, (m, 2) east and north: its length is about the skewness.

    A thigh that swings forward turns about the axis that points to the right, and forward is up x right.

    Args:
        rate: (m, n, 2) horizontal angular rate, east and north, rad/s.
    """
    rate = rate - rate.mean(axis=1, keepdims=True)
    power = np.sum(rate**2, axis=2)
    skew = np.mean(rate * power[:, :, None], axis=1) / np.maximum(power.mean(axis=1), 1e-6)[:, None] ** 1.5
    return np.column_stack([-skew[:, 1], skew[:, 0]])
