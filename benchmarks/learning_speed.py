"""What does learning cost beside a full hall, and does it grow?"""

from __future__ import annotations

import dataclasses
import resource
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from msgspec.structs import replace
from rich.progress import Progress

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.fusion_run import chunks_of, run_fusion
from benchmarks.learning_adapter import RECENT, Teacher
from benchmarks.learning_stretches import heard_of
from benchmarks.world_run import load, record_world
from services.fusion.area_view import AreaView
from services.fusion.chunks import period_of
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.rescore.worker import rescore
from services.fusion.tracker import Chunk
from services.learning.settings import REST, URGENT_REST
from services.learning.trials import Pace
from shared.messages import DetectionFrame, Message, MotionBatch, RadioScan, Revision, TrackFrame

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["EXPERIMENT", "Cost", "Trying", "cost_of", "main", "shifted"]

SECONDS = 90.0
"""Of the crowd's world."""
ROUNDS = 40
"""The hour: as often is all of it told, shifted in time."""
TURN = 1.0
"""Seconds between two looks, as the service has them."""


class Cost:
    """What learning took, round by round.

    Attributes:
        taking: (n,) s of a core for messages; ``looking``: (n,) for looks, without trials.
        looking: see above.
        memory: (n,) MB resident at the end of each round.
    """

    def __init__(self) -> None:
        self.taking: list[float] = []
        self.looking: list[float] = []
        self.memory: list[float] = []


class Trying:
    """Fusion's part: the first candidate is tried in earnest, and what was found is the answer to all others.

    Args:
        chunks: of one round.
        view: the area as found.

    Attributes:
        count: how many candidates were to be tried.
        seconds: of a core for one, on as many minutes as fusion keeps.
        spent: seconds of a core that went into it so far, no cost of the loop.
        now: sensors' time.
    """

    def __init__(self, chunks: Sequence[Chunk], view: AreaView) -> None:
        self._chunks, self._view = chunks, view
        self._answer: Mapping[str, Any] | None = None
        self.count = 0
        self.seconds = self.spent = 0.0
        self.now = 0.0

    def __call__(self, question: bytes) -> Mapping[str, Any]:
        """Answer as fusion does."""
        self.count += 1
        if self._answer is None:
            begun = time.process_time()
            by = self.now - self._chunks[-1].t_end
            chunks = [_chunk_later(chunk, by) for chunk in self._chunks]
            asked = msgspec.json.decode(question)
            asked["since"] = chunks[0].t_start  # a round is shorter than what is held out
            told = rescore(msgspec.json.encode(asked), chunks, self._view)
            self.spent += time.process_time() - begun
            if told["error"]:
                raise ExperimentError(f"a candidate cannot be tried: {told['error']}")
            self.seconds = self.spent * RECENT / (chunks[-1].t_end - chunks[0].t_start)
            self._answer = {**told, "took": self.seconds}
        return self._answer


def _chunk_later(chunk: Chunk, by: float) -> Chunk:
    return dataclasses.replace(
        chunk,
        t_start=chunk.t_start + by,
        t_end=chunk.t_end + by,
        frames=tuple(replace(one, t=one.t + by) for one in chunk.frames),
        scans=tuple(replace(one, t=one.t + by) for one in chunk.scans),
        motions=tuple(_motion_later(one, by) for one in chunk.motions),
    )


def _motion_later(batch: MotionBatch, by: float) -> MotionBatch:
    since = batch.revises_from
    return replace(
        batch,
        t=batch.t + by,
        t_start=batch.t_start + by,
        step_t=[t + by for t in batch.step_t],
        turn_t=[t + by for t in batch.turn_t],
        revises_from=None if since is None else since + by,
    )


def shifted(message: Message, by: float) -> Message:
    """Return a message as if everything in it had been ``by`` seconds later."""
    match message:
        case MotionBatch():
            return _motion_later(message, by)
        case Revision():
            return replace(
                message,
                t=message.t + by,
                since=[t + by for t in message.since],
                at=[t + by for t in message.at],
            )
        case DetectionFrame() | RadioScan() | TrackFrame():
            return replace(message, t=message.t + by)
        case _:
            raise TypeError(f"{type(message).__name__}: allowed: what sensors and fusion say")


def cost_of(learning: Teacher, trying: Trying, messages: Sequence[Message], rounds: int, progress: Progress) -> Cost:
    """Return what learning takes for the same messages, told again and again; its candidates are for ``trying``."""
    cost = Cost()
    task = progress.add_task("learning", total=rounds)
    for number in range(rounds):
        taking = looking = 0.0
        looked = -np.inf
        for message in _later(messages, number * SECONDS):
            begun = time.process_time()
            learning.take(message)
            taking += time.process_time() - begun
            if isinstance(message, TrackFrame) and message.t - looked >= TURN:
                looked = trying.now = message.t
                begun, spent = time.process_time(), trying.spent
                learning.look(message.t)
                looking += time.process_time() - begun - (trying.spent - spent)
        cost.taking.append(taking)
        cost.looking.append(looking)
        cost.memory.append(_resident())
        progress.advance(task)
    return cost


def _later(messages: Sequence[Message], by: float) -> Iterator[Message]:
    return (shifted(message, by) for message in messages)


def _resident() -> float:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize() / 1e6


def run(options: Options, progress: Progress) -> Figures:
    """Return the share of a core, and how memory grows."""
    scenario, site = load(options.scenario)
    task = progress.add_task("world", total=SECONDS)
    area = site.areas[0].id
    made = record_world(
        scenario, site, options.seed, seconds=SECONDS, progress=lambda t: progress.update(task, completed=t)
    )
    record, view = made.pop(area), AreaView.of(site, area)
    messages = [message for _, message in heard_of(record, run_fusion(record))]
    trying = Trying(list(chunks_of(record, period_of(make_tracker(DEFAULT_TRACKER, view).cycle))), view)
    pace = Pace(rest=REST, urgent_rest=URGENT_REST)
    cost = cost_of(Teacher(site, view, DEFAULT_TRACKER, trying, pace), trying, messages, ROUNDS, progress)
    total = np.array(cost.taking) + np.array(cost.looking)
    late = np.arange(len(total)) >= len(total) // 2
    hours = np.arange(len(total))[late] * SECONDS / 3600.0
    _draw(cost, options)
    loop, trials = float(total[late].mean() / SECONDS), trying.count * trying.seconds / (ROUNDS * SECONDS)
    return {
        "core_share": loop + trials,
        "loop_share": loop,
        "loop_share_worst_round": float(total.max() / SECONDS),
        "trials_share": trials,
        "trials_per_h": trying.count * 3600.0 / (ROUNDS * SECONDS),
        "trial_s": trying.seconds,
        "looking_share": float(np.mean(cost.looking) / SECONDS),
        "memory_mb": cost.memory[-1],
        "memory_slope_mb_per_h": float(np.polyfit(hours, np.array(cost.memory)[late], 1)[0]),
    }


def _draw(cost: Cost, options: Options) -> None:
    figure, axis = plt.subplots(figsize=(7.0, 4.0))
    minutes = (np.arange(len(cost.memory)) + 1) * SECONDS / 60.0
    axis.plot(minutes, 100.0 * (np.array(cost.taking) + np.array(cost.looking)) / SECONDS, label="share of a core, %")
    axis.set(xlabel="minutes", ylabel="share of a core, %", ylim=(0.0, None))
    other = axis.twinx()
    other.plot(minutes, cost.memory, "--", color="C3")
    other.set_ylabel("resident memory, MB", color="C3")
    figure.tight_layout()
    options.picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.picture, dpi=110)
    plt.close(figure)


EXPERIMENT = Experiment(
    name="learning-speed",
    question="What share of a core does learning take beside a full hall, and does its memory grow?",
    kind="speed",
    scenario="crowd",
    seed=52,
    run=run,
    made="""Everything learning hears of 300 people and 100 phones under four cameras, for an hour of event time (90
seconds of a world, told again and again), through the learning loop itself without a bus: processor time for messages
and for looks, over event time: `loop_share`. The tracks were made beforehand and are not counted. What candidates cost
to be tried is fusion's process of the lowest priority: one is tried in earnest on a round, the time taken for the five
minutes that fusion keeps, and counted as often as the service, which rests after each, tries one: `trials_share`, in
`core_share` too.""",
    at_most={"core_share": 0.25},
    picture="Share of a core and resident memory over the hour.",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
