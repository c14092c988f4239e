"""What does learning gain on the two building sites of the twin? The study's ladder, and whether lessons are right."""

from __future__ import annotations

import pickle
import sys
import tempfile
from pathlib import Path

from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options, Study, in_parallel
from benchmarks.learning_detections import configured_rate, seen_again
from benchmarks.learning_figures import ladder_figures, lesson_figures, rate_figures
from benchmarks.learning_ladder import RATES, Climb, climb
from benchmarks.learning_picture import draw_learning
from benchmarks.learning_splits import splits
from benchmarks.twin_scores import used_access_points
from benchmarks.world_run import load, record_world, with_access_points

__all__ = ["EXPERIMENT", "main"]

TRIALS = ("construction-1", "construction-2")
ACCESS_POINTS = 6
"""Of twelve, as in the study."""
LADDER = "[ravel-thesis §11.4]"


def make_world(trial: str, seed: int, folder: Path) -> None:
    """Make a trial's world once, for all that is learned in it."""
    scenario, site = load(trial)
    for area, record in record_world(scenario, site, seed).items():
        chosen = with_access_points(record, used_access_points(record, ACCESS_POINTS))
        (folder / f"{trial}-{area}.pickle").write_bytes(pickle.dumps(chosen))


def climb_area(trial: str, seed: int, area: str, folder: Path) -> Climb:
    """Return the ladder of one area of a trial."""
    scenario, site = load(trial)
    # Written by this very run, in a folder of its own.
    record = pickle.loads((folder / f"{trial}-{area}.pickle").read_bytes())
    seen = seen_again(scenario, site, seed, area, RATES, scenario.duration)
    return climb(record, seen, splits(scenario.duration), configured_rate(scenario))


def run(options: Options, progress: Progress) -> Figures:
    """Return ``trial1_p70_none`` … of both trials, or of the one asked for, and how right each lesson was."""
    trials = TRIALS if options.scenario == "construction" else (options.scenario,)
    worlds = [(trial, options.seed or load(trial)[0].seeds.test) for trial in trials]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        in_parallel(make_world, [(*world, folder) for world in worlds], options.jobs, progress, "worlds")
        cells = [(trial, seed, area.id, folder) for trial, seed in worlds for area in load(trial)[1].areas]
        climbs = in_parallel(climb_area, cells, options.jobs, progress, "areas")
    by_trial = {
        trial: [found for cell, found in zip(cells, climbs, strict=True) if cell[0] == trial] for trial in trials
    }
    draw_learning(by_trial, options.picture)
    figures: dict[str, float | None] = {}
    for trial, areas in by_trial.items():
        prefix = f"trial{trial[-1]}"
        figures |= ladder_figures(areas, prefix) | rate_figures(areas, prefix)
    return figures | lesson_figures(climbs)


EXPERIMENT = Experiment(
    name="learning",
    question="What does each lesson gain on the two building sites, and how right are lessons?",
    kind="twin",
    scenario="construction",
    scenarios=TRIALS,
    run=run,
    made="""45-minute runs of `construction-1` and `construction-2` at their test seeds (`--seed 0`), 6 of 12 access
points. Five splits, spread evenly and overlapping: 20 minutes teach, the 10 that follow judge, with a fresh tracker.
Every stage keeps what the one before learned. `none`: as found. `detector`: each camera's background learns at the
rate whose tracks have the best cumulative quality score over the last 5 minutes of training, of six; the twin
makes the detections of the same people again by the fading law fitted to the real detector. `radio`: learned from the
training part's own good tracks. `all`: with each phone's own stride line as well, where it proved better. Nothing is
taught by the truth. RMSE of each carrier in each minute over the times in view, both areas and all splits together;
`_rbmcda` is the study's particle filter, the rest the shipped tracker. `gain` is the share by which a stage lowers an
error of the stage before. `rate_loss`: by which share the chosen rate's true error is above the best rate's.

`radio_rmse_db`: heard minus foretold at true places of the test parts, each phone's mean taken off; `excess` over a
model fitted to the training parts' true places. `stride_error`: of the learned lines about
the way carriers truly went in runs of six steps; `stride_way_error`: over all steps, also half ones and on the spot.
`quality_spearman`: rank correlation of quality with true RMSE over each phone's minutes of the training parts, as the
filter follows it: wrong names and times out of view count. The printed sum grows with the time told; `per_s` does not.
`good_tracks`: share of minute-long stretches that may teach; `…_tracks_p90` of the RMSE of these and of the others.""",
    at_most={"radio_rmse_excess_db": 0.5, "stride_error": 0.04},
    studies={
        "trial1_p70_none_rbmcda": Study(1.0, LADDER),
        "trial1_p90_none_rbmcda": Study(1.4, LADDER),
        "trial1_p70_detector_rbmcda": Study("about 0.7", LADDER),
        "trial1_p90_detector_rbmcda": Study("about 1.2", LADDER),
        "trial1_p90_radio_rbmcda": Study("just below 1", LADDER),
        "trial1_p70_gain_all_rbmcda": Study(0.18, LADDER),
        "trial2_p90_none_rbmcda": Study(1.6, LADDER),
        "trial2_p70_detector_rbmcda": Study(0.8, LADDER),
        "trial2_p90_gain_detector_rbmcda": Study(0.26, LADDER),
        "trial2_p90_radio_rbmcda": Study("below 1", LADDER),
        "trial2_p70_gain_all_rbmcda": Study(0.13, LADDER),
    },
    difference="""real sites, and splits that are not published; its detector step replays video, ours the twin's
detections.""",
    picture="Errors stage by stage (dots: the original study), learning rate, quality against true error.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
