"""What the gateway makes of emulated phones: steps found, headings wrong by as much as real ones, nothing refused."""

import math
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pytest
from phone_carriers import WalkingPeople

from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import Phone
from services.gateway.protocol import Batch
from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples, Motion, Walk
from services.simulator.faults import DuplicateBatches, PhoneClockFault, PhoneFaults, SwappedBatches
from services.simulator.phones.carrying import Carrying
from services.simulator.phones.magnetic import MagneticField, MagneticParameters
from services.simulator.phones.phone import EmulatedPhone, FleetParameters, PhoneBatch
from services.simulator.phones.posting import body_of
from services.simulator.radio.radio_world import RadioParameters, RadioWorld
from shared.messages import MotionBatch, RadioScan
from shared.site import Site, load_site

EPOCH = 1_700_000_000.0


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def world(hall: Site) -> tuple[Site, RadioWorld, MagneticField]:
    return hall, RadioWorld(hall, 1, RadioParameters()), MagneticField(hall, MagneticParameters(), 1)


World = tuple[Site, RadioWorld, MagneticField]


def measured(
    world: World, people: WalkingPeople, seconds: float, rate: float = 50.0, **fleet: object
) -> list[PhoneBatch]:
    chosen = FleetParameters.model_validate({"count": 1, "inertial_rate": rate, **fleet})
    phone = EmulatedPhone(*world, people.persons[0], chosen, 1)
    return [batch for k in range(int(seconds / 5)) for batch in phone.block(people, 5.0 * k, 5.0 * k + 5.0)]


def moved(site: Site, batches: list[PhoneBatch], phone: Walk) -> list[Motion]:
    reckoner = DeadReckoner(site.north_radians)
    inertial = [batch.inertial for batch in batches if batch.inertial is not None]
    parts = [InertialSamples(part.t, *(part.values[:, k : k + 3] for k in (0, 3, 6))) for part in inertial]
    return [m for part in parts for m in reckoner.advance([phone], [part])[0]] + reckoner.finish([phone])[0]


def reckoned(site: Site, batches: list[PhoneBatch]) -> tuple[np.ndarray, np.ndarray]:
    """Times and headings of the steps that dead reckoning finds."""
    motions = moved(site, batches, Walk("hand"))
    return np.concatenate([m.step_t for m in motions]), np.concatenate([m.heading for m in motions])


def to_and_fro(person: str, speed: float, direction: float) -> WalkingPeople:
    legs = [(6.0, speed, direction), (6.0, speed, direction + math.pi)] * 4
    return WalkingPeople([(4.0, 0.0, direction), *legs, (10.0, 0.0, direction)], (10.0, 5.0), persons=[person])


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_dead_reckoning_finds_the_true_steps(world: World, carrying: Carrying, rate: float) -> None:
    errors = []
    for number, speed in enumerate((0.7, 0.9, 1.1, 1.3, 1.5)):
        people = to_and_fro(f"p{number}", speed, 0.5 * number)
        batches = measured(world, people, 60.0, rate, carrying=carrying)
        found, _ = reckoned(world[0], batches)
        errors.append(len(found) / sum(len(batch.step_t) for batch in batches) - 1.0)
    assert np.median(np.abs(errors)) < 0.03
    assert np.sort(np.abs(errors))[-2] < 0.06  # one walk may begin or end in a fidget


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_how_a_phone_is_carried_is_found_out(world: World, carrying: Literal["hand", "pocket"]) -> None:
    """Of a phone of which nobody has told: the same steps and headings as if somebody had."""
    for number, speed in enumerate((0.7, 1.1, 1.5)):
        batches = measured(world, to_and_fro(f"p{number}", speed, 0.5 * number), 60.0, carrying=carrying)
        told, found = (moved(world[0], batches, Walk(known)) for known in (carrying, "unknown"))
        told_heading, heading = (np.concatenate([m.heading for m in motions]) for motions in (told, found))
        assert len(heading) == len(told_heading)
        assert np.mean(np.cos(heading - told_heading) > 0.99) > 0.85


def test_a_walk_north_is_a_walk_north_and_people_differ_as_on_real_phones(world: World) -> None:
    """Of real traces the bias has a standard deviation of ten degrees."""
    site = world[0]
    biases = []
    for number in range(24):
        north = site.north_radians
        people = WalkingPeople([(4.0, 0.0, north), (26.0, 0.5, north)], (4.0, 2.0), persons=[f"p{number}"])
        _, headings = reckoned(site, measured(world, people, 30.0))
        biases.append(math.degrees(np.angle(np.exp(1j * (headings - north)).mean())))
    assert abs(np.mean(biases)) < 7.0
    assert 5.0 < np.std(biases) < 18.0


def test_standing_people_who_fidget_are_mistaken_for_walkers_now_and_then(world: World) -> None:
    false = []
    for number in range(8):
        people = WalkingPeople([(200.0, 0.0, 0.0)], persons=[f"p{number}"])
        batches = measured(world, people, 120.0, habits={"fidget_every": 15.0})
        assert not sum(len(batch.step_t) for batch in batches)
        false.append(len(reckoned(world[0], batches)[0]))
    assert 0 < np.sum(false) < 8 * 60


def test_the_gateway_refuses_nothing_and_tells_everything_on_its_own_clock(world: World) -> None:
    """Through duplicates, batches that overtake each other and a clock that is wrong by hours and drifts."""
    site = world[0]
    people = to_and_fro("ann", 1.1, 0.3)
    faults = PhoneFaults(
        [
            DuplicateBatches(kind="duplicate-batches", share=0.2),
            SwappedBatches(kind="swapped-batches", share=0.1),
            PhoneClockFault(kind="phone-clock", drift_ppm=50.0),
        ],
        1,
        ["ann"],
    )
    batches = faults.arrivals(measured(world, people, 60.0))
    addresses = {address.lower(): point.id for point in site.access_points for address in point.addresses}
    phone, reckoner = Phone("d", addresses, "hand"), DeadReckoner(site.north_radians)
    intakes = [
        phone.take(msgspec.convert(body_of(batch, EPOCH), Batch), EPOCH + batch.arrival, Limits(), reckoner)
        for batch in batches
    ]
    assert sum(intake.duplicate for intake in intakes) == len(batches) - 60 > 4
    assert not any("unknown address" in intake.ignored for intake in intakes)
    scans = [message for message in phone.outbox if isinstance(message, RadioScan)]
    truth = sorted(scan.t for batch in {b.seq: b for b in batches}.values() for scan in batch.scans)
    np.testing.assert_allclose(sorted(scan.t - EPOCH for scan in scans), truth, atol=0.3)
    motions = [message for message in phone.outbox if isinstance(message, MotionBatch)]
    assert sum(len(motion.step_t) for motion in motions) > 50


def test_an_hours_late_flush_is_young_enough_for_the_gateway(world: World) -> None:
    site = world[0]
    people = WalkingPeople([(7300.0, 0.0, 0.0)], persons=["ann"])
    batches = measured(
        world,
        people,
        7300.0,
        0.0,
        batch_seconds=60.0,
        upload={"every": 3600.0},
        wifi={"kind": "throttled", "burst": 4, "per": 120.0},
    )
    phone, reckoner = Phone("d", {}, "hand"), DeadReckoner(site.north_radians)
    for batch in batches:
        phone.take(msgspec.convert(body_of(batch, EPOCH), Batch), EPOCH + batch.arrival, Limits(), reckoner)
    assert max(batch.sent - batch.measured_until for batch in batches) > 3000.0
    assert len(batches) == 61  # a burst of four every other minute
