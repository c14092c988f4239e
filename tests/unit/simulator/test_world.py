"""Scenario, site and seed decide everything; parts of a world do not disturb each other; nothing is early or lost."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from world_fingerprint import FILE, WORLDS, differences, fingerprint

from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.scenario_file import Scenario
from services.simulator.scenario_loading import load_scenario
from services.simulator.scenario_reference import reference
from services.simulator.world import World, WorldBlock, truth_messages
from shared.messages import DetectionFrame

PROJECT = Path(__file__).resolve().parents[3]
SECONDS = 20.0
ONE_FLEET = [{"name": "visitor", "count": 4, "wifi": {"kind": "regular", "every": 0.5}}]
AND_ANOTHER = [*ONE_FLEET, {"name": "other", "count": 3, "carrying": "pocket"}]
TROUBLE = [
    {"kind": "frames-late", "camera": "gallery", "share": 0.3, "delay": [0.3, 3.0]},
    {"kind": "duplicate-batches", "phone": 0, "share": 0.3},
    {"kind": "swapped-batches", "phone": 1, "share": 0.3},
    {"kind": "phone-gone", "phone": 2, "start": 4.0, "end": 9.0, "lost": False},
]
ELSEWHERE = """
import sys
sys.path.insert(0, {tests!r})
from test_world import digests, museum
print(*digests(museum(), {seed}))
"""


def museum(**changes: Any) -> Scenario:
    scenario, _ = load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml")
    document = scenario.model_dump(mode="json", exclude_unset=True)
    return Scenario.model_validate(document | changes)


def with_carriers(scenario: Scenario, carriers: int) -> Scenario:
    """So many people who are inside most of the time, whether they have phones or not."""
    walkers = scenario.people.walkers.model_copy(update={"carriers": carriers})  # type: ignore[union-attr]
    return scenario.model_copy(update={"people": scenario.people.model_copy(update={"walkers": walkers})})


def made(scenario: Scenario, seed: int, seconds: float = SECONDS) -> tuple[World, list[WorldBlock]]:
    _, site = load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml")
    world = World(scenario, site, seed)
    blocks = []
    while world.made < seconds:
        blocks.append(world.next_block())
    return world, blocks


def seen(blocks: list[WorldBlock]) -> bytes:
    return b"".join(msgspec.json.encode((t, frame)) for block in blocks for t, frame in block.frames)


def measured(batch: PhoneBatch) -> bytes:
    inertial = b"" if batch.inertial is None else batch.inertial.t.tobytes() + batch.inertial.values.tobytes()
    told = (batch.person, batch.seq, batch.measured_until, batch.sent, batch.arrival, batch.sent_stamp)
    scans = [(scan.t, scan.kind, scan.address, scan.rssi) for scan in batch.scans]
    return msgspec.json.encode((told, scans)) + inertial + batch.step_t.tobytes() + batch.step_length.tobytes()


def digests(scenario: Scenario, seed: int) -> list[str]:
    """Digests of what cameras see, what phones measure and where everybody is."""
    world, blocks = made(scenario, seed)
    parts = [
        seen(blocks),
        b"".join(measured(batch) for block in blocks for batch in block.batches),
        b"".join(msgspec.json.encode(truth) for block in blocks for truth in truth_messages(world, block)),
    ]
    assert all(len(part) > 1000 for part in parts)
    return [hashlib.sha256(part).hexdigest() for part in parts]


def test_the_same_seed_is_the_same_to_the_bit_in_every_process() -> None:
    code = ELSEWHERE.format(tests=str(Path(__file__).parent), seed=5)
    environment = {**os.environ, "PYTHONHASHSEED": "77", "PYTHONPATH": str(PROJECT)}
    answer = subprocess.run(
        [sys.executable, "-c", code], cwd=PROJECT, env=environment, capture_output=True, text=True, check=True
    )
    made(museum(), 6, 5.0)  # whatever else ran before
    assert answer.stdout.split() == digests(museum(), 5)


def test_another_seed_is_another_world_in_every_part() -> None:
    assert not set(digests(museum(), 5)) & set(digests(museum(), 6))


def test_more_phones_and_faults_change_nothing_about_what_cameras_see() -> None:
    _, plain = made(with_carriers(museum(phones=ONE_FLEET), 7), 5)
    _, more = made(with_carriers(museum(phones=AND_ANOTHER), 7), 5)
    assert seen(more) == seen(plain)
    before = {batch.person: measured(batch) for block in plain for batch in block.batches if batch.seq == 12}
    after = {batch.person: measured(batch) for block in more for batch in block.batches if batch.seq == 12}
    assert len(before) == 4
    assert len(after) == 7
    assert before.items() <= after.items()
    _, worse = made(with_carriers(museum(phones=ONE_FLEET, faults=TROUBLE), 7), 5)
    assert seen(worse) != seen(plain)

    def by_number(blocks: list[WorldBlock]) -> dict[int, DetectionFrame]:
        return {frame.seq: frame for block in blocks for _, frame in block.frames}

    assert by_number(worse) == by_number(plain)


def test_a_wall_built_on_the_way_is_there_for_radio_only_as_its_page_says() -> None:
    wall = {"at": 1.0, "kind": "wall", "line": [[0.0, 6.2], [13.0, 6.2]], "floor": "ground", "loss": 40.0}
    built = museum(radio=museum().radio.model_dump(mode="json", exclude_unset=True) | {"changes": [wall]})
    before, after = digests(museum(), 5), digests(built, 5)
    assert after[0] == before[0]  # what cameras see
    assert after[1] != before[1]  # what phones hear
    assert after[2] == before[2]  # where people are
    assert "for radio only: people and cameras ignore it" in reference()


def test_another_day_brings_other_people_to_the_same_place() -> None:
    scenario, site = load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml")
    world, later, same = (
        World(scenario, site, 5),
        World(scenario, site, 5, people=6),
        World(scenario, site, 5, people=5),
    )
    floor, spots = site.floors[0].id, np.random.default_rng(0).uniform(1.0, 5.0, (20, 2))
    one, other = (at.radio.expected(spots, floor) for at in (world, later))
    # A drift of the transmitters apart, what is heard at a place is the same …
    assert np.ptp(one - other, axis=0).max() < 1e-9
    # … but by other phones, of other people.
    device = world.carriers[0].device
    assert world.radio.phone(device).offset != later.radio.phone(device).offset
    times = np.arange(0.0, 20.0, 1.0)
    before, after, again = (at.people.movement(times).position for at in (world, later, same))
    assert before.shape != after.shape or not np.allclose(before, after, equal_nan=True)
    np.testing.assert_array_equal(before, again)


def test_everything_arrives_in_order_and_nothing_before_it_was_measured() -> None:
    scenario = museum(phones=ONE_FLEET, faults=TROUBLE)
    _, blocks = made(scenario, 5, 30.0)
    due = {(frame.camera, frame.seq, t) for block in blocks for t, frame in block.frames if t < 30.0}
    mailed = sorted((b.person, b.seq, b.arrival) for block in blocks for b in block.batches if b.arrival < 30.0)
    assert len(due) > 50
    assert len(mailed) > 80

    _, site = load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml")
    told: list[WorldBlock] = []
    arrivals = list(World(scenario, site, 5).arrivals(30.0, told.append))
    times = [arrival.t for arrival in arrivals]
    assert times == sorted(times)
    frames = [(a.t, a.message) for a in arrivals if isinstance(a.message, DetectionFrame)]
    batches = [(a.t, a.message) for a in arrivals if isinstance(a.message, PhoneBatch)]
    assert {(frame.camera, frame.seq, t) for t, frame in frames} == due
    assert sorted((batch.person, batch.seq, t) for t, batch in batches) == mailed
    assert all(t >= frame.t for t, frame in frames)
    assert all(t >= batch.sent >= batch.measured_until - 1e-9 for t, batch in batches)
    late = [t - frame.t for t, frame in frames if t - frame.t > 0.25]
    assert len(late) > 5
    assert max(late) < 3.1
    # Who was out of reach for five seconds told of them afterwards.
    gone = [t for t, batch in batches if batch.person == batches_of(batches, 2) and 4.0 < batch.measured_until < 9.0]
    assert len(gone) >= 4
    assert min(gone) >= 9.0
    assert [block.start for block in told] == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]


def batches_of(batches: list[tuple[float, PhoneBatch]], place: int) -> str:
    """The person whose phone has that place."""
    return sorted({batch.person for _, batch in batches})[place]


def test_asking_for_half_a_block_more_loses_nothing() -> None:
    _, site = load_scenario(PROJECT / "deploy/sites/museum/scenario.yaml")

    def count(until: float) -> int:
        return sum(1 for _ in World(museum(), site, 5).arrivals(until))

    _, blocks = made(museum(), 5, 15.0)
    arrivals = [t for block in blocks for t, _ in block.frames] + [b.arrival for block in blocks for b in block.batches]
    assert count(12.5) == sum(t < 12.5 for t in arrivals)


def test_the_truth_knows_where_carriers_are_and_cameras_see_them_there() -> None:
    world, blocks = made(museum(), 5)
    carriers = {carrier.person: carrier.device for carrier in world.carriers}
    assert list(carriers.values()) == ["visitor-1", "visitor-2", "visitor-3", "visitor-4"]
    times: list[float] = []
    places: dict[float, np.ndarray] = {}
    for block in blocks:
        for truth in truth_messages(world, block):
            times.append(truth.t)
            places[round(truth.t, 3)] = np.column_stack([truth.x, truth.y])
            for person, device, x, y in zip(truth.person, truth.device, truth.x, truth.y, strict=True):
                assert device == carriers.get(person)
                there = world.people.movement(np.array([truth.t]), [world.people.persons.index(person)])
                assert (x, y) == tuple(there.position[0, 0].tolist())
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)  # no instant twice or left out where blocks join
    assert len(times) == SECONDS * 10
    apart = [
        np.hypot(*(places[round(frame.t, 3)] - (x, y)).T).min()
        for block in blocks
        for _, frame in block.frames
        for x, y in zip(frame.x, frame.y, strict=True)
    ]
    assert np.median(apart) < 0.4


@pytest.mark.parametrize("name", WORLDS)
def test_shipped_worlds_are_what_they_were(name: str) -> None:
    """To store them anew: python tests/unit/simulator/world_fingerprint.py."""
    stored = json.loads(FILE.read_text(encoding="utf-8"))
    assert not differences(fingerprint(name), stored[name])


def test_a_changed_world_is_noticed() -> None:
    stored = json.loads(FILE.read_text(encoding="utf-8"))["museum"]
    assert differences({**stored, "detections": 1.05 * stored["detections"]}, stored)
    assert differences({**stored, "mean of received dBm": stored["mean of received dBm"] + 0.5}, stored)
