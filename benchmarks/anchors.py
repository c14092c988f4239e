"""Is the twin as hard as the sites of the original studies? Plain methods alone, on the train seeds.

An easy world would make every figure flattery. So the noise of ``museum`` and both ``construction`` trials was chosen,
before any identity tracker was scored in them, such that the plain methods land where the studies had them.
"""

from __future__ import annotations

import sys

import numpy as np
from rich.progress import Progress

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options, Study, in_parallel
from benchmarks.position_error import percentiles
from benchmarks.twin_scores import TwinScores, draw_cdfs, score_twin
from benchmarks.world_run import load

__all__ = ["ANCHORS", "EXPERIMENT", "main"]

SITE = "[ravel-thesis §11.3]"
ANCHORS = {
    "construction-1": {"radio": Study(3.1, SITE), "vision": Study(2.3, SITE)},
    "construction-2": {"radio": Study(2.9, SITE), "vision": Study(2.5, SITE)},
    "museum": {"evloc": Study(2.1, "[ravel-thesis §11.2]")},
}
"""The 90 % errors of the studies, metres, by scenario and method."""
WITHIN = 0.2
WORLDS = 3
"""Seeds per scenario: the train seed, and that plus 100 and 200; one world's luck anchors nothing."""


def score_plain(scenario: str, seed: int) -> TwinScores:
    """Return the errors of the plain methods in one world."""
    return score_twin(scenario, seed, fusion=False)


def run(options: Options, progress: Progress) -> Figures:
    """Return 50, 70 and 90 % errors of every plain method, scenario by scenario, all worlds of a scenario together."""
    cells = []
    for scenario in ANCHORS:
        described, _ = load(scenario)
        if options.seed in range(described.seeds.test, described.seeds.test + 100 * WORLDS, 100):
            raise ExperimentError(f"--seed {options.seed}: nothing is anchored on a test seed ({scenario}'s)")
        first = options.seed or described.seeds.train
        cells += [(scenario, first + 100 * world) for world in range(WORLDS)]
    scores = in_parallel(score_plain, cells, options.jobs, progress, "worlds")
    figures: dict[str, float | None] = {}
    pooled: dict[str, TwinScores] = {}
    for scenario in ANCHORS:
        mine = [score for cell, score in zip(cells, scores, strict=True) if cell[0] == scenario]
        together = TwinScores({name: np.concatenate([one.errors[name] for one in mine]) for name in mine[0].errors})
        pooled[scenario] = together
        for method, errors in together.errors.items():
            for share, value in zip(("p50", "p70", "p90"), percentiles(errors), strict=True):
                figures[f"{_prefix(scenario)}_{share}_{method}"] = value
        for method in ANCHORS[scenario]:
            worlds = [percentiles(one.errors[method])[2] or np.nan for one in mine]
            figures[f"{_prefix(scenario)}_p90_{method}_least"] = float(np.min(worlds))
            figures[f"{_prefix(scenario)}_p90_{method}_most"] = float(np.max(worlds))
    studies = {name: {method: float(study.value) for method, study in found.items()} for name, found in ANCHORS.items()}
    draw_cdfs(pooled, options.picture, studies)
    return figures


def _prefix(scenario: str) -> str:
    return scenario.replace("-", "")


STUDIES = {
    f"{_prefix(scenario)}_p90_{method}": study for scenario, found in ANCHORS.items() for method, study in found.items()
}

EXPERIMENT = Experiment(
    name="anchors",
    question="Is the twin as hard as the original sites? Plain methods alone.",
    kind="twin",
    scenario="anchored",
    run=run,
    made="""Whole runs of `construction-1`, `construction-2` and `museum` at the train seeds and two more seeds
each (plus 100, plus 200); errors of all carriers' minutes in view, both areas and all seeds together. `radio` is Horus
with every access point and a survey of another day (a metre's grid, 20 scans a point, four ways), which knows the
part of the floor that the camera sees; `vision` is
RBMCDA on one frame a second, `cv` global nearest neighbour on every frame, both anonymous and matched to people
minute by minute; `evloc` joins the `cv` tracks to phones minute by minute (mean error while both are in view).
The bars are 20 % about the studies' figures
and hold for the worlds together: single ones scatter beyond them; `least` and `most` are those of the single seeds.
The scenarios
were then frozen (`tests/unit/simulator/test_frozen_scenarios.py`).""",
    studies=STUDIES,
    difference="""the studies' figures are of real sites; here people, cameras and radio are simulated, the carriers
leave and enter the view more often, and the survey of the radio-only method is a day old. How anonymous tracks were
matched to people is unpublished. `cv` has no counterpart: the study's vision-only method worked once a second.""",
    at_least={name: round((1.0 - WITHIN) * float(study.value), 3) for name, study in STUDIES.items()},
    at_most={name: round((1.0 + WITHIN) * float(study.value), 3) for name, study in STUDIES.items()},
    picture="Errors of plain methods in three scenarios of the twin; the grey line is the 90 % read off.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
