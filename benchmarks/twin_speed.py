"""How fast is a world made off-line, and in how much memory? Each scenario in a process of its own."""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options

__all__ = ["EXPERIMENT", "Making", "main", "make_world", "peak_memory"]

RUNS = {"construction": ("construction-1", None), "museum": ("museum", None), "crowd": ("crowd", 60.0)}
"""Scenario by the beginning of its figures' names, and how many seconds of it; None: all."""


@dataclass(frozen=True, slots=True)
class Making:
    """What it took to make a world.

    Attributes:
        world: seconds of world that were made.
        start: seconds by the wall until the first block could be asked for: files read, fields tabulated, crowd warm.
        wall: seconds for all blocks, by the wall.
        cpu: seconds for start and blocks, of all cores together.
        memory: greatest memory of the process, MB.
    """

    world: float
    start: float
    wall: float
    cpu: float
    memory: float


def make_world(name: str, seed: int, seconds: float | None = None) -> Making:
    """Make a scenario's world to the end and forget it block by block, as ``atrium simulate`` does.

    Args:
        name: a shipped scenario's, or a file.
        seed: of everything random.
        seconds: how much of it; None: the scenario's duration.
    """
    from benchmarks.world_run import load
    from services.simulator.world import World, truth_messages

    begun, used = time.perf_counter(), time.process_time()
    scenario, site = load(name)
    world = World(scenario, site, seed)
    until = scenario.duration if seconds is None else seconds
    started = time.perf_counter()
    while world.made < until:
        truth_messages(world, world.next_block())
    ended = time.perf_counter()
    return Making(world.made, started - begun, ended - started, time.process_time() - used, peak_memory())


def peak_memory() -> float:
    """Return the greatest resident memory this process has had, MB."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Not getrusage: there a new process inherits the peak of the one that started it.
        lines = status.read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) * 1024 / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def run(options: Options, progress: Progress) -> Figures:
    """Make one world after the other, never two at once."""
    task = progress.add_task("making worlds", total=len(RUNS))
    figures: dict[str, float | None] = {}
    for prefix, (name, seconds) in RUNS.items():
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
            made = fresh.submit(make_world, name, options.seed, seconds).result()
        figures |= {
            f"{prefix}_seconds": made.start + made.wall,
            f"{prefix}_start_seconds": made.start,
            f"{prefix}_cpu_seconds": made.cpu,
            f"{prefix}_times_real_time": made.world / made.wall,
            f"{prefix}_memory_mb": made.memory,
        }
        progress.advance(task)
    return figures


EXPERIMENT = Experiment(
    name="twin-speed",
    question="How fast is the twin made, and in how much memory?",
    kind="speed",
    scenario="construction-1, museum, crowd",
    seed=1,
    run=run,
    made="""Each scenario is made off-line in a fresh process, one after the other, with all that is in it: people,
detections, inertial samples, radio scans, truth; `construction-1` (45 minutes) and `museum` (40 minutes) wholly, of
`crowd` one minute. `seconds` are by the wall from the scenario file to the last block, `start_seconds` those before the
first block; `times_real_time` is of the blocks alone, world seconds per second by the wall; `cpu_seconds` is the work,
whatever else the machine did meanwhile. `memory_mb` is the greatest resident memory, libraries included.""",
    at_most={"construction_seconds": 60.0, "construction_memory_mb": 1000.0, "crowd_memory_mb": 1000.0},
    at_least={"crowd_times_real_time": 5.0},
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
