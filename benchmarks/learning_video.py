"""What would the camera service see of the twin's people in real pictures, with its detector set in other ways?

The people of a world are drawn as video, the pictures go through the camera's own ring and redetection, and what comes
back takes the place of simulated detections (level (a)): so that a learning rate chosen there can be checked on video.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from benchmarks.world_run import EPOCH
from services.camera.frame_ring import FrameRing
from services.camera.redetection import Job, redetect
from services.simulator.people import BLOCK, snapshot
from services.simulator.scenario_file import Scenario
from services.simulator.video.rendering import HallRenderer
from services.simulator.world import people_of
from shared.messages import DetectionFrame
from shared.site import Site

__all__ = ["rendered_again"]

SIZE = (480, 360)
"""Pixels of the ring's pictures: what is drawn larger would be shrunk to this."""
LATENESS = 0.1
"""Seconds after which a frame reaches the bus."""


def rendered_again(
    scenario: Scenario,
    site: Site,
    seed: int,
    area: str,
    options: Sequence[Mapping[str, float]],
    seconds: float,
    rate: float = 4.0,
    *,
    primed: bool = True,
) -> list[dict[str, list[tuple[float, DetectionFrame]]]]:
    """Return what an area's cameras find in drawn pictures with each of some detector options.

    Args:
        scenario: what happens.
        site: where.
        seed: of the world; people walk as in every other record of it.
        area: whose cameras.
        options: of the foreground detector.
        seconds: how much of the world, from its beginning.
        rate: pictures per second.
        primed: whether the detector knows the empty scene, as a camera does that has run for a while.

    Returns:
        For each options, by camera: arrival at the bus and frame, seconds since the epoch.
    """
    cv2.setNumThreads(1)
    people = people_of(scenario, site, seed)
    floor = site.floor(site.area(area).floor)
    cameras = site.cameras_of(area)
    views = [HallRenderer(floor, camera.geometry.build().scaled_to(*SIZE), people.persons, seed) for camera in cameras]
    rings = [FrameRing(128.0, seconds / 60.0 + 1.0, rate) for _ in cameras]
    for block in range(round(seconds / BLOCK)):
        times = block * BLOCK + np.arange(round(BLOCK * rate)) / rate
        for t in times.tolist():
            shown = snapshot(people, t, floor.id)
            for view, ring in zip(views, rings, strict=True):
                ring.offer(view.frame(shown, t, round(t * rate)), EPOCH + t)
    seen: list[dict[str, list[tuple[float, DetectionFrame]]]] = []
    for one in options:
        found = {}
        for camera, view, ring in zip(cameras, views, rings, strict=True):
            kept = ring.ask()
            empty = view.empty if primed else None
            job = Job(camera, floor.id, "foreground", one, SIZE, empty, kept[0].t, kept[-1].t)
            found[camera.id] = [(frame.t + LATENESS, frame) for frame in redetect(job, kept).frames]
        seen.append(found)
    return seen
