"""Is a visitor who stands before an exhibit told of that one? What a guide app would be answered, beside the truth."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.fusion_run import run_fusion
from benchmarks.world_run import EPOCH, TRUTH_EVERY, load, record_world
from services.api.in_front import InFront, Visitor, in_front
from services.api.live_state import LiveState
from services.simulator.people import BLOCK
from services.simulator.scenario_file import Scenario
from services.simulator.world import World
from shared.messages import TrackFrame
from shared.site import Site

__all__ = ["EXPERIMENT", "main"]

Array = NDArray[np.float64]

SECONDS = 900.0
VIEW = math.radians(120.0)
REACH = 8.0
"""Metres, as of an exhibit that says nothing else."""
NEAR = 1.4
"""Metres from the edge of what somebody looks at."""
TOWARDS = math.radians(50.0)
"""Between where the body faces and the middle of what somebody looks at."""
STANDS = 0.2
"""Metres per second, over 1.4 s."""
KEPT = 120.0


@dataclass(frozen=True, slots=True)
class _Standing:
    """One moment of somebody who stands: what the API knew, and the exhibit they look at; -1: none."""

    visitor: Visitor
    looks_at: int


def run(options: Options, progress: Progress) -> Figures:
    """Return shares of ``SHARE_RULE``; the rules are ours and that of the last walk."""
    scenario, site = load(options.scenario)
    task = progress.add_task("world and fusion", total=SECONDS)
    area = site.areas[0].id
    record = record_world(
        scenario, site, options.seed, seconds=SECONDS, progress=lambda made: progress.update(task, completed=made)
    )[area]
    floor = site.floor(site.area(area).floor)
    exhibits = [shapely.Polygon(obstacle.polygon) for obstacle in floor.obstacles]
    moments = list(_standing(run_fusion(record).frames, scenario, site, options.seed, exhibits))
    places = np.array([exhibit.centroid.coords[0] for exhibit in exhibits])
    reach, facing, plan = np.full(len(places), REACH), np.full(len(places), np.nan), floor.plan()
    answers = [in_front(moment.visitor, VIEW, places, reach, facing, plan) for moment in moments]
    looked_at = [moment.looks_at for moment in moments]
    walkers = [replace(moment.visitor, stood=0.0) for moment in moments]
    walking = [in_front(walker, VIEW, places, reach, facing, plan) for walker in walkers]
    ours = _shares([answer.exhibit.tolist() for answer in answers], looked_at)
    nearest = [answer.exhibit[np.argsort(answer.distance, kind="stable")].tolist() for answer in walking]
    before = _shares(nearest, looked_at)
    return {
        "standing_minutes": sum(exhibit >= 0 for exhibit in looked_at) / 2.0 / 60.0,
        **{f"{name}_in_front": value for name, value in ours.items()},
        **{f"{name}_last_walk": value for name, value in before.items()},
        **_honesty(answers, looked_at),
    }


def _standing(
    frames: Sequence[TrackFrame], scenario: Scenario, site: Site, seed: int, exhibits: Sequence[shapely.Polygon]
) -> Iterator[_Standing]:
    """Yield carriers who stand, at each frame at which they are located."""
    world = World(scenario, site, seed)
    device = world.devices
    times = TRUTH_EVERY * np.arange(round(BLOCK / TRUTH_EVERY))
    made = [world.people.movement(start + times) for start in np.arange(0.0, SECONDS, BLOCK)]
    position, heading, speed = (
        np.concatenate([getattr(block, name) for block in made]) for name in ("position", "heading", "speed")
    )
    live = LiveState(site, KEPT, KEPT)
    for frame in frames:
        live.take_tracks(frame, frame.t)
        now = round((frame.t - EPOCH) / TRUTH_EVERY)
        if now >= len(position):
            return
        for person, name in enumerate(world.people.persons):
            told = live.position(device[name], frame.t) if name in device else None
            if told is None or told.state == "lost":
                continue
            if not speed[max(0, now - 3) : now + 4, person].max() < STANDS:
                continue
            walked = live.heading(told.device)
            towards, since = walked or (None, told.t)
            visitor = Visitor((told.x, told.y), told.accuracy, towards, told.t - since)
            yield _Standing(visitor, _looked_at(position[now, person], heading[now, person], exhibits))


def _looked_at(place: Array, facing: float, exhibits: Sequence[shapely.Polygon]) -> int:
    """Return the exhibit nearest to (2,), where it is near and the body faces it; otherwise -1."""
    here = shapely.Point(place)
    distance = [exhibit.distance(here) for exhibit in exhibits]
    nearest = int(np.argmin(distance))
    middle = exhibits[nearest].centroid
    off = math.remainder(math.atan2(middle.y - place[1], middle.x - place[0]) - facing, math.tau)
    return nearest if distance[nearest] <= NEAR and abs(off) <= TOWARDS else -1


def _shares(answers: Sequence[Sequence[int]], looked_at: Sequence[int]) -> dict[str, float]:
    rows = [(answer, exhibit) for answer, exhibit in zip(answers, looked_at, strict=True) if exhibit >= 0]
    return {
        "first": float(np.mean([bool(answer) and answer[0] == exhibit for answer, exhibit in rows])),
        "among": float(np.mean([exhibit in answer for answer, exhibit in rows])),
        "empty": float(np.mean([not answer for answer, _ in rows])),
    }


def _honesty(answers: Sequence[InFront], looked_at: Sequence[int]) -> dict[str, float]:
    """Of answers whose first is told with 0.8 or more, and with less: the mean probability, and how often it is so."""
    first = np.array([answer.probability[0] if len(answer.probability) else 0.0 for answer in answers])
    right = np.array(
        [len(one.exhibit) > 0 and one.exhibit[0] == exhibit for one, exhibit in zip(answers, looked_at, strict=True)]
    )
    sure = first >= 0.8
    return {
        "told_sure": float(first[sure].mean()),
        "right_sure": float(right[sure].mean()),
        "told_unsure": float(first[~sure].mean()),
        "right_unsure": float(right[~sure].mean()),
    }


EXPERIMENT = Experiment(
    name="in-front",
    question="Is a visitor who stands before an exhibit told of that one?",
    kind="twin",
    scenario="museum",
    seed=12,
    run=run,
    made="""The first 15 minutes at the test seed; the four numbers of the rule were chosen on the training
seed. Counted are the carriers who stand, twice a second, wherever fusion says they are. They look at the
exhibit whose edge is nearest, where that is within 1.4 m and their body faces its middle to 50 degrees.
`first`: it is told first; `among`: it is told; `empty`: nothing is. `in_front` is what the API answers;
`last_walk` the rule before it: the 120 degrees about the last walk, nearest first. `told` and `right`, over all
standing moments, also before nothing: the probability of what is told first, and how often that is so, where it
is 0.8 or more (`sure`) and where it is less. Simulated visitors turn to the exhibit as they stop; how real ones
do was not recorded by anybody.""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
