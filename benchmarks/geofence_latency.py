"""How long from a position being published to its alert being there? The geofence process on a real router."""

from __future__ import annotations

import tempfile
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path

import msgspec
import numpy as np
import zenoh

from benchmarks.experiment import ExperimentError
from benchmarks.unused_port import unused_port
from services.cli.demo import find_site
from services.cli.launcher import Launcher, LauncherError, ProcessSpec
from shared.bus import Bus, router
from shared.inbox import Trace
from shared.keys import Keys
from shared.messages import AlertKind, TrackFrame
from shared.site import load_site
from shared.zones import ZoneDefinition, ZoneRule, ZoneSet

__all__ = ["alert_latency"]

RATE, PEOPLE, ZONES = 15.0, 300, 100
WARM_UP = 3.0
READY_WITHIN = 60.0
KINDS: tuple[AlertKind, ...] = ("enter", "exit", "dwell", "crowd", "proximity", "speed")
LIMITS = {"dwell": 3.0, "crowd": 8.0, "proximity": 0.5, "speed": 1.8}


def alert_latency(seed: int, seconds: float = 30.0, site_name: str = "crowd") -> dict[str, float]:
    """Return percentiles of the milliseconds from a frame of tracks being sent to each of its alerts being received.

    Raises:
        ExperimentError: the process did not start, or told nothing.
    """
    site_file = find_site(site_name)
    site = load_site(site_file)
    area, keys, endpoint = site.areas[0], Keys(site.site), f"tcp/127.0.0.1:{unused_port()}"
    words: deque[str] = deque(maxlen=10)
    heard: list[tuple[float, float]] = []

    def hear(sample: zenoh.Sample) -> None:
        now = time.time()
        if sample.attachment is not None:
            heard.append((msgspec.json.decode(sample.attachment.to_bytes(), type=Trace).origin, now))

    random = np.random.default_rng(seed)
    outline = np.array(next(floor.outline for floor in site.floors if floor.id == area.floor))
    low, high = outline.min(axis=0), outline.max(axis=0)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        session = stack.enter_context(router(endpoint))
        session.declare_subscriber(keys.alert(), hear)
        launcher = Launcher(
            {"ATRIUM_BUS": f'["{endpoint}"]', "ATRIUM_SITE_FILE": str(site_file), "ATRIUM_PROFILE": "demo"},
            lambda name, line: words.append(line),
        )
        stack.callback(launcher.stop)
        settings = {"ATRIUM_LOG_LEVEL": "warning", "ATRIUM_STATE_FOLDER": str(folder)}
        launcher.start(ProcessSpec("geofence", "services.geofence", unused_port(), settings))
        try:
            launcher.wait_ready(READY_WITHIN)
        except LauncherError as error:
            raise ExperimentError(str(error)) from error
        bus = stack.enter_context(Bus([endpoint]))
        zones = bus.publisher(keys.zones(), ZoneSet, cached=True)
        zones.publish(ZoneSet(t=time.time(), version=1, zones=_zones(random, low, high, area.floor)))
        tracks = bus.publisher(keys.tracks(area.id), TrackFrame)
        place = random.uniform(low, high, (PEOPLE, 2))
        velocity = random.normal(0.0, 0.9, (PEOPLE, 2))
        begin = time.time()
        for number in range(round(seconds * RATE)):
            place = place + velocity / RATE
            velocity = np.where((place < low) | (place > high), -velocity, velocity)
            time.sleep(max(0.0, begin + number / RATE - time.time()))
            tracks.publish(_frame(begin + number / RATE, number, area.id, area.floor, place, velocity))
        time.sleep(1.0)
    timed = np.array([(now - sent) * 1000.0 for sent, now in heard if sent >= begin + WARM_UP])
    if len(timed) < 100:
        raise ExperimentError(f"only {len(timed)} alerts came:\n" + "\n".join(words))
    p50, p99 = np.percentile(timed, [50, 99], method="higher")
    return {"alert_p50_ms": float(p50), "alert_p99_ms": float(p99), "alerts": len(timed)}


def _zones(random: np.random.Generator, low: np.ndarray, high: np.ndarray, floor: str) -> list[ZoneDefinition]:
    zones = []
    for number in range(ZONES):
        x, y = (float(value) for value in random.uniform(low, high - 3.0))
        points = [(x, y), (x + 3.0, y), (x + 3.0, y + 3.0), (x, y + 3.0)]
        line = number % 10 == 9
        kinds: tuple[AlertKind, ...] = ("cross",) if line else KINDS
        rules = [ZoneRule(id=kind, kind=kind, limit=LIMITS.get(kind)) for kind in kinds]
        shape, corners = ("line", points[:2]) if line else ("area", points)
        zones.append(ZoneDefinition(id=f"z{number}", floor=floor, shape=shape, points=corners, rules=rules))  # type: ignore[arg-type]
    return zones


def _frame(t: float, number: int, area: str, floor: str, place: np.ndarray, velocity: np.ndarray) -> TrackFrame:
    count = len(place)
    return TrackFrame(
        t=t,
        area=area,
        chunk=number,
        tracker="made",
        track=list(range(1, count + 1)),
        floor=[floor] * count,
        x=place[:, 0].tolist(),
        y=place[:, 1].tolist(),
        covariance=[(0.02, 0.0, 0.02)] * count,
        vx=velocity[:, 0].tolist(),
        vy=velocity[:, 1].tolist(),
        state=["confirmed"] * count,
        device=[None] * count,
        probability=[0.9] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[]] * count,
        sources=[[]] * count,
        quality=[1.0] * count,
    )
