"""How soon is a site that learns as good again as before something changed? A wall is built, an access point moves.

The same people walk in two worlds, one of which changes; a tracker that learned the site's radio from other people runs
over both, and over the changed one once more while learning goes on. What the errors have in common (who stands where,
who was mistaken for whom) is the same in all, so their ratio tells what the change costs.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options, in_parallel
from benchmarks.fusion_run import run_fusion
from benchmarks.learning_adapter import Teacher
from benchmarks.position_error import centre_of, hold
from benchmarks.radio_training import learn_from_run, warmed_up
from benchmarks.track_reading import named_positions
from benchmarks.twin_scores import used_access_points
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import load, record_world, with_access_points
from services.fusion.area_view import AreaView
from services.fusion.chunks import Chunker, ChunkerSettings, period_of
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Retuning
from services.simulator.radio.radio_changes import MovedAccessPoint, NewWall, RadioChange
from services.simulator.scenario_file import DetectedView, Scenario
from shared.messages import MotionBatch, RadioScan, TrackFrame

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["CHANGES", "EXPERIMENT", "Recovery", "draw_recovery", "live", "main", "recover", "recovery_figures"]

Array = NDArray[np.float64]

CHANGED, END = 600.0, 1500.0
"""Seconds: when something changes, and when the run ends."""
CHANGES: dict[str, list[RadioChange]] = {
    "construction-1": [
        NewWall(at=CHANGED, kind="wall", line=[(1.0, 2.6), (5.0, 2.6)], floor="ground", loss=8),
        MovedAccessPoint(at=CHANGED, kind="moved", access_point="ap-1", position=(14.0, 6.0, 2.5)),
    ],
    "construction-2": [
        NewWall(at=CHANGED, kind="wall", line=[(22.0, 1.0), (22.0, 2.8)], floor="ground", loss=8),
        MovedAccessPoint(at=CHANGED, kind="moved", access_point="ap-1", position=(16.0, 3.0, 2.5)),
    ],
}
TAUGHT = 600.0
"""Seconds for which other people teach the site's radio before."""
OTHERS = 1000
"""Added to the seed of a world: that of the people who teach."""
RATE = 10.0
LOOK = 1.0
"""Seconds between two looks of learning, which does then what is due."""
WINDOW = 60.0
WITHIN = 1.1
"""Times the error without a change: as good as before."""


@dataclass(frozen=True)
class Recovery:
    """Errors of one area, m, summed over carriers in view and times, by window; and how many they are of.

    Attributes:
        count: (w,) how many.
        unchanged: (w,) where nothing changes.
        frozen: (w,) where something changes and nothing is learned.
        learning: (w,) where it is.
        live: seconds since the world began at which models went live.
    """

    count: Array
    unchanged: Array
    frozen: Array
    learning: Array
    live: Sequence[float]


def recover(trial: str, seed: int) -> list[Recovery]:
    """Return how the areas of one trial recover."""
    scenario, site = load(trial)
    calm, changed = _with_changes(scenario, []), _with_changes(scenario, CHANGES[trial])
    teachers = record_world(calm, site, seed, seconds=TAUGHT, people=seed + OTHERS)
    before, after = (record_world(one, site, seed, seconds=END) for one in (calm, changed))
    return [_recovery(teachers[area], before[area], after[area]) for area in before]


def live(record: WorldRecord, tracker: str, teacher: Teacher) -> tuple[list[TrackFrame], list[float]]:
    """Return the tracks of a tracker that is taught while it runs, and when models went live."""
    machine = make_tracker(tracker, teacher.active)
    chunker = Chunker(ChunkerSettings(period=period_of(machine.cycle)))
    frames: list[TrackFrame] = []
    activated: list[float] = []
    looked = -np.inf
    for _, message in record.arrivals:
        teacher.take(message)
        match message:
            case RadioScan():
                chunker.add_scan(message, "")
                continue
            case MotionBatch():
                chunker.add_motion(message, "")
                continue
        for closed in chunker.add_frame(message, ""):
            frame = machine.step(closed.chunk)
            frames.append(frame)
            teacher.consumed(closed.chunk)
            teacher.take(frame)
            revision = machine.revision()
            if revision is not None:
                teacher.take(revision)
            if frame.t < looked + LOOK:
                continue
            looked = frame.t
            view = teacher.look(frame.t)
            if view is not None and isinstance(machine, Retuning):
                activated.append(frame.t)
                machine.retune(view)
    return frames, activated


def _recovery(teachers: WorldRecord, before: WorldRecord, after: WorldRecord) -> Recovery:
    used = used_access_points(before, 6)
    teachers, before, after = (with_access_points(record, used) for record in (teachers, before, after))
    found = AreaView.of(before.site, before.area)
    taught = learn_from_run(run_fusion(teachers, view=found), teachers.scans, found, before.site.site)
    known = warmed_up(found, taught)
    teacher = Teacher(before.site, known, DEFAULT_TRACKER)
    learning, activated = live(after, DEFAULT_TRACKER, teacher)
    count, unchanged = _sums(before, run_fusion(before, view=known).frames)
    return Recovery(
        count=count,
        unchanged=unchanged,
        frozen=_sums(after, run_fusion(after, view=known).frames)[1],
        learning=_sums(after, learning)[1],
        live=[t - float(after.truth.t[0]) for t in activated],
    )


def _sums(record: WorldRecord, frames: Sequence[TrackFrame]) -> tuple[Array, Array]:
    """Return the number of errors in each window, (w,), and their sum, m; squares would be all about wrong names."""
    truth = record.truth
    place, seen = truth.position[:, truth.carriers()], truth.in_view[:, truth.carriers()]
    scored = seen & np.isfinite(place).all(axis=2)
    said = hold(named_positions(truth, frames), centre_of(record.view))
    error = np.where(scored, np.linalg.norm(said - place, axis=2), 0.0).sum(axis=1)
    window = np.floor((truth.t - truth.t[0] + 1e-6) / WINDOW).astype(np.int64)
    count, total = (np.bincount(window, values).astype(np.float64) for values in (scored.sum(axis=1), error))
    return count, total


def recovery_figures(areas: Sequence[Recovery]) -> dict[str, float | None]:
    """Return ``recovery_s``: seconds after the change from which on errors are within a tenth of those without one.

    Of that minute, and in the mean of all that follow: one lucky minute is no recovery.
    """
    learned, frozen = ratios(areas)
    begin = round(CHANGED / WINDOW)
    after = learned[begin:]
    fine = np.array([after[number:].mean() <= WITHIN and after[number] <= WITHIN for number in range(len(after))])
    first = int(np.argmax(fine)) if fine.any() else None
    return {
        "recovery_s": None if first is None else first * WINDOW,
        "recovery_worst": float(after.max()),
        "recovery_last": float(after[-5:].mean()),
        "recovery_last_frozen": float(frozen[-5:].mean()),
        "recovery_models_live": float(np.mean([len(area.live) for area in areas])),
    }


def ratios(areas: Sequence[Recovery]) -> tuple[Array, Array]:
    """Return (w,) errors with learning and without, as multiples of the errors where nothing changed."""
    total = np.sum([area.unchanged for area in areas], axis=0)
    learned, frozen = (np.sum([getattr(area, name) for area in areas], axis=0) for name in ("learning", "frozen"))
    return learned / np.maximum(total, 1e-9), frozen / np.maximum(total, 1e-9)


def draw_recovery(trials: Mapping[str, Sequence[Recovery]], picture: Path) -> None:
    """Draw each trial's errors over time, multiples of those where nothing changed, and when models went live."""
    figure, axes = plt.subplots(1, len(trials), figsize=(7.0 * len(trials), 4.2), squeeze=False, sharey=True)
    for axis, (trial, areas) in zip(axes[0], trials.items(), strict=True):
        learned, frozen = ratios(areas)
        minutes = (np.arange(len(learned)) + 0.5) * WINDOW / 60.0
        axis.axhspan(0.0, WITHIN, color="0.92", zorder=0)
        axis.plot(minutes, frozen, "--", color="C3", label="nothing is learned")
        axis.plot(minutes, learned, "-", color="C0", label="learning goes on")
        axis.axvline(CHANGED / 60.0, color="0.5", label="a wall is built, an access point moves")
        for number, t in enumerate(t for area in areas for t in area.live):
            axis.axvline(t / 60.0, ymax=0.06, color="C2", linewidth=2, label="" if number else "a model goes live")
        axis.set(title=trial, xlabel="minutes", ylim=(0.0, None))
        axis.legend(loc="lower left", fontsize="small", framealpha=0.6)
    axes[0][0].set_ylabel("mean error, multiple of the unchanged site's")
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def _with_changes(scenario: Scenario, changes: list[RadioChange]) -> Scenario:
    views = [
        view.model_copy(update={"frames_per_s": min(RATE, view.frames_per_s)})
        for view in scenario.views
        if isinstance(view, DetectedView)
    ]
    return scenario.model_copy(update={"views": views, "radio": scenario.radio.model_copy(update={"changes": changes})})


def run(options: Options, progress: Progress) -> Figures:
    """Return ``recovery_s`` and what errors were, of both trials or of the one asked for."""
    trials = tuple(CHANGES) if options.scenario == "construction" else (options.scenario,)
    cells = [(trial, options.seed or load(trial)[0].seeds.test) for trial in trials]
    found = dict(zip(trials, in_parallel(recover, cells, options.jobs, progress, "trials"), strict=True))
    draw_recovery(found, options.picture)
    return recovery_figures([area for areas in found.values() for area in areas])


EXPERIMENT = Experiment(
    name="learning-recovery",
    question="How soon is a site that learns as good again as before a wall was built and an access point moved?",
    kind="twin",
    scenario="construction",
    scenarios=tuple(CHANGES),
    run=run,
    made="""`construction-1` and `construction-2` at their test seeds (`--seed 0`), 6 of 12 access points, ten frames a
second at most: after 10 of 25 minutes a wall is built and an access point moves. A tracker that other people taught
goes on while all of learning runs beside it at the pace of the service, and looks once a second; beside it the same
people where nothing changes, and where nothing is learned. `recovery_s`: from which minute after the change on errors
are, and stay in the mean, within a tenth of those where nothing changes; both trials and all areas together.
`recovery_worst`: the worst minute's error, `recovery_last` that of the last five minutes, as multiples.""",
    at_most={"recovery_s": 300.0},
    picture="Errors over time as multiples of the unchanged site's, with learning and without.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
