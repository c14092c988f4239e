"""What would the cameras have seen of the same people, had their detectors learned more quickly or more slowly?

The twin's people are made once more by their seed, the cameras look again with another learning rate of their
background, phones stay as they were: no part of the world but detections changes.
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from benchmarks.world_record import WorldRecord
from benchmarks.world_run import EPOCH
from services.simulator.cameras.detection_parameters import DetectionParameters
from services.simulator.cameras.detections import DetectionModel
from services.simulator.faults import CameraFaults
from services.simulator.people import BLOCK
from services.simulator.scenario_file import DetectedView, Scenario
from services.simulator.world import people_of
from shared.messages import DetectionFrame
from shared.site import Site

__all__ = ["Seen", "configured_rate", "seen_again", "with_detections"]

Seen = Mapping[str, Sequence[tuple[float, DetectionFrame]]]
"""By camera: when each frame reached the bus, and the frame; both times in seconds since the epoch."""


def configured_rate(scenario: Scenario) -> float:
    """Return the learning rate, per second, with which the scenario's cameras work."""
    return _view(scenario).detection.learning_rate


def seen_again(
    scenario: Scenario, site: Site, seed: int, area: str, rates: Sequence[float], seconds: float
) -> list[Seen]:
    """Return what an area's cameras see of a world with each of some learning rates.

    Args:
        scenario: what happens; its cameras have one view for all.
        site: where.
        seed: of the world.
        area: whose cameras.
        rates: of their backgrounds, per second.
        seconds: how much of the world, from its beginning.
    """
    view = _view(scenario)
    people = people_of(scenario, site, seed)
    faults = CameraFaults(scenario.faults, seed)
    floor = site.floor(site.area(area).floor)
    eyes = [
        (place, camera.id, DetectionModel(camera, floor, _learning(view, rate), view.frames_per_s, seed))
        for place, rate in enumerate(rates)
        for camera in site.cameras_of(area)
    ]
    seen: list[dict[str, list[tuple[float, DetectionFrame]]]] = [
        {camera.id: [] for camera in site.cameras_of(area)} for _ in rates
    ]
    for block in range(round(seconds / BLOCK)):
        for place, name, eye in eyes:
            frames = eye.frames(people, block * BLOCK, (block + 1) * BLOCK)
            seen[place][name] += [
                (EPOCH + t, replace(frame, t=EPOCH + frame.t)) for t, frame in faults.arrivals(name, frames)
            ]
    return list(seen)


def with_detections(record: WorldRecord, seen: Seen) -> WorldRecord:
    """Return the record as if its cameras had seen this, in the time it covers."""
    if not record.arrivals:
        return record
    begin, end = record.arrivals[0][0], record.arrivals[-1][0]
    other = sorted(
        ((t, frame) for frames in seen.values() for t, frame in frames if begin <= t <= end),
        key=lambda entry: entry[0],
    )
    phones = [entry for entry in record.arrivals if not isinstance(entry[1], DetectionFrame)]
    return dataclasses.replace(
        record,
        arrivals=list(heapq.merge(other, phones, key=lambda entry: entry[0])),
        frames=sorted((frame for _, frame in other), key=lambda frame: (frame.t, frame.camera)),
    )


def _learning(view: DetectedView, rate: float) -> DetectionParameters:
    return view.detection.model_copy(update={"learning_rate": rate})


def _view(scenario: Scenario) -> DetectedView:
    [view, *others] = scenario.views
    if others or not isinstance(view, DetectedView):
        raise ValueError(f"views: {scenario.scenario} has {len(scenario.views)}; allowed: one, of level detections")
    return view
