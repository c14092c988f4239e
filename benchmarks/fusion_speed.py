"""How quick is fusion in a full hall, on how much memory, and how quick is a cycle of the particle filter?"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.fusion_live import LiveRun, latency_of, memory_slope, run_live
from benchmarks.fusion_load import Said, thinned
from benchmarks.rbmcda_speed import Crowding, cycle_seconds, oracle_seconds
from benchmarks.world_run import load, record_world
from services.cli.demo import find_site

__all__ = ["EXPERIMENT", "crowd_figures", "cycle_figures", "main"]

SECONDS = 90.0
"""Of the crowd's world."""
WARM_UP = 5.0
"""Seconds not timed: three hundred people are there at once, and the process has just begun."""
CYCLE, FULL_CYCLE = Crowding(300, 12, 15), Crowding(100, 200, 200)
HOUR = 3600.0
THIN = 5
"""Of the hour's load one of so many frames and scans is sent, which lets it pass in minutes."""


def run(options: Options, progress: Progress) -> Figures:
    """Make the crowd's world, send it by the clock, then an hour of it as fast as it is consumed."""
    scenario, site = load(options.scenario)
    area = site.areas[0].id
    tasks = [progress.add_task(what, total=total) for what, total in (("world", SECONDS), ("live", SECONDS))]
    world = record_world(
        scenario, site, options.seed, seconds=SECONDS, progress=lambda t: progress.update(tasks[0], completed=t)
    )
    said = world[area].arrivals
    place = find_site(options.scenario), site.site, area
    live = run_live(*place, said, progress=lambda t: progress.update(tasks[1], completed=t), period=SECONDS)
    hour = run_hour(place, said, progress)
    draw(live, hour, options.picture)
    return cycle_figures() | crowd_figures(live, hour)


def cycle_figures() -> dict[str, float | None]:
    """Return the times of the particle filter's cycles, and how many times as long the tests' oracle takes."""
    cycle = cycle_seconds(CYCLE)
    return {
        "cycle_300x12x15_ms": cycle * 1000.0,
        "cycle_100x200x200_ms": cycle_seconds(FULL_CYCLE) * 1000.0,
        "speedup_over_oracle": oracle_seconds(CYCLE) / cycle,
    }


def run_hour(place: tuple[Path, str, str], said: Sequence[tuple[float, Said]], progress: Progress) -> LiveRun:
    """Send an hour of event time, the same minutes again and again, as fast as fusion consumes it."""
    task = progress.add_task("an hour", total=HOUR)
    return run_live(
        *place,
        thinned(said, THIN),
        progress=lambda t: progress.update(task, completed=t),
        period=SECONDS,
        rounds=round(HOUR / SECONDS),
        clock=False,
    )


def crowd_figures(live: LiveRun, hour: LiveRun, warm_up: float = WARM_UP) -> dict[str, float | None]:
    """Return the figures of a load by the clock and of an hour.

    Args:
        live: what was seen under the load by the clock; ``hour``: under the long one.
        hour: see above.
        warm_up: seconds of ``live`` not timed; what is dropped counts from the beginning.
    """
    latency = latency_of(live)
    timed = np.array(live.sent.sent) >= live.sent.sent[0] + warm_up
    p50, p99 = np.percentile(latency.seconds[timed], [50, 99], method="higher") * 1000.0
    closing = latency.closing[latency.closing_sent >= live.sent.sent[0] + warm_up]
    return {
        "crowd_p50_ms": float(p50),
        "crowd_p99_ms": float(p99),
        "crowd_last_frame_p50_ms": float(np.median(closing)) * 1000.0,
        "crowd_drop_share": latency.drop_share,
        "crowd_rss_mb": float(max(live.memory[:, 1].max(), hour.memory[:, 1].max())),
        "crowd_rss_mb_per_h": memory_slope(hour.memory),
        "crowd_fusion_cpu_share": live.cpu_share,
        "crowd_fusion_waited_share": live.waited_share,
        "crowd_generator_cpu_share": live.sent.cpu_share,
        "crowd_generator_late_p99_ms": float(np.percentile(live.sent.late, 99)) * 1000.0,
    }


def draw(live: LiveRun, hour: LiveRun, picture: Path) -> None:
    """Draw how latencies are distributed and how memory goes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    latency = latency_of(live)
    timed = np.array(live.sent.sent) >= live.sent.sent[0] + WARM_UP
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for name, seconds in (
        ("every detection message", latency.seconds[timed]),
        ("the last of each chunk", latency.closing),
    ):
        ordered = np.sort(seconds) * 1000.0
        left.plot(ordered, np.arange(1, len(ordered) + 1) / len(ordered), label=name)
    for bar, share in ((50.0, 0.5), (100.0, 0.99)):
        left.plot(bar, share, "k+", markersize=12)
    left.set(xscale="log", xlabel="from detection sent to tracks received, ms", ylabel="share of messages")
    left.legend(loc="lower right")
    right.plot(hour.memory[:, 0] / 60.0, hour.memory[:, 1], label="an hour, thinned, faster than real time")
    right.plot(live.memory[:, 0] / 60.0, live.memory[:, 1], label="by the clock")
    right.axhline(500.0, color="k", linewidth=0.8)
    right.set(xlabel="event time, min", ylabel="resident memory of fusion, MB", ylim=(0.0, None))
    right.legend(loc="lower right")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


EXPERIMENT = Experiment(
    name="fusion-speed",
    question="How quick is fusion in a full hall, on how much memory, and how quick is a cycle of the particle filter?",
    kind="speed",
    scenario="crowd",
    seed=52,
    run=run,
    made="""`crowd`: 300 people, 100 phones, four cameras of 15 frames/s, made beforehand and sent by a process of
its own, each message when it is due, over a Zenoh router to `python -m services.fusion` as it ships, its state saved
every few seconds. Latency is from the send stamp of each detection message to the receipt of the tracks of the chunk
that contains it, by the trace ids in the chunk marks; the first five seconds are not timed. A message that is in no
chunk is dropped and took for ever. `crowd_last_frame_p50_ms` is from the last message of each chunk. Memory is that
of the process, the greatest of the run by the clock and of an hour of event time: the same 90 seconds again and
again, every fifth frame and scan of them, as fast as it is consumed; `crowd_rss_mb_per_h` is the slope over the
hour's second half. All runs on one machine: `crowd_fusion_waited_share` says how long fusion had work and no core,
which a quiet machine keeps near zero, and without which the latencies mean little. `cycle_300x12x15_ms` is the median
time of a whole step of `rbmcda`, messages in, tracks out, with 300 particles, 12 phones and 15 people seen,
`cycle_100x200x200_ms` likewise; `speedup_over_oracle` is how many times as long the plain loops on `filterpy` take
that the tests hold it to, timed on three particles.""",
    at_least={"speedup_over_oracle": 100.0},
    at_most={
        "cycle_300x12x15_ms": 20.0,
        "cycle_100x200x200_ms": 250.0,
        "crowd_p50_ms": 50.0,
        "crowd_p99_ms": 100.0,
        "crowd_drop_share": 0.001,
        "crowd_rss_mb": 500.0,
        "crowd_rss_mb_per_h": 10.0,
    },
    picture="Latency of every detection message (crosses: the bars) and resident memory over an hour of event time.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
