"""Does an area tell rightly how far off its named positions are? What learning reports, held against the truth."""

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
from benchmarks.fusion_run import FusionRun, run_fusion
from benchmarks.learning_stretches import heard_of
from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import load, record_world
from services.learning.learners import areas_of
from services.learning.report_draft import ReportDraft
from shared.erased import Erased
from shared.learning_report import AccuracyReport
from shared.messages import TrackFrame

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["EXPERIMENT", "Told", "draw_told", "named_errors", "report_of", "told_figures"]

Array = NDArray[np.float64]

WORLDS = {"construction-1": 32, "construction-2": 42, "museum": 12}
SECONDS = 900.0
WITHIN = 0.25
"""Share by which what is told may be off."""
KINDS = ("rms", "p50", "p90")


@dataclass(frozen=True)
class Told:
    """What one area told, m, and what it was, in the order of ``KINDS``; NaN: it was not told.

    Attributes:
        area: of which world.
        told: (3,) metres.
        true: (3,) metres.
    """

    area: str
    told: Array
    true: Array


def named_errors(frames: Sequence[TrackFrame], truth: Truth) -> Array:
    """Return (n,) metres by which each named, seen position of frames is off; carriers who are not about left out."""
    carrier = {device: place for place, device in enumerate(truth.device) if device is not None}
    errors = []
    for frame in frames:
        for row, device in enumerate(frame.device):
            if device is None or frame.state[row] == "unseen":
                continue
            path = truth.position[:, carrier[device]]
            there = [np.interp(frame.t, truth.t, path[:, axis]) for axis in (0, 1)]
            errors.append(np.hypot(frame.x[row] - there[0], frame.y[row] - there[1]))
    found: Array = np.array(errors, float)
    known: Array = found[np.isfinite(found)]
    return known


def report_of(record: WorldRecord, run: FusionRun) -> AccuracyReport:
    """Return what learning reports of an area at the end of a run."""
    area, erased = areas_of(record.site, [record.area])[record.area], Erased()
    looked = t = -np.inf
    for t, message in heard_of(record, run):
        area.take(message, erased)
        if t >= looked + 1.0:
            looked = t
            list(area.close())
    draft = ReportDraft()
    area.tell(draft)
    [lessons] = draft.report(t, False, []).areas
    return lessons.accuracy


def try_world(name: str, seed: int) -> list[Told]:
    """Return what each area of a world tells."""
    scenario, site = load(name)
    told = []
    for area, record in record_world(scenario, site, seed, seconds=SECONDS).items():
        tracked = run_fusion(record)
        report = report_of(record, tracked)
        error = named_errors(tracked.frames, record.truth)
        true = np.array([np.sqrt(np.mean(error**2)), *np.percentile(error, [50.0, 90.0])])
        values = [np.nan if one is None else one for one in (report.rms, report.p50, report.p90)]
        told.append(Told(f"{name} {area}", np.array(values), true))
    return told


def told_figures(areas: Sequence[Told]) -> dict[str, float | None]:
    """Return of each kind the share of areas that told it, and of those the share that were right; and the worst."""
    told, true = (np.array([getattr(one, name) for one in areas]) for name in ("told", "true"))
    off = np.abs(told / true - 1.0)
    figures: dict[str, float | None] = {"areas": len(areas)}
    for column, kind in enumerate(KINDS):
        known = off[np.isfinite(off[:, column]), column]
        figures[f"{kind}_told"] = len(known) / len(areas)
        figures[f"{kind}_within"] = float(np.mean(known <= WITHIN)) if len(known) else None
        figures[f"{kind}_worst"] = float(known.max()) if len(known) else None
    return figures


def draw_told(areas: Sequence[Told], picture: Path) -> None:
    """Draw what was told against what was true."""
    figure, axis = plt.subplots(figsize=(5.5, 5.0))
    for column, kind in enumerate(KINDS):
        axis.scatter([one.true[column] for one in areas], [one.told[column] for one in areas], label=kind)
    most = 1.3 * float(np.nanmax([np.concatenate([one.true, one.told]) for one in areas]))
    line = np.array([0.0, most])
    axis.plot(line, line, color="0.5")
    axis.fill_between(line, (1.0 - WITHIN) * line, (1.0 + WITHIN) * line, color="0.9", zorder=0)
    axis.set(xlim=(0.0, most), ylim=(0.0, most), xlabel="true error, m", ylabel="told, m")
    axis.legend()
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def run(options: Options, progress: Progress) -> Figures:
    """Return how right what areas tell of themselves is."""
    found = in_parallel(try_world, list(WORLDS.items()), options.jobs, progress, "worlds")
    areas = [area for world in found for area in world]
    draw_told(areas, options.picture)
    return told_figures(areas)


EXPERIMENT = Experiment(
    name="self-report",
    question="Does an area tell rightly how far off its named positions are?",
    kind="twin",
    scenario="construction and museum",
    run=run,
    made="""A quarter of an hour of both building sites and the museum at their test seeds, the shipped tracker, nothing
learned. What learning tells of each area at the end (judged by what phones said after a name was told) against the true
errors of all named positions in view: of each kind the share of areas that told it at all, the share of those within
25 %, and by how much the worst was off. Learning keeps p90 to itself where the share of wrong names decides it.""",
    at_least={"rms_within": 1.0, "p50_within": 1.0, "p90_within": 1.0},
    picture="Told against true, metres; grey: within 25 %.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
