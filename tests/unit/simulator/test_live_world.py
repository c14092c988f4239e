"""A world that happens now is on time, stands still where the machine is too slow, and never piles up."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from services.simulator import service
from services.simulator.live_world import AHEAD, JUST_NOW, SLOW, SLOW_CLIP, WELL_AGAIN, LiveWorld
from services.simulator.people import BLOCK
from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.scenario_loading import load_scenario
from services.simulator.service import Simulator
from services.simulator.video.video_light import VideoParameters
from services.simulator.video.video_server import FrameFeed
from services.simulator.world import Arrival, World, WorldBlock
from shared.messages import DetectionFrame
from shared.truth import GroundTruth

PROJECT = Path(__file__).resolve().parents[3]
EPOCH = 1_000_000.0


@dataclass
class Machine:
    """A clock, and how long a block takes on it."""

    t: float = EPOCH
    block_takes: float = 0.1
    told: list[str | None] = field(default_factory=list)

    def clock(self) -> float:
        return self.t


class SlowWorld(World):
    """A world whose blocks take time on a machine's clock."""

    machine: Machine
    meanwhile: Callable[[], None] = staticmethod(lambda: None)  # what others do while a block is made

    def next_block(self) -> WorldBlock:
        for _ in range(20):
            self.machine.t += self.machine.block_takes / 20
            self.meanwhile()
        block = super().next_block()
        self.meanwhile()
        return block


def live(machine: Machine, *, tied: bool = False) -> LiveWorld:
    world = SlowWorld(*load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml"))
    world.machine = machine
    return LiveWorld(world, EPOCH, tied=tied, report=machine.told.append, clock=machine.clock)


def run(happening: LiveWorld, machine: Machine, until: float) -> list[tuple[float, Arrival]]:
    """What is handed out, with the time at which it was, by one who looks every 20 ms."""
    seen = []
    while machine.t < EPOCH + until:
        happening.make_ahead()
        while (arrival := happening.due()) is not None:
            seen.append((machine.t - EPOCH, arrival))
        machine.t += 0.02
    return seen


def measured(arrival: Arrival) -> list[float]:
    message = arrival.message
    if isinstance(message, PhoneBatch):
        scans = [scan.t for scan in message.scans]
        return [
            message.measured_until,
            message.sent,
            *scans,
            *(message.inertial.t.tolist() if message.inertial else ()),
        ]
    return [message.t]


def test_on_a_quick_machine_everything_happens_at_its_time() -> None:
    machine = Machine()
    happening = live(machine)
    seen = run(happening, machine, 30.0)
    assert happening.delay == pytest.approx(0.1)  # until the first block was there
    assert machine.told.count(SLOW) == 0
    assert {type(arrival.message) for _, arrival in seen} == {DetectionFrame, PhoneBatch, GroundTruth}
    assert all(0.0 <= at - arrival.t <= 0.2 for at, arrival in seen)
    assert happening.world.made <= 30.0 + AHEAD + BLOCK


def test_on_a_slow_machine_the_world_stands_still_says_so_and_loses_nothing() -> None:
    machine = Machine(block_takes=7.0)
    happening = live(machine)
    seen = run(happening, machine, 70.0)
    assert happening.delay > 15.0
    assert set(machine.told) == {SLOW}
    frames = [arrival.message for _, arrival in seen if isinstance(arrival.message, DetectionFrame)]
    assert [frame.seq for frame in frames] == list(range(len(frames)))
    assert len(frames) > 60
    assert (np.diff([frame.t for frame in frames]) > 0.4).all()
    for _, arrival in seen:
        assert max(measured(arrival)) <= arrival.t + 1e-6
        assert min(measured(arrival)) > arrival.t - 2.5  # what is told now is of now
    told = len(machine.told)
    machine.block_takes = 0.1
    run(happening, machine, 70.0 + (WELL_AGAIN + 4) * BLOCK)
    assert machine.told[told:].count(None) >= 1
    assert SLOW not in machine.told[machine.told.index(None) :]


def test_a_clip_does_not_wait_for_the_world() -> None:
    machine = Machine(t=EPOCH + 22.0)
    happening = live(machine, tied=True)
    seen = run(happening, machine, 40.0)
    assert not happening.delay
    assert machine.told.count(SLOW_CLIP) == 0  # it was joined in its middle
    assert all(at - arrival.t <= JUST_NOW for at, arrival in seen)
    assert min(arrival.t for _, arrival in seen) > 19.0
    machine.block_takes = 8.0
    late = run(happening, machine, 100.0)
    assert SLOW_CLIP in machine.told
    assert all(at - arrival.t <= JUST_NOW for at, arrival in late)


def test_what_nobody_takes_does_not_pile_up() -> None:
    machine = Machine()
    happening = live(machine)
    for _ in range(400):
        happening.make_ahead()
        machine.t += 0.1
    assert happening.world.made <= AHEAD + 2 * BLOCK
    machine.t += 60.0
    seen = run(happening, machine, machine.t - EPOCH + 20.0)
    frames = [a.message.seq for _, a in seen if isinstance(a.message, DetectionFrame)]
    assert frames == list(range(len(frames)))


def test_what_is_shown_of_a_slow_world_is_made_and_is_never_shown_again() -> None:
    machine = Machine(block_takes=7.0)
    happening = live(machine)
    asked: list[float] = []

    def look() -> None:
        asked.append(happening.world_time(machine.t - EPOCH))
        assert asked[-1] <= happening.world.made

    assert isinstance(happening.world, SlowWorld)
    happening.world.meanwhile = look
    run(happening, machine, 70.0)
    assert happening.delay > 15.0
    assert (np.diff(asked) >= 0.0).all()
    assert 40.0 < asked[-1] <= happening.world.made


def test_a_rendered_camera_asks_for_no_second_that_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine()
    happening = live(machine)
    happening.make_ahead()
    asked: list[float] = []
    stopping = threading.Event()

    def snapshot(people: object, t: float, floor: str) -> None:
        asked.append(t)
        if len(asked) == 3:
            stopping.set()

    renderer = SimpleNamespace(frame=lambda people, t, number: np.zeros((16, 16, 3), np.uint8))
    monkeypatch.setattr(service, "HallRenderer", lambda *rest: renderer)
    monkeypatch.setattr(service, "snapshot", snapshot)
    feed = FrameFeed()
    feed.someone_watches.set()
    camera, simulator = happening.world.site.cameras[0], SimpleNamespace(stopping=stopping)
    late = time.time() - 60.0  # a minute has gone by, and five seconds of world are there
    Simulator._render(simulator, VideoParameters(frames_per_s=50), camera, feed, happening, late)  # type: ignore[arg-type]
    assert asked == [BLOCK] * 3
