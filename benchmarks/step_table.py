"""How well does each step detector count, time and hold its tongue? All of them on the step counter recordings.

What is fitted is fitted without the person tested: thresholds, the hidden Markov model, ten constants of the gated
peaks. Not so: personal thresholds, which come from another walk of the same person, as they are meant to; and the row
``shipped``, whose constants have seen all three people and which says only that the service still counts as it did.
Three figures tell on each other: the count of a whole recording, the steps matched, and what is told while the
phone is only handled; a count alone lets handling hide misses.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.baselines.step_rivals import RIVALS, THRESHOLDS
from benchmarks.experiment import in_parallel, progress_bar
from benchmarks.step_hmm_training import Words, trained
from benchmarks.step_recordings import (
    MATCHED_WITHIN,
    Recording,
    detect,
    matches_by_lag,
    middle_lag,
    read_recordings,
)
from services.gateway.reckoning.hops import RATE
from services.gateway.steps.adaptive_dft import PEAKS, AdaptiveDft
from services.gateway.steps.detector import StepDetector
from services.gateway.steps.gated_peaks import GatedPeaks
from services.gateway.steps.step_hmm import StepHmm
from services.gateway.steps.step_words import StepWords
from services.gateway.steps.thresholds import LONGEST_TRIAL, PersonalThresholds, TrialError, personalise

__all__ = [
    "METHODS",
    "SHIPPED_METHOD",
    "Tally",
    "by_person",
    "draw",
    "figures_of",
    "held_out",
    "measure",
    "tally",
]

Array = NDArray[np.float64]

SHIPPED_METHOD = "gated_peaks"
_WHERE = ("hand", "front", "back", "purse")
_PROBE = GatedPeaks(
    lowest=0.3,
    over_rms=0.5,
    over_walk=0.0,
    refractory_share=0.5,
    start_correlation=0.7,
    regular=0.35,
    silence=1.4,
    stop_correlation=0.4,
    stop_after=1.5,
    resume=0.0,
)
_CHOICES: dict[str, tuple[float, ...]] = {
    "stop_correlation": (0.4, 0.5, 0.6),
    "stop_after": (1.5, 2.5, 3.5),
    "resume": (0.0, 4.0, 5.0),
    "over_walk": (0.0, 0.3, 0.4, 0.5),
    "over_rms": (0.3, 0.4, 0.5),
    "refractory_share": (0.5, 0.6),
    "start_correlation": (0.7, 0.75),
    "regular": (0.25, 0.3, 0.35),
    "lowest": (0.3, 0.4),
    "silence": (1.2, 1.4),
}
_ROUNDS = 2
_BARS = 0.01, 0.03, 0.12
"""Of count error, missing F1 and false steps a second: what a loss is measured in."""


@dataclasses.dataclass(frozen=True, slots=True)
class Tally:
    """What became of k recordings; (k,) each but ``by_lag``.

    Attributes:
        found: steps told.
        true: steps taken.
        by_lag: (k, l) steps told within ``MATCHED_WITHIN`` of a true one, at each of ``LAGS``.
        false: steps told before the first true one and after the last: handling.
        outside: s of that.
    """

    found: Array
    true: Array
    by_lag: Array
    false: Array
    outside: Array

    def count_error(self) -> Array:
        """Return the relative error of each count, (k,), without sign."""
        return np.abs(self.found / self.true - 1.0)

    def f1(self) -> float:
        """Return the F1 of all steps, each recording at its own best lag."""
        return float(2.0 * self.by_lag.max(axis=1).sum() / (self.found.sum() + self.true.sum()))

    def f1_common_lag(self) -> float:
        """Return the F1 of all steps, all recordings at the one lag that is best for them together."""
        return float(2.0 * self.by_lag.sum(axis=0).max() / (self.found.sum() + self.true.sum()))

    def false_rate(self) -> float:
        """Return false steps per second of handling."""
        return float(self.false.sum() / self.outside.sum())

    def loss(self) -> float:
        """Return what a choice of constants makes small."""
        parts = self.count_error().mean(), 1.0 - self.f1(), self.false_rate()
        return float(sum(part / bar for part, bar in zip(parts, _BARS, strict=True)))

    def of(self, chosen: NDArray[np.bool_]) -> Tally:
        """Return the tally of some recordings."""
        return Tally(*(getattr(self, field.name)[chosen] for field in dataclasses.fields(self)))


def tally(found: Sequence[Array], recordings: Sequence[Recording]) -> Tally:
    """Return what became of the recordings, given the steps ``found`` in each, s."""
    by_lag, false = [], []
    for t, recording in zip(found, recordings, strict=True):
        steps = recording.steps
        by_lag.append(matches_by_lag(t, steps))
        shifted = t + middle_lag(by_lag[-1])
        false.append(np.sum((shifted < steps[0] - MATCHED_WITHIN) | (shifted > steps[-1] + MATCHED_WITHIN)))
    return Tally(
        found=np.array([len(t) for t in found], float),
        true=np.array([len(recording.steps) for recording in recordings], float),
        by_lag=np.array(by_lag),
        false=np.array(false, float),
        outside=np.array([recording.outside() for recording in recordings]),
    )


def by_person(judged: Mapping[str, Tally], people: Sequence[str]) -> Tally:
    """Return the tally where each person's recordings are taken from a tally of all recordings of their own."""
    whose = np.array(people)
    order = np.argsort(np.concatenate([np.flatnonzero(whose == person) for person in judged]))
    parts = [tally.of(whose == person) for person, tally in judged.items()]
    columns = (np.concatenate([getattr(part, field.name) for part in parts]) for field in dataclasses.fields(Tally))
    return Tally(*(column[order] for column in columns))


def held_out(tallies: Sequence[Tally], people: Sequence[str]) -> tuple[Tally, dict[str, int]]:
    """Return the tally where each person's recordings are judged by the variant best for the others, and which it was.

    Args:
        tallies: of one or more variants of a method.
        people: (k,) whose recording each is.
    """
    whose = np.array(people)
    choice = {
        str(person): int(np.argmin([variant.of(whose != person).loss() for variant in tallies]))
        for person in np.unique(whose)
    }
    return by_person({person: tallies[best] for person, best in choice.items()}, people), choice


def chosen_gated_peaks(chosen: NDArray[np.bool_]) -> GatedPeaks:
    """Return the gated peaks whose constants are best for some recordings, one constant after the other.

    Begins with the constants of a probe made before. Not among them are those of the quick start, which come from the
    twin's construction sites (train seeds).

    Args:
        chosen: (k,) the recordings that count.
    """
    best = _PROBE
    for _ in range(_ROUNDS):
        for name, values in _CHOICES.items():
            one: list[dict[str, Any]] = [{name: value} for value in values]
            variants = [best, *(dataclasses.replace(best, **change) for change in one)]
            best = min(variants, key=lambda variant: _judged(variant).of(chosen).loss())
    return best


def thresholds_grid() -> list[PersonalThresholds]:
    """Return the pairs (δ, ρ) that are chosen from."""
    pairs = itertools.product((10.5, 10.8, 11.1, 11.4, 11.8), (10.1, 10.4, 10.7, 11.0))
    return [PersonalThresholds(delta, rho) for delta, rho in pairs if rho < delta]


def adaptive_grid() -> list[AdaptiveDft]:
    """Return the variants of the adaptive DFT that are chosen from."""
    return [AdaptiveDft(peak, share=share) for peak in PEAKS for share in (0.1, 0.2)]


def _gated_peaks() -> Tally:
    """Return the tally of the gated peaks, their constants chosen without the person tested."""
    people = [recording.person for recording in _recordings()]
    judged = {person: _judged(chosen_gated_peaks(np.array(people) != person)) for person in sorted(set(people))}
    return by_person(judged, people)


@cache
def _judged(variant: GatedPeaks) -> Tally:
    recordings = _recordings()
    return tally(detect(variant, recordings), recordings)


def _grid(variants: Sequence[StepDetector]) -> Tally:
    recordings = _recordings()
    tallies = [tally(detect(variant, recordings), recordings) for variant in variants]
    return held_out(tallies, [recording.person for recording in recordings])[0]


def _personal_thresholds() -> Tally:
    """Return the tally with each person's own thresholds, from the first steps of another of their recordings.

    Whose trial no thresholds fit, and where there is no other recording, has the pair held out from the others.
    """
    recordings = _recordings()
    trials: dict[str, tuple[float, float]] = {}
    for recording in recordings:
        last = recording.steps[LONGEST_TRIAL - 2]
        begin, end = (int((t - recording.t) * RATE) for t in (max(recording.t, recording.steps[0] - 1.0), last + 0.3))
        try:
            trials[recording.name] = personalise(recording.acceleration[begin:end], LONGEST_TRIAL - 1)
        except TrialError:
            continue
    people = [recording.person for recording in recordings]
    grid = thresholds_grid()
    _, choice = held_out([tally(detect(variant, recordings), recordings) for variant in grid], people)
    state = np.zeros(len(recordings), PersonalThresholds.STATE)
    for row, recording in enumerate(recordings):
        own = recording.name.rpartition("_")[0]
        others = [name for name in trials if name != recording.name and name.rpartition("_")[0] == own]
        fallback = grid[choice[recording.person]]
        state["delta"][row], state["rho"][row] = trials[others[0]] if others else (fallback.delta, fallback.rho)
    return tally(detect(PersonalThresholds(), recordings, state), recordings)


def _hmm(words: StepWords) -> Tally:
    recordings = _recordings()
    candidates = Words(recordings, words)
    people = np.array([recording.person for recording in recordings])
    found: list[Array] = [np.empty(0)] * len(recordings)
    for person in np.unique(people):
        model = trained(candidates, people[candidates.recording] != person)
        mine = np.flatnonzero(people == person)
        told = detect(StepHmm(model, words), [recordings[row] for row in mine])
        for row, t in zip(mine, told, strict=True):
            found[row] = t
    return tally(found, recordings)


def _rival(name: str) -> Tally:
    recordings = _recordings()
    tallies = [
        tally([recording.t + RIVALS[name](recording.acceleration, threshold) for recording in recordings], recordings)
        for threshold in THRESHOLDS[name]
    ]
    return held_out(tallies, [recording.person for recording in recordings])[0]


METHODS: dict[str, Callable[[], Tally]] = {
    "gated_peaks": _gated_peaks,
    "shipped": lambda: _judged(GatedPeaks()),
    "thresholds": lambda: _grid(thresholds_grid()),
    "personal_thresholds": _personal_thresholds,
    "hmm": lambda: _hmm(StepWords()),
    "hmm_as_published": lambda: _hmm(StepWords(shortest=0.4, longest=0.8, apart=(0.2, 0.4), lowest=0.2)),
    "adaptive_dft": lambda: _grid(adaptive_grid()),
    **{name: partial(_rival, name) for name in RIVALS},
}
"""Every detector of the table; each returns its tally on all recordings."""


def measure(progress: Progress, jobs: int = 1) -> dict[str, float]:
    """Return the figures of all methods; those of the method that ships without a prefix, the others' as ``NAME_…``.

    Without a prefix is the method with constants chosen without the person tested; ``shipped_…`` has those that ship.
    """
    tallies = in_parallel(_measured, [(name,) for name in METHODS], jobs, progress, "step detectors")
    figures: dict[str, float] = {}
    for name, its in zip(METHODS, tallies, strict=True):
        prefix = "" if name == SHIPPED_METHOD else f"{name}_"
        figures |= {prefix + figure: value for figure, value in figures_of(its).items()}
    return figures


def figures_of(its: Tally) -> dict[str, float]:
    """Return count error (median and worst, by position), F1 and false steps a second of one method."""
    error = its.count_error()
    where = np.array([recording.position for recording in _recordings()])
    figures = {f"step_error_{place}": float(np.median(error[where == place])) for place in _WHERE}
    figures |= {f"step_worst_{place}": float(error[where == place].max()) for place in _WHERE}
    figures["step_worst"] = float(error.max())
    matched = {"step_f1": its.f1(), "step_f1_common_lag": its.f1_common_lag()}
    return figures | matched | {"false_steps_per_s": its.false_rate()}


def draw(figures: dict[str, float], path: Path) -> None:
    """Draw the count error of each method by position, median as bar and worst recording as mark, as PNG."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(11, 4.5))
    width = 0.8 / len(METHODS)
    for place, name in enumerate(METHODS):
        prefix = "" if name == SHIPPED_METHOD else f"{name}_"
        at = np.arange(len(_WHERE)) + (place - (len(METHODS) - 1) / 2) * width
        median, worst = ([100.0 * figures[f"{prefix}step_{kind}_{w}"] for w in _WHERE] for kind in ("error", "worst"))
        bars = axes.bar(at, np.maximum(median, 0.05), width * 0.9, label=name.replace("_", " "))
        axes.plot(at, np.maximum(worst, 0.05), "_", color=bars.patches[0].get_facecolor(), markersize=9, mew=2)
    axes.set(
        yscale="log",
        ylabel="count error, % (bar: median, mark: worst)",
        xticks=range(len(_WHERE)),
        xticklabels=["hand", "front pocket", "back pocket", "purse"],
        title="steps counted on whole recordings",
    )
    axes.legend(ncols=3, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.1))
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def show() -> int:
    """Print the table, and which constants all recordings together would choose."""
    with progress_bar() as progress:
        figures = measure(progress)
    for name in METHODS:
        prefix = "" if name == SHIPPED_METHOD else f"{name}_"
        print(f"{name:20}", end="")
        for place in _WHERE:
            median, worst = (100.0 * figures[f"{prefix}step_{kind}_{place}"] for kind in ("error", "worst"))
            print(f"  {place} {median:.2f}/{worst:.1f}", end="")
        print(f"  F1 {figures[prefix + 'step_f1']:.4f}  false {figures[prefix + 'false_steps_per_s']:.3f}/s")
    recordings = _recordings()
    print(chosen_gated_peaks(np.ones(len(recordings), bool)))
    for grid in (thresholds_grid(), adaptive_grid()):
        print(min(grid, key=lambda variant: tally(detect(variant, recordings), recordings).loss()))
    return 0


def _measured(name: str) -> Tally:
    return METHODS[name]()


@cache
def _recordings() -> list[Recording]:
    return read_recordings()


if __name__ == "__main__":
    raise SystemExit(show())
