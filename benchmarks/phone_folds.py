"""Score trackers on emulated phones: the part that the experiments with emulated phones have in common.

A ``Split`` says what is run, from when and for whom it counts, and whose phones, in another span of time of the same
radio world, teach a warmed-up site beforehand.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from rich.progress import Progress

from benchmarks.experiment import ExperimentError, Options, in_parallel
from benchmarks.fusion_run import FusionRun, run_fusion
from benchmarks.phone_scores import PhoneScore, followed, score_phones
from benchmarks.phones_on_tracks import HARSH, RADIO, without_motion
from benchmarks.radio_training import train_radio, warmed_up
from benchmarks.revised import said_later, said_live
from benchmarks.world_record import Truth, WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER, TRACKERS
from services.simulator.radio.radio_world import RadioParameters

__all__ = [
    "EMULATED",
    "EVERY",
    "LAG",
    "POINTS",
    "SCORED",
    "Case",
    "Scores",
    "Split",
    "Splits",
    "add_options",
    "draw_curves",
    "measure",
    "score_run",
]

LAG = 5.0
"""Seconds for which fusion may think again."""
SEEDS = 3
"""Phone seeds of one run of an experiment: the one asked for and those after it."""
POINTS = (6, 3, 12)
EVERY = (1.0, 5.0, 30.0)
"""Access points, and seconds between scans; the first is the usual one."""

EMULATED = """\
Phones are emulated: the radio world of the twin with shadowing of 4 dB over 3 m, white noise of 2.2 dB, path-loss
constants off by 3 dB and 0.2 and phones by 3 dB; steps with 8 % error of length for the walk and for each step, 4 %
missed, headings off by 12° a walk, wandering by 5°, and 8° each step. By how much this world's constants, places and
phones are off, trackers are not told; but how large such errors are in general, they assume, and about right: shadowing
of 4 dB over 3 m and phones of 3 dB are their defaults too, and steps come with their true variances. `new_harsh` is
where radio is worse than they assume: 6 dB over 1.5 m, white noise of 3.5 dB, phones off by 3.5 dB. A phone
is heard eight seconds before and after its view as well. Three phone seeds together; `least` and `most` are of
single seeds. Settings of the identity layer and of radio training were chosen with other phone seeds, on training
worlds and on these recordings too; meanwhile a regression gate watched seed 100 on the PETS clip (now another)."""
"""How phones come about, for the results page; ``SCORED`` likewise, how they are scored."""
SCORED = """\
`idf1` is F1 of located trajectories: label fixed, gate 1 m, all times of all carriers in view. A place is claimed by
a name on a track, and by a place told without a camera whose own standard deviation is within the gate. A wrong claim
counts against, in view or not; a right one out of view counts neither way: where phones are then is known for eight
seconds, and later any claim is wrong. `in_view` is laxer: claims without a camera count in view only, those with one
always. `precision` and `recall` are of names once a second; who a track is, is whom it follows most of a second before
and after. `live` is what was said at once, `5s` what was known five seconds later. `radio` leaves the steps out;
`points` and `every` vary access points and seconds between scans."""

Scores = Mapping[str, PhoneScore]
"""By ``live`` and ``5s``."""


@dataclass(frozen=True)
class Split:
    """One run and its teachers.

    Attributes:
        test: the span of time that is run; it may begin a little before ``start``, so that nobody begins cold.
        start: from when scores count, seconds since the epoch.
        devices: whose scores count; None: all.
        teach: the teachers' span of time, with the teachers' phones alone; None where nobody teaches.
    """

    test: WorldRecord
    start: float
    devices: Sequence[str] | None = None
    teach: WorldRecord | None = None


Splits = Callable[[int, int, float, RadioParameters], Sequence[Split]]
"""A function of a module: phone seed, access points, seconds between scans, what radio is like → the runs that are
scored together."""


@dataclass(frozen=True)
class Case:
    """What is varied: whether others' phones taught beforehand, access points, seconds between scans, whether phones
    tell of their steps, the tracker, what radio is like."""

    splits: Splits
    warm: bool = False
    points: int = POINTS[0]
    every: float = EVERY[0]
    motion: bool = True
    tracker: str = DEFAULT_TRACKER
    radio: RadioParameters = RADIO

    @classmethod
    def all(cls, whole: Splits, folds: Splits) -> dict[str, Case]:
        """Return all cases of an experiment by the ends of their figures' names.

        Args:
            whole: what is run on a site as it was found.
            folds: what is run on a warmed-up one.
        """
        cases = {}
        for name, splits, warm in (("new", whole, False), ("warm", folds, True)):
            cases[name] = cls(splits, warm)
            cases |= {f"{name}_points_{count}": cls(splits, warm, points=count) for count in POINTS[1:]}
            cases |= {f"{name}_every_{every:g}": cls(splits, warm, every=every) for every in EVERY[1:]}
        cases["new_radio"] = cls(whole, motion=False)
        cases["new_harsh"] = cls(whole, radio=HARSH)
        if "rbmcda" in TRACKERS:
            cases["new_rbmcda"] = cls(whole, tracker="rbmcda")
        return cases


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what these experiments can be asked for."""
    parser.add_argument("--only", nargs="+", metavar="CASE", help="measure these alone, for example: new warm")


def measure(cases: Mapping[str, Case], options: Options, progress: Progress) -> dict[str, float | None]:
    """Return the figures of all cases (or of ``--only`` some), three phone seeds each; "new" and "warm" in full."""
    only = getattr(options.more, "only", None)
    if only and options.out is None:
        raise ExperimentError("benchmarks/results holds all cases; add --out FOLDER where only some are wanted")
    cases = {name: case for name, case in cases.items() if not only or name in only}
    seeds = range(options.seed, options.seed + SEEDS)
    cells = [(case, seed) for case in cases.values() for seed in seeds]
    scored = in_parallel(score_case, cells, options.jobs, progress)
    figures: dict[str, float | None] = {}
    for number, name in enumerate(cases):
        whole = _figures(scored[number * SEEDS : (number + 1) * SEEDS], name)
        kept = ("idf1_live", "idf1_5s", "precision_5s", "recall_5s")
        short = {f"{kind}_{name}": whole[f"{kind}_{name}"] for kind in kept}
        figures |= whole if name in ("new", "warm") else short
    return figures


def score_case(case: Case, seed: int) -> Scores:
    """Score one case with one phone seed."""
    scores = []
    for split in case.splits(seed, case.points, case.every, case.radio):
        test = split.test if case.motion else without_motion(split.test)
        view = AreaView.of(test.site, test.area)
        if case.warm and split.teach is not None:
            teach = split.teach if case.motion else without_motion(split.teach)
            view = warmed_up(view, train_radio(teach, case.tracker))
        scores.append(score_run(test, tracker=case.tracker, view=view, start=split.start, devices=split.devices)[0])
    return _together(scores)


def score_run(
    record: WorldRecord,
    *,
    tracker: str = DEFAULT_TRACKER,
    view: AreaView | None = None,
    start: float | None = None,
    devices: Sequence[str] | None = None,
) -> tuple[Scores, FusionRun]:
    """Run a tracker over a record and score it, live and after ``LAG`` seconds of revision.

    Args:
        record: what its sensors said.
        tracker: its name.
        view: what it knows beforehand; None: the site file.
        start: from when scores count; None: from the beginning.
        devices: whose scores count; None: all.
    """
    run = run_fusion(record, tracker, view=view)
    truth = record.truth
    if start is not None:
        kept = truth.t >= start
        truth = Truth(truth.t[kept], truth.person, truth.device, truth.position[kept], truth.in_view[kept])
    whom = followed(truth, run.frames)
    carried = [truth.device[place] or "" for place in truth.carriers()]
    said = {
        "live": said_live(truth.t, carried, run.frames),
        "5s": said_later(truth.t, carried, run.frames, run.revisions, LAG),
    }
    return {name: score_phones(truth, whom, one, devices) for name, one in said.items()}, run


def _together(scores: Sequence[Scores]) -> Scores:
    return {name: PhoneScore.together([one[name] for one in scores]) for name in ("live", "5s")}


def _figures(runs: Sequence[Scores], name: str) -> dict[str, float | None]:
    """Return the figures of all runs together, ``idf1_live_NAME`` and so on, and the least and most IDF1 of a run.

    The time to the first right name is of what was said live: it has no other form.
    """
    whole = _together(runs)
    figures = whole["live"].figures(f"live_{name}") | whole["5s"].figures(f"5s_{name}")
    for part in ("seconds_to_identify", "seconds_to_identify_p90", "never_identified"):
        figures[f"{part}_{name}"] = figures.pop(f"{part}_live_{name}")
        del figures[f"{part}_5s_{name}"]
    for said in ("live", "5s"):
        each = np.array([run[said].f1 for run in runs])
        figures |= {f"idf1_{said}_{name}_least": float(each.min()), f"idf1_{said}_{name}_most": float(each.max())}
    return figures


def draw_curves(figures: Mapping[str, float | None], title: str, path: Path) -> None:
    """Write the figure as PNG: F1 of located trajectories against access points and against the time between scans."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    picture, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True)
    for color, site in enumerate(("new", "warm")):
        for line, said in (("--", "live"), ("-", "5s")):
            label = f"{'as found' if site == 'new' else 'warmed up'}, {'live' if said == 'live' else 'after 5 s'}"
            for axes, kind, values in ((left, "points", POINTS), (right, "every", EVERY)):
                names = [site if value == values[0] else f"{site}_{kind}_{value:g}" for value in values]
                known = [
                    (value, figures[f"idf1_{said}_{name}"])
                    for value, name in sorted(zip(values, names, strict=True))
                    if f"idf1_{said}_{name}" in figures
                ]
                axes.plot(*zip(*known, strict=True), f"o{line}", color=f"C{color}", label=label) if known else None
    left.set(xlabel="access points", ylabel="F1 of located trajectories", ylim=(0.0, 1.0), xticks=sorted(POINTS))
    right.set(xlabel="seconds between scans", xscale="log", xticks=EVERY, xticklabels=[f"{s:g}" for s in EVERY])
    left.legend(frameon=False, loc="lower right")
    picture.suptitle(title)
    picture.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.savefig(path, dpi=90)
    plt.close(picture)
