"""From recordings with true steps to the model that ``StepHmm`` ships [ravel-thesis §9].

``python -m benchmarks.step_hmm_training`` trains on all recordings and writes the file beside the detector.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from hmmlearn.hmm import CategoricalHMM
from numpy.typing import NDArray

import services.gateway.steps
from benchmarks.step_recordings import MATCHED_WITHIN, Recording, best_lag, hops_of, read_recordings
from services.gateway.steps.step_hmm import StepModel
from services.gateway.steps.step_words import SYMBOLS, StepWords

__all__ = ["STATES", "Words", "chosen_threshold", "renew", "train", "trained"]

Array = NDArray[np.float64]

STATES = 8
_ITERATIONS = 20
_ENOUGH = 2000
"""Words to train on; more change nothing but the time it takes."""
_FLOOR = 1e-3
"""Of an emission's probability: no symbol is impossible for having never been seen."""


class Words:
    """The candidate stretches of some recordings.

    Attributes:
        recording: (m,) which.
        t: (m,) s.
        word: (m, WORD).
        true: (m,) whether a foot struck then.
    """

    def __init__(self, recordings: Sequence[Recording], words: StepWords | None = None) -> None:
        words = words or StepWords()
        state = np.zeros(len(recordings), words.STATE)
        parts = [words.advance(state, hop) for hop in hops_of(recordings)]
        self.recording = np.concatenate([part.phone for part in parts])
        self.t = np.concatenate([part.t for part in parts])
        self.word = np.concatenate([part.word for part in parts])
        self.true = np.zeros(len(self.t), bool)
        for row, recording in enumerate(recordings):
            mine = self.recording == row
            near = np.abs((self.t[mine] + best_lag(self.t[mine], recording.steps))[:, None] - recording.steps)
            self.true[mine] = near.min(axis=1) <= MATCHED_WITHIN


def train(words: NDArray[np.int64], threshold: float = -np.inf, seed: int = 0) -> StepModel:
    """Return a left-right model of true steps' words (m, n): a state is kept, or left for one of the next two."""
    rng = np.random.default_rng(seed)
    model = CategoricalHMM(STATES, n_iter=_ITERATIONS, params="te", init_params="", n_features=SYMBOLS)
    model.startprob_ = np.eye(1, STATES)[0]
    stay = np.triu(np.ones((STATES, STATES))) - np.triu(np.ones((STATES, STATES)), 3)
    model.transmat_ = stay / stay.sum(axis=1, keepdims=True)
    # Each state begins as what words look like about its share of the way.
    places = np.minimum(np.arange(words.shape[1]) * STATES // words.shape[1], STATES - 1)
    seen = np.full((STATES, SYMBOLS), 1.0)
    for place, at in enumerate(places):
        seen[at] += np.bincount(words[:, place], minlength=SYMBOLS)
    seen *= rng.uniform(0.95, 1.05, seen.shape)
    model.emissionprob_ = seen / seen.sum(axis=1, keepdims=True)
    level = logging.getLogger("hmmlearn").level
    logging.getLogger("hmmlearn").setLevel(logging.ERROR)  # says that an estimate may be degenerate; floors mend it
    try:
        model.fit(words.reshape(-1, 1), np.full(len(words), words.shape[1]))
    finally:
        logging.getLogger("hmmlearn").setLevel(level)
    emission = np.maximum(model.emissionprob_, _FLOOR)
    return StepModel(
        start=model.startprob_,
        transition=model.transmat_,
        emission=emission / emission.sum(axis=1, keepdims=True),
        threshold=threshold,
    )


def chosen_threshold(model: StepModel, words: NDArray[np.int64], true: NDArray[np.bool_]) -> float:
    """Return the threshold with the highest F1 of telling true candidates (m,) from others."""
    log = model.log_probability(words)
    order = np.argsort(-log)
    hits = np.cumsum(true[order])
    f1 = 2.0 * hits / (np.arange(1, len(log) + 1) + true.sum())
    return float(log[order[np.argmax(f1)]])


def trained(found: Words, chosen: NDArray[np.bool_]) -> StepModel:
    """Return the model, with its threshold, of the candidates ``chosen`` (m,)."""
    steps = found.word[chosen & found.true]
    model = train(steps[:: -(-len(steps) // _ENOUGH)])
    threshold = chosen_threshold(model, found.word[chosen], found.true[chosen])
    return StepModel(model.start, model.transition, model.emission, threshold)


def renew() -> int:
    """Train on all recordings and write the file that ships."""
    found = Words(read_recordings())
    model = trained(found, np.ones(len(found.t), bool))
    path = Path(services.gateway.steps.__file__).parent / "static" / "step_hmm.json"
    path.parent.mkdir(exist_ok=True)
    values = {
        "trained on": "true steps of the Oxford step counter data set, CC BY 4.0",
        "threshold": round(model.threshold, 4),
        "start": model.start.tolist(),
        "transition": model.transition.round(6).tolist(),
        "emission": model.emission.round(6).tolist(),
    }
    path.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    print(f"{path.name}: {int(found.true.sum())} true steps of {len(found.t)} candidates")
    return 0


if __name__ == "__main__":
    raise SystemExit(renew())
