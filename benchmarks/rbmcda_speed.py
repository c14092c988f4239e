"""How long does one cycle of the particle filter take? Walkers with phones in a made-up second, again and again."""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.cli.demo import find_site
from services.fusion.area_view import AreaView
from services.fusion.rbmcda.particles import Cycle, Draws
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.tracker import RbmcdaTracker
from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, MotionBatch, RadioScan
from shared.site import Site, load_site

__all__ = ["Crowding", "cycle_seconds", "cycles", "oracle_seconds"]

Array = NDArray[np.float64]

SITE, AREA = "construction-1", "west"
WARM_UP, TIMED = 4, 9
PACE = 1.2
"""Metres per second."""
ORACLE = Path(__file__).resolve().parents[1] / "tests" / "rbmcda_oracle.py"
LOOPED = 3
"""Particles of which the plain loops are timed; they do the same for each."""
HEARD_AT = 0.4
"""Seconds into each second at which phones hear their access points."""


@dataclass(frozen=True, slots=True)
class Crowding:
    """How much a cycle has to do.

    Attributes:
        particles: of the filter.
        devices: phones, all carried by somebody who is seen.
        detections: people seen; those beyond ``devices`` carry no phone.
    """

    particles: int
    devices: int
    detections: int


def cycle_seconds(crowding: Crowding, seed: int = 0) -> float:
    """Return the median time of a cycle, seconds, of the tracker's whole step: messages in, tracks out."""
    site = load_site(find_site(SITE))
    view = AreaView.of(site, AREA)
    tracker = RbmcdaTracker(view, seed, RbmcdaSettings(particles=crowding.particles))
    passed = []
    for chunk in cycles(crowding, site, view, seed):
        begun = time.perf_counter()
        frame = tracker.step(chunk)
        passed.append(time.perf_counter() - begun)
    if len(frame.track) != crowding.devices:
        raise RuntimeError(
            f"{len(frame.track)} of {crowding.devices} devices are tracked; the cycle is not what it says"
        )
    return float(np.median(passed[WARM_UP:]))


def oracle_seconds(crowding: Crowding, seed: int = 0) -> float:
    """Return how long such a cycle takes the plain loops on filterpy that the tests hold the tracker to.

    A few particles are timed, the others reckoned to take as long each.
    """
    site = load_site(find_site(SITE))
    view = AreaView.of(site, AREA)
    settings = RbmcdaSettings(particles=LOOPED)
    tracker = _Watched(view, seed, settings)
    for chunk in cycles(crowding, site, view, seed):
        before = tracker._particles
        tracker.step(chunk)
    oracle = _oracle()
    particles = [
        [
            oracle.Target(before.mean[:, state].copy(), before.covariance[:, :, state].copy(), 1.0 / LOOPED)
            for state in before.state[n].tolist()
        ]
        for n in range(LOOPED)
    ]
    draws = Draws.of(np.random.default_rng(seed), LOOPED, crowding.devices)
    begun = time.perf_counter()
    oracle.one_cycle(particles, tracker.last, settings, draws)
    return (time.perf_counter() - begun) * crowding.particles / LOOPED


class _Watched(RbmcdaTracker):
    """A tracker that keeps what its last cycle took in."""

    last: Cycle

    def _cycle(self, *came_in: Any) -> Cycle:
        self.last = super()._cycle(*came_in)
        return self.last


def _oracle() -> ModuleType:
    found = importlib.util.spec_from_file_location("rbmcda_oracle", ORACLE)
    if found is None or found.loader is None:
        raise FileNotFoundError(ORACLE)
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module
    found.loader.exec_module(module)
    return module


def cycles(crowding: Crowding, site: Site, view: AreaView, seed: int) -> Iterator[Chunk]:
    """Yield seconds of people who walk straight where a camera sees them, turning back at the view's border."""
    generator = np.random.default_rng(seed)
    camera = site.cameras_of(view.area)[0].id
    low, high = _seen(view, camera)
    place = generator.uniform(low, high, (crowding.detections, 2))
    angle = generator.uniform(-np.pi, np.pi, crowding.detections)
    velocity = PACE * np.column_stack([np.cos(angle), np.sin(angle)])
    for second in range(WARM_UP + TIMED):
        begin = 1000.0 + second
        outside = ((place + velocity < low) | (place + velocity > high)).any(axis=1)
        velocity[outside] *= -1.0
        heading = np.arctan2(velocity[:, 1], velocity[:, 0])
        level = view.radio.rssi(place + HEARD_AT * velocity) + generator.normal(
            0.0, 3.6, (len(place), len(view.radio.names))
        )
        place = place + velocity
        seen = place + generator.normal(0.0, 0.1, place.shape)
        yield Chunk(
            index=1000 + second,
            t_start=begin,
            t_end=begin + 1.0,
            frames=(_frame(begin + 0.95, camera, view.floor, second, seen),),
            scans=tuple(
                RadioScan(
                    t=begin + HEARD_AT,
                    device=f"phone-{number}",
                    seq=second,
                    access_point=list(view.radio.names),
                    rssi=level[number].tolist(),
                )
                for number in range(crowding.devices)
            ),
            motions=tuple(
                _walk(begin, f"phone-{number}", second, float(heading[number])) for number in range(crowding.devices)
            ),
        )


def _seen(view: AreaView, camera: str) -> tuple[Array, Array]:
    """Return two opposite corners of a rectangle the camera sees: the middle half of the floor it looks at."""
    x, y = (np.linspace(low, high, 60) for low, high in zip(view.lower, view.upper, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = places[view.views[camera].depth_at(places) > 0.5]
    low, high = np.percentile(inside, [25.0, 75.0], axis=0)
    return low, high


def _frame(t: float, camera: str, floor: str, seq: int, places: Array) -> DetectionFrame:
    return DetectionFrame(
        t=t,
        camera=camera,
        floor=floor,
        seq=seq,
        x=places[:, 0].tolist(),
        y=places[:, 1].tolist(),
        covariance=[(0.02, 0.0, 0.02)] * len(places),
        confidence=[0.9] * len(places),
        box=[(0.0, 0.0, 1.0, 1.0)] * len(places),
    )


def _walk(begin: float, device: str, seq: int, heading: float) -> MotionBatch:
    return MotionBatch(
        t=begin + 0.9,
        t_start=begin - 0.1,
        device=device,
        seq=seq,
        activity="walking",
        step_t=[begin + 0.3, begin + 0.8],
        step_t_variance=[1e-3, 1e-3],
        length=[0.5 * PACE] * 2,
        length_variance=[0.01] * 2,
        heading=[heading] * 2,
        heading_variance=[0.03] * 2,
    )
