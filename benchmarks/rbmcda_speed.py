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
PACE = 0.8
"""Metres per second …"""
RADIUS = 2.0
"""… on a circle of so many metres."""
RATE = 15
"""Frames a second of the camera."""
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
    tracker = _Watched(view, seed, RbmcdaSettings(particles=crowding.particles))
    passed, seen = [], []
    for chunk in cycles(crowding, site, view, seed):
        begun = time.perf_counter()
        frame = tracker.step(chunk)
        passed.append(time.perf_counter() - begun)
        seen.append(tracker.seen)
    if set(seen[WARM_UP:]) != {crowding.detections}:
        raise RuntimeError(
            f"{seen[WARM_UP:]} people are seen, not {crowding.detections}; the cycle is not what it says"
        )
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
    """A tracker that keeps what its last cycle took in.

    Attributes:
        last: the cycle.
        seen: how many people were in it; none before the first.
    """

    last: Cycle
    seen = 0

    def _cycle(self, *came_in: Any) -> Cycle:
        self.last = super()._cycle(*came_in)
        self.seen = len(self.last.places)
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
    """Yield seconds of people spread evenly where a camera sees them, who all walk round in step.

    So nobody walks through anybody, and the cameras tell them all apart, however crowded it is.
    """
    generator = np.random.default_rng(seed)
    camera = site.cameras_of(view.area)[0].id
    home = _spread(generator, crowding.detections, *_seen(view, camera))
    for second in range(WARM_UP + TIMED):
        begin = 1000.0 + second
        moved = _round(second + 1.0) - _round(second)
        heading = float(np.arctan2(moved[1], moved[0]))
        place = home + _round(second + HEARD_AT)
        level = view.radio.rssi(place) + generator.normal(0.0, 3.6, (len(place), len(view.radio.names)))
        frames = tuple(
            _frame(
                begin + (number + 0.5) / RATE,
                camera,
                view.floor,
                RATE * second + number,
                home + _round(second + (number + 0.5) / RATE) + generator.normal(0.0, 0.1, home.shape),
            )
            for number in range(RATE)
        )
        yield Chunk(
            index=1000 + second,
            t_start=begin,
            t_end=begin + 1.0,
            frames=frames,
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
            motions=tuple(_walk(begin, f"phone-{number}", second, heading) for number in range(crowding.devices)),
        )


def _seen(view: AreaView, camera: str) -> tuple[Array, Array]:
    """Return two opposite corners of a rectangle the camera sees: the middle two thirds of the floor it looks at."""
    x, y = (np.linspace(low, high, 60) for low, high in zip(view.lower, view.upper, strict=True))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    inside = places[view.views[camera].depth_at(places) > 0.5]
    low, high = np.percentile(inside, [17.0, 83.0], axis=0)
    return low, high


def _spread(generator: np.random.Generator, people: int, low: Array, high: Array) -> Array:
    """Return (d, 2) places at the same distances from each other, in any order."""
    lanes = max(round(people**0.5), 1)
    order = generator.permutation(people)
    share = (np.column_stack([order // lanes, order % lanes]) + 0.5) / [-(-people // lanes), lanes]
    places: Array = low + share * (high - low)
    return places


def _round(t: float) -> Array:
    """Return (2,) metres from home."""
    place: Array = RADIUS * np.array([np.cos(PACE / RADIUS * t), np.sin(PACE / RADIUS * t)])
    return place


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
