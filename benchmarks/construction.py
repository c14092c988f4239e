"""How well does fusion find five workers among twelve on the two building sites of the twin? Beside plain methods."""

from __future__ import annotations

import sys

from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options, Study, in_parallel
from benchmarks.twin_scores import TwinScores, draw_cdfs, figures_of, score_twin
from benchmarks.world_run import load

__all__ = ["EXPERIMENT", "main"]

SITE = "[ravel-thesis §11.3]"
TRIALS = ("construction-1", "construction-2")
STUDY = {"construction-1": {"radio": 3.1, "vision": 2.3}, "construction-2": {"radio": 2.9, "vision": 2.5}}
"""90 % errors, metres."""
ACCESS_POINTS = 6
"""Of twelve, as in the study: what the tracker is given."""
TAUGHT = 1200.0
"""Seconds for which other people teach the site's radio."""


def score_trial(scenario: str, seed: int) -> TwinScores:
    """Return the errors of every method in one trial."""
    return score_twin(scenario, seed, access_points=ACCESS_POINTS, taught=TAUGHT)


def run(options: Options, progress: Progress) -> Figures:
    """Return ``trial1_p50_METHOD`` … of both trials, or of the one asked for."""
    trials = TRIALS if options.scenario == "construction" else (options.scenario,)
    cells = [(trial, options.seed or load(trial)[0].seeds.test) for trial in trials]
    scores = dict(zip(trials, in_parallel(score_trial, cells, options.jobs, progress, "trials"), strict=True))
    draw_cdfs(scores, options.picture, STUDY)
    figures: dict[str, float | None] = {}
    for trial, score in scores.items():
        figures.update(figures_of(score, f"trial{trial[-1]}"))
    return figures


EXPERIMENT = Experiment(
    name="construction",
    question="Where are the five workers with phones, on two building sites?",
    kind="twin",
    scenario="construction",
    scenarios=TRIALS,
    run=run,
    made="""Whole 45-minute runs of `construction-1` and `construction-2` at their test seeds (`--seed 0`; a gate of
the test suite watched the first 90 s of one until these figures), both areas of a trial together: RMSE of each carrier
in each minute, over the times in view. `evidence` (the shipped tracker), `rbmcda` (the study's particle filter, 100
particles) and `forces` (the same with social forces) are causal, with 6 of the 12 access points, radio constants
unknown, steps from raw inertial samples through the gateway's own dead reckoning; where one gives a phone no position
the last one is held. `evidence_warm` is `evidence` where 20 minutes of other people in the same radio world, on a day
of their own, taught it the site's radio before, in one round, through the tracker's own tracks and names, without
truth. `rbmcda` takes one cycle a second, of the people whom the anonymous layer follows from frame to frame, holds
walks against their paths once phones have told them, carries what each access point is off in its state, and weighs
every device by itself; the study published none of this. `radio` (Horus, 12 access points, surveyed), `vision` (RBMCDA
once a second) and `cv` (nearest neighbour, every frame) are the plain methods of `anchors`; anonymous tracks are
matched to people minute by minute, with the truth's help, which the trackers do not have. `evloc` pairs `cv` tracks
with phones minute by minute.""",
    studies={
        "trial1_p70_rbmcda": Study("≲ 1", SITE),
        "trial1_p90_rbmcda": Study(1.4, SITE),
        "trial1_p90_vision": Study(2.3, SITE),
        "trial1_p90_radio": Study(3.1, SITE),
        "trial2_p70_rbmcda": Study("≲ 1", SITE),
        "trial2_p90_rbmcda": Study(1.6, SITE),
        "trial2_p90_vision": Study(2.5, SITE),
        "trial2_p90_radio": Study(2.9, SITE),
    },
    difference="""real sites, helmets tracked for the truth. Its workers stayed in view; ours come and go between two
areas.""",
    picture="Errors in a minute in both trials; the thick line is the shipped tracker, dots are the original study.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
