"""Does the gate let in what is better, and nothing that is worse? Candidates of random quality in random worlds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options, in_parallel
from benchmarks.fusion_run import run_fusion
from benchmarks.learning_adapter import ruling_on
from benchmarks.learning_candidates import KINDS, candidate_of, poisoned, until
from benchmarks.learning_splits import part_of
from benchmarks.position_error import centre_of, window_rmse
from benchmarks.track_reading import named_positions
from benchmarks.twin_scores import used_access_points
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import EPOCH, load, record_world, with_access_points
from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER
from services.simulator.radio.radio_changes import PowerChange
from services.simulator.scenario_file import DetectedView, Scenario
from services.simulator.seeds import generator

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["EXPERIMENT", "WORLDS", "Bout", "change_of", "draw_gate", "gate_figures", "main", "try_world"]

Array = NDArray[np.float64]

WORLDS = ("construction-1", "museum", "construction-2", "museum") * 4 + ("museum",)
EACH = 2
"""Candidates tried in each area of a world."""
TURN, TAUGHT, LOOK, LOOKS, TEST = 180.0, 360.0, 240.0, 3, 600.0
"""Seconds: when something changes, when training ends, of a look of the gate, how many looks, of the test."""
BEFORE = 120.0
"""Seconds before a look from which on fusion still has what was said: who is who is known when it begins."""
END = TAUGHT + LOOKS * LOOK + TEST
RATE = 10.0
"""Frames a second at most, so that it takes minutes."""
WORSE, BETTER = 0.02, 0.05
"""Shares of the test error."""


@dataclass(frozen=True)
class Bout:
    """One candidate.

    Attributes:
        kind: of ``KINDS``.
        gain: nats per withheld reading in the trial.
        live: whether the gate let it in.
        change: of the error in the test part by going live, as a share; negative is better.
        doubt: its standard error, by a jackknife over minutes.
    """

    kind: str
    gain: float
    live: bool
    change: float
    doubt: float = 0.0


def try_world(name: str, number: int, seed: int) -> list[Bout]:
    """Return the bouts of one random world: its name in ``WORLDS``, its number, the seed of them all."""
    rng = generator(seed, "gate", str(number))
    scenario, site = load(name)
    points = [point.id for point in site.access_points]
    by = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 15.0))
    change = PowerChange(at=TURN, kind="power", access_point=str(rng.choice(points)), by=by)
    worlds = record_world(_changed(scenario, change), site, int(rng.integers(10_000, 2**31)), seconds=END)
    bouts = []
    for place, record in enumerate(worlds.values()):
        first = EACH * (2 * number + place)
        kinds = [KINDS[(first + more) % len(KINDS)] for more in range(EACH)]
        chosen = with_access_points(record, used_access_points(record, min(6, len(points))))
        bouts += [_bout(kind, chosen, rng) for kind in kinds]
    return bouts


def _bout(kind: str, record: WorldRecord, rng: np.random.Generator) -> Bout:
    liar = None
    if kind == "malicious":
        liar = str(rng.choice([name for name in record.truth.device if name]))
        record = poisoned(record, liar, rng)
    training = part_of(record, 0.0, TAUGHT)
    found = AreaView.of(record.site, record.area)
    run = run_fusion(training, view=found)
    active = found
    if rng.random() < 0.5:
        active = candidate_of("learned", training, until(run, 0.0, EPOCH + 0.75 * TURN), found, 0.0, rng)
    candidate = candidate_of(kind, training, run, found, EPOCH + TURN, rng)
    begins = [TAUGHT + number * LOOK for number in range(LOOKS)]
    looks = ((part_of(record, begin - BEFORE, begin + LOOK), EPOCH + begin) for begin in begins)
    ruling = ruling_on(looks, DEFAULT_TRACKER, active, candidate)
    before, after = (_errors(part_of(record, END - TEST, END), view, liar) for view in (active, candidate))
    change, doubt = change_of(before, after)
    return Bout(kind, ruling.gain or 0.0, ruling.outcome == "activate", change, doubt)


def change_of(before: Array, after: Array) -> tuple[float, float]:
    """Return by which share mean errors (minutes, people) change, NaN where nobody was, and its standard error."""
    fine = np.isfinite(before) & np.isfinite(after)
    sums = np.array([np.where(fine, one, 0.0).sum(axis=1) for one in (before, after)])
    change = float(sums[1].sum() / sums[0].sum()) - 1.0
    left_out = sums.sum(axis=1, keepdims=True) - sums
    without = left_out[1] / left_out[0] - 1.0
    minutes = len(without)
    return change, float(np.sqrt((minutes - 1) / minutes * ((without - without.mean()) ** 2).sum()))


def _errors(record: WorldRecord, view: AreaView, liar: str | None) -> Array:
    """Return the error in each minute, metres, of all but a malicious phone's carrier; NaN: out of view."""
    truth = record.truth
    errors = window_rmse(truth, named_positions(truth, run_fusion(record, view=view).frames), centre_of(record.view))
    honest = [truth.device[place] != liar for place in truth.carriers()]
    return errors.rmse[:, honest]


def _changed(scenario: Scenario, change: PowerChange) -> Scenario:
    views = [
        view.model_copy(update={"frames_per_s": min(RATE, view.frames_per_s)})
        for view in scenario.views
        if isinstance(view, DetectedView)
    ]
    return scenario.model_copy(
        update={"views": views, "radio": scenario.radio.model_copy(update={"changes": [change]})}
    )


def gate_figures(bouts: Sequence[Bout]) -> dict[str, float | None]:
    """Return ``worst_loss``, ``good_activated`` and how many of which kind went live."""
    live = [bout for bout in bouts if bout.live]
    good = [bout for bout in bouts if bout.change < -BETTER]
    sure = [bout for bout in bouts if bout.change + 2.0 * bout.doubt < -BETTER]
    figures: dict[str, float | None] = {
        "worst_loss": max((bout.change for bout in live), default=0.0),
        "good_activated": sum(bout.live for bout in good) / len(good) if good else None,
        "candidates": len(bouts),
        "activated": len(live),
        "good": len(good),
        "bad": sum(bout.change > WORSE for bout in bouts),
        "bad_activated": sum(bout.change > WORSE for bout in live),
        "surely_good": len(sure),
        "surely_good_activated": sum(bout.live for bout in sure) / len(sure) if sure else None,
        "surely_bad_activated": sum(bout.change - 2.0 * bout.doubt > WORSE for bout in live),
        "doubt": float(np.median([bout.doubt for bout in bouts])),
    }
    for kind in KINDS:
        mine = [bout.live for bout in bouts if bout.kind == kind]
        figures[f"activated_{kind}"] = sum(mine) / len(mine) if mine else None
    return figures


def draw_gate(bouts: Sequence[Bout], picture: Path) -> None:
    """Draw each candidate's gain in the trial against what it truly changed; those that went live are filled."""
    figure, axis = plt.subplots(figsize=(7.5, 5.0))
    for number, kind in enumerate(KINDS):
        for live in (True, False):
            mine = [bout for bout in bouts if bout.kind == kind and bout.live == live]
            axis.scatter(
                [bout.gain for bout in mine],
                [100.0 * bout.change for bout in mine],
                edgecolors=f"C{number}",
                facecolors=f"C{number}" if live else "none",
            )
        axis.scatter([], [], color=f"C{number}", label=kind)
    axis.axhspan(-100.0 * BETTER, 100.0 * WORSE, color="0.92", zorder=0)
    axis.axvline(0.0, color="0.8", zorder=0)
    axis.set(title="candidates and the gate", xlabel="gain in the trial, nats per withheld reading")
    axis.set_ylabel("change of the test error, %")
    axis.legend(title="filled: went live", fontsize="small")
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def run(options: Options, progress: Progress) -> Figures:
    """Return ``worst_loss`` and ``good_activated`` over all worlds."""
    cells = [(name, number, options.seed) for number, name in enumerate(WORLDS)]
    found = in_parallel(try_world, cells, options.jobs, progress, "worlds")
    bouts = [bout for world in found for bout in world]
    draw_gate(bouts, options.picture)
    return gate_figures(bouts)


EXPERIMENT = Experiment(
    name="learning-gate",
    question="Does the gate let in what is better, and nothing that is worse?",
    kind="twin",
    scenario="random worlds",
    run=run,
    made="""Fifty candidates of a radio model in random worlds (building sites and museum; ten frames a second at most;
after 3 minutes one access point becomes up to 15 dB stronger or weaker). Minutes 0 to 6 teach, 6 to 18 are the gate's
(three looks), 18 to 28 tell the truth: mean over people and minutes of the RMSE, fresh trackers; active is the site as
found, or what was learned before the change. Kinds: learned since the change; the same with random errors of up to
6 dB; learned with everybody's names swapped; stale (from before the change); from one minute only; with one phone that
invents its radio (its carrier's error does not count). `worst_loss`: the largest share by which a model that went live
raised the test error; `good_activated`: the share of candidates more than 5 % better that went live; ten minutes of
four or five people tell changes of a few percent from chance only just: `doubt` is the median standard error of such a
change (a jackknife over minutes), `surely_…` counts those that are two of them beyond the limit.""",
    at_most={"worst_loss": 0.02},
    at_least={"good_activated": 0.8},
    picture="Gain in the trial against the change of the test error; filled: went live.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
