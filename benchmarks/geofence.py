"""Are zones told right and soon, and how many positions a second? Beside plain methods in the same run."""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.progress import Progress

from benchmarks.border_walks import Score, courses_over, eth_walks, loiterers, score_walks, simulated_walks
from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.geofence_latency import alert_latency
from benchmarks.geofence_speed import speeds
from benchmarks.zone_counts import minute_counts, occupancy_error

__all__ = ["EXPERIMENT", "main"]

SIMULATED = 240.0
"""Seconds of simulated walks across borders."""
LOITERERS, LOITERING = 60, 120.0
"""People who stand about borders, and seconds for which each does."""


def run(options: Options, progress: Progress) -> Figures:
    """Return the figures of borders, counts, latency and speed."""
    figures: dict[str, float | None] = {}
    steps = progress.add_task("geofence", total=4)
    figures.update(border_figures(options.seed))
    progress.advance(steps)
    counted, really = minute_counts(options.scenario, options.seed, options.more.seconds)
    figures.update(occupancy_error(counted, really))
    progress.advance(steps)
    figures.update(alert_latency(options.seed))
    progress.advance(steps)
    figures.update(speeds(options.seed))
    progress.advance(steps)
    return figures


def border_figures(seed: int) -> dict[str, float | None]:
    """Return what is missed and told twice at borders, by kind of walk and together, and how late entries are told."""
    walks = {"recorded": eth_walks(), "simulated": simulated_walks(SIMULATED, seed)}
    courses = {name: courses_over(some, seed) for name, some in walks.items()}
    walks["loitering"] = loiterers(courses["simulated"], LOITERERS, LOITERING, seed)
    courses["loitering"] = courses["simulated"]
    ours, naive = Score(), Score()
    figures: dict[str, float | None] = {}
    for name, some in walks.items():
        scores = score_walks(some, courses[name], seed)
        for total, score in zip((ours, naive), scores, strict=True):
            total.add(score)
        figures[f"missed_crossings_{name}"] = scores[0].missed
        figures[f"duplicate_enters_{name}"] = scores[0].duplicates
    late = np.array(ours.delays)
    return figures | {
        "crossings": ours.crossings,
        "missed_crossings": ours.missed,
        "duplicate_enters": ours.duplicates,
        "entry_delay_p50_s": float(np.median(late)),
        "entry_delay_p95_s": float(np.percentile(late, 95)),
        "entry_delay_max_s": float(late.max()),
        "entries_later_than_1_s": float((late > 1.0).mean()),
        "naive_missed_crossings": naive.missed,
        "naive_duplicate_enters": naive.duplicates,
    }


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, help="of the scenario in which people are counted; default: all of it")


EXPERIMENT = Experiment(
    name="geofence",
    question="Are zones told right and soon, and how many positions a second are tested against 100 of them?",
    kind="speed",
    scenario="museum",
    seed=12,
    scenarios=("hall", "crowd"),
    run=run,
    made="""*Borders*: 349 walks recorded before the ETH's main building, the first four minutes of `museum`'s walks,
and 60 people who stand for two minutes up to 30 cm beside a border and sway; areas of 2.6 m, gates of 20 cm and lines
all over the floor, turned at random; every position, 15 a second, with an error of 0.3 m along each axis of its own. A
crossing is *missed* when somebody who was 60 cm away from a border for a second, and is beyond it by 30 cm for a second
(of a line: 60 cm; of a gate: where the errors end), is not told within two seconds of that; *duplicates* are all enters
and crossings beyond those that were, an area counting as entered from 10 cm beside it on. Nobody is asked for crossings
within 90 cm of the ends of a line. Delays are from the border to the alert, of those who walk in and do not dawdle on
the border: 30 cm deep within 0.6 s. `naive_`: each position alone, in the polygon or not. *Counts*: people in the
site's zones by fusion's tracks beside the truth, means of each minute; the error of a minute is that of all zones by
all people in them. *Latency*: 300 people at 15 frames/s against 100 zones with every kind of rule, over a Zenoh router
to `python -m services.geofence`, from a frame being sent to each of its alerts being received. *Speed*: 10 000 people
in a hall of 100 x 60 m with 90 areas of eight corners and ten lines, state kept and every step tested, one core;
`naive_` and `strtree_`: shapely's polygons one by one, and by its tree, without state, steps or distances.""",
    at_least={"positions_per_s": 1_000_000.0},
    at_most={
        "missed_crossings": 0.0,
        "duplicate_enters": 0.0,
        "entry_delay_p95_s": 1.0,
        "alert_p99_ms": 100.0,
        "occupancy_error": 0.1,
    },
    arguments=_arguments,
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
