"""From a scenario and a seed to what off-line experiments work on: the twin's world through the gateway's own code."""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
import shapely
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.world_record import Truth, WorldRecord
from services.cli.simulate import find_scenario
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import Phone
from services.gateway.protocol import Batch
from services.gateway.reckoning.dead_reckoning import DeadReckoner
from services.simulator.people import BLOCK
from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.phones.posting import body_of
from services.simulator.scenario_file import Scenario
from services.simulator.scenario_loading import load_scenario, seen_floor, watched
from services.simulator.world import World
from shared.messages import DetectionFrame, MotionBatch, RadioScan
from shared.site import Site

__all__ = ["EPOCH", "TRUTH_EVERY", "load", "record_world", "with_access_points"]

Array = NDArray[np.float64]
P = TypeVar("P", RadioScan, MotionBatch)

EPOCH = 1_700_000_000.0
"""True time of world time zero, the same in every run."""
TRUTH_EVERY = 0.2
LIMITS = Limits()


def load(name: str | Path) -> tuple[Scenario, Site]:
    """Return a shipped scenario by name, or that of a file, with its site."""
    return load_scenario(find_scenario(str(name)))


def record_world(
    scenario: Scenario,
    site: Site,
    seed: int,
    *,
    seconds: float | None = None,
    motion: bool = True,
    people: int | None = None,
    progress: Callable[[float], None] = lambda seconds: None,
) -> dict[str, WorldRecord]:
    """Make a world and return what reached Atrium, by area.

    Phones' batches go through the gateway's own phone: clock alignment, dead reckoning, translation of addresses.
    Phones of every area are in every record: who is elsewhere is heard all the same.

    Args:
        scenario: what happens; ``site``: where; ``seed``: of everything random.
        site: see above.
        seed: see above.
        seconds: how much of it; None: the scenario's duration.
        motion: whether inertial samples are worked on; without, it is quicker and ``motions`` are empty.
        people: seed of another day with other people in the same place; None: ``seed`` (see ``World``).
        progress: called with the seconds made.
    """
    world = World(scenario, site, seed, people)
    until = math.ceil((scenario.duration if seconds is None else seconds) / BLOCK) * BLOCK
    addresses = {address.lower(): point.id for point in site.access_points for address in point.addresses}
    phones = {carrier.person: Phone(carrier.device, addresses, carrier.fleet.enrolled_as) for carrier in world.carriers}
    reckoner = DeadReckoner(site.north_radians)
    frames: dict[str, list[tuple[float, DetectionFrame]]] = defaultdict(list)
    area_of = {camera.id: camera.area for camera in site.cameras}
    told: list[tuple[float, RadioScan | MotionBatch]] = []
    replied: dict[str, PhoneBatch] = {}
    times: list[Array] = []
    places: list[Array] = []
    floors: list[NDArray[np.int16]] = []
    for arrival in world.arrivals(
        until, lambda block: _keep_truth(world, block.start, block.end, times, places, floors)
    ):
        message = arrival.message
        if isinstance(message, PhoneBatch):
            phone = phones[message.person]
            body = _body(message, replied.get(message.person), motion)
            replied[message.person] = message
            if body is None:
                continue
            phone.take(body, EPOCH + arrival.t, LIMITS, reckoner)
            told += [(EPOCH + arrival.t, said) for said in phone.outbox]
            phone.outbox.clear()
        else:
            frames[area_of[message.camera]].append((EPOCH + arrival.t, replace(message, t=EPOCH + message.t)))
        progress(world.made)
    t, position, floor = np.concatenate(times), np.concatenate(places), np.concatenate(floors)
    return {
        area.id: _record(
            world, area.id, frames[area.id], told, t, position, floor == world.people.floors.index(area.floor)
        )
        for area in site.areas
        if area.floor in world.people.floors
    }


def with_access_points(record: WorldRecord, wanted: Sequence[str]) -> WorldRecord:
    """Return the record as if the site had only the access points ``wanted``."""
    kept = set(wanted)
    site = record.site.model_copy(
        update={"access_points": [point for point in record.site.access_points if point.id in kept]}
    )
    arrivals = [
        (t, _of_points(message, kept) if isinstance(message, RadioScan) else message) for t, message in record.arrivals
    ]
    scans = {device: [_of_points(scan, kept) for scan in scans] for device, scans in record.scans.items()}
    return dataclasses.replace(record, site=site, arrivals=arrivals, scans=scans)


def _body(batch: PhoneBatch, before: PhoneBatch | None, motion: bool) -> Batch | None:
    """Return what the phone posts; it echoes the reply to its last batch, which came back as slowly as that went."""
    body = body_of(batch, EPOCH)
    if not motion:
        body.pop("imu", None)
    if "imu" not in body and not body["radio"]:
        return None
    if before is not None and 2.0 * before.arrival - before.sent <= batch.sent:
        came_back = float(batch.clock.read(np.array([2.0 * before.arrival - before.sent]))[0])
        body["echo"] = {"replied": EPOCH + before.arrival, "arrived": EPOCH + came_back}
    return msgspec.convert(body, Batch)


def _keep_truth(
    world: World, start: float, end: float, times: list[Array], places: list[Array], floors: list[NDArray[np.int16]]
) -> None:
    t: Array = start + TRUTH_EVERY * np.arange(round((end - start) / TRUTH_EVERY), dtype=np.float64)
    there = world.people.movement(t)
    times.append(EPOCH + t)
    places.append(np.where(there.present[..., None], there.position, np.nan).astype(np.float32))
    floors.append(there.floor)


def _record(
    world: World,
    area: str,
    frames: Sequence[tuple[float, DetectionFrame]],
    told: Sequence[tuple[float, RadioScan | MotionBatch]],
    t: Array,
    position: Array,
    here: NDArray[np.bool_],
) -> WorldRecord:
    site = world.site
    cameras = site.cameras_of(area)
    places = np.where(here[..., None], position, np.nan)
    in_view = np.zeros(here.shape, bool)
    for camera in cameras:
        in_view |= watched(camera, places.reshape(-1, 2)).reshape(here.shape)
    devices = world.devices
    seen = [seen_floor(camera, site) for camera in cameras]
    floor = np.array(site.floor(site.area(area).floor).outline)
    hull = shapely.MultiPoint(np.concatenate(seen) if seen else floor).convex_hull
    corners = shapely.get_coordinates(hull)[:-1]
    return WorldRecord(
        site=site,
        area=area,
        arrivals=list(heapq.merge(frames, told, key=lambda arrival: arrival[0])),
        frames=sorted((frame for _, frame in frames), key=lambda frame: (frame.t, frame.camera)),
        scans=_by_device(told, RadioScan, list(devices.values())),
        motions=_by_device(told, MotionBatch, list(devices.values())),
        truth=Truth(t, world.people.persons, [devices.get(p) for p in world.people.persons], places, in_view),
        view=corners,
    )


def _by_device(
    told: Sequence[tuple[float, RadioScan | MotionBatch]], kind: type[P], devices: Sequence[str]
) -> dict[str, list[P]]:
    said: dict[str, list[P]] = {device: [] for device in devices}
    for _, message in told:
        if isinstance(message, kind):
            said[message.device].append(message)
    return {device: sorted(messages, key=lambda message: message.t) for device, messages in said.items()}


def _of_points(scan: RadioScan, kept: set[str]) -> RadioScan:
    heard = [(name, rssi) for name, rssi in zip(scan.access_point, scan.rssi, strict=True) if name in kept]
    return replace(scan, access_point=[name for name, _ in heard], rssi=[rssi for _, rssi in heard])
