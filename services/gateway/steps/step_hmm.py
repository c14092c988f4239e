"""Does this stretch of acceleration look like a step? A hidden Markov model trained on true steps [ravel-thesis §9]."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State
from services.gateway.steps.detector import Steps
from services.gateway.steps.step_words import StepWords

__all__ = ["StepHmm", "StepModel", "shipped_model"]

_SHIPPED = Path(__file__).parent / "static" / "step_hmm.json"
_WALKS_ON = 1.5


@dataclass(frozen=True, slots=True)
class StepModel:
    """A left-right model of the words of true steps.

    Attributes:
        start: (k,) probability of each state at the first symbol.
        transition: (k, k) from row to column.
        emission: (k, SYMBOLS).
        threshold: least log-probability of a word that is a step.
    """

    start: Array
    transition: Array
    emission: Array
    threshold: float

    def log_probability(self, words: NDArray[np.int64]) -> Array:
        """Return log p of each of m words (m, n), by the forward algorithm."""
        log = np.zeros(len(words))
        forward = self.start * self.emission[:, words[:, 0]].T
        for place in range(1, words.shape[1]):
            total = forward.sum(axis=1, keepdims=True)
            log += np.log(total[:, 0])
            forward = (forward / total) @ self.transition * self.emission[:, words[:, place]].T
        log += np.log(forward.sum(axis=1))
        return log


@cache
def shipped_model() -> StepModel:
    """Return the model trained on all recordings of the Oxford step counter data set (CC BY 4.0)."""
    values = json.loads(_SHIPPED.read_text(encoding="utf-8"))
    start, transition, emission = (np.array(values[name]) for name in ("start", "transition", "emission"))
    return StepModel(start, transition, emission, float(values["threshold"]))


@dataclass(frozen=True, slots=True)
class StepHmm:
    """Stretches of the norm whose word the model finds probable; nothing else gates them.

    Attributes:
        model: of true steps.
        words: what cuts the stretches.
    """

    model: StepModel = field(default_factory=shipped_model)
    words: StepWords = field(default_factory=StepWords)

    STATE = np.dtype([("words", StepWords.STATE), ("last", np.float64), ("period", np.float64)])
    """Of one phone: 2 kB."""

    def advance(self, state: State, hops: Hops) -> Steps:
        """Take one hop of each of p phones and return the steps it led to."""
        words = state["words"]
        found = self.words.advance(words, hops)
        state["words"] = words
        steps = self.model.log_probability(found.word) >= self.model.threshold
        phone, t = found.phone[steps], found.t[steps]
        state["last"][phone] = t
        state["period"][phone] = found.duration[steps]
        walking = (state["last"] > 0.0) & (hops.t + HOP / RATE - state["last"] < _WALKS_ON)
        state["period"] = np.where(walking, state["period"], 0.0)
        return Steps(phone, t, walking, state["period"].copy())
