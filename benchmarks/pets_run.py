"""One real run: the whole of Atrium on the PETS clip, watched from outside through the bus and the API."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from benchmarks.pets_truth import FRAMES, FRAMES_PER_S
from services.cli.demo import API_KEY, Demo, Ports, find_site
from services.cli.launcher import LauncherError
from services.cli.recorder import record
from shared.bus import Bus, Delivery, Inbox
from shared.keys import Keys
from shared.messages import CameraStatus, DetectionFrame, Message, TrackFrame
from shared.truth import GroundTruth, truth_key

__all__ = ["PetsRun", "Sample", "run_clip"]

CLIP_SECONDS = FRAMES / FRAMES_PER_S


@dataclass(frozen=True)
class Sample:
    """What the API answered at one moment: positions by device, as (x, y, age in seconds)."""

    t: float
    positions: dict[str, tuple[float, float, float]]


@dataclass
class PetsRun:
    """What was seen from outside while the clip played once.

    Attributes:
        origin: time of measurement of the clip's first frame.
        frames: the published tracks.
        latency: seconds from a detection frame being sent to its tracks being sent.
        samples: what the API said, about seven times a second.
        carriers: device id of each person that carries a phone.
        counts: messages in the recording, by kind; ``dropped`` among them.
        restarts: processes that ended unasked.
        statuses: exit statuses at the end.
    """

    recording: Path
    origin: float = 0.0
    frames: list[TrackFrame] = field(default_factory=list)
    detections: list[DetectionFrame] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    carriers: dict[int, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    restarts: int = 0
    statuses: dict[str, int] = field(default_factory=dict)


def run_clip(folder: Path, *, quiet: bool = True) -> PetsRun:
    """Play the clip once through all services at its own pace, recording, and return what was seen.

    Args:
        folder: for the recording and the log.
        quiet: do not print what the services log.

    Raises:
        LauncherError: a service did not start, or the clip did not begin or end in time.
    """
    run = PetsRun(recording=folder / "pets09.mcap")
    log = (lambda name, line: None) if quiet else (lambda name, line: print(f"{name:<10} {line}"))
    demo = Demo(find_site("pets09"), Ports.free(), log, folder, dashboard=False)
    stopping = threading.Event()
    starter = ThreadPoolExecutor(max_workers=1, thread_name_prefix="starter")
    try:
        keys = Keys(demo.site.site)
        with Bus([demo.endpoint]) as bus, Bus([demo.endpoint]) as recorder_bus:
            inbox = bus.inbox()
            inbox.subscribe(keys.detections(), DetectionFrame)
            inbox.subscribe(keys.tracks(), TrackFrame)
            inbox.subscribe(keys.camera_status(), CameraStatus, cached=True)
            inbox.subscribe(truth_key(keys), GroundTruth)

            def keep_record() -> None:
                run.counts.update(record(recorder_bus, demo.site, demo.site_file, run.recording, stopping))

            threads = [
                threading.Thread(target=keep_record, name="recorder"),
                threading.Thread(target=_ask_api, args=(demo, run, stopping), name="api client"),
            ]
            threads[0].start()
            started = starter.submit(demo.start, stopping=stopping)
            threads[1].start()
            try:
                _watch(demo, run, inbox, started)
            finally:  # before the buses close: the recorder still writes what is on its way
                stopping.set()
                for thread in threads:
                    thread.join(timeout=10.0)
    finally:
        stopping.set()
        starter.shutdown()
        run.restarts = sum(demo.launcher.restarts.values())
        run.statuses = demo.stop()
    return run


def _watch(demo: Demo, run: PetsRun, inbox: Inbox, started: Future[None]) -> None:
    """Take in what is published until two seconds after the clip's last frame."""
    sent: dict[float, float] = {}
    deadline = time.monotonic() + CLIP_SECONDS + 90.0
    last_frame_at = None
    while time.monotonic() < deadline:
        for delivery in inbox.receive(timeout=0.2):
            _take(delivery, run, sent)
        if started.done():
            started.result()  # a service that did not start ends the run here
        demo.launcher.keep_running()
        if run.origin > 0.0 and len(run.detections) >= FRAMES and last_frame_at is None:
            last_frame_at = time.monotonic()
        if last_frame_at is not None and time.monotonic() > last_frame_at + 2.0:
            return
    raise LauncherError(f"the clip did not play to its end: {len(run.detections)} of {FRAMES} frames were detected")


def _take(delivery: Delivery[Message], run: PetsRun, sent: dict[float, float]) -> None:
    message = delivery.message
    match message:
        case DetectionFrame():
            run.detections.append(message)
            sent[message.t] = delivery.trace.sent
        case TrackFrame():
            run.frames.append(message)
            if message.t in sent:
                run.latency.append(delivery.trace.sent - sent[message.t])
        case CameraStatus() if message.origin is not None:
            run.origin = message.origin
        case GroundTruth():
            for person, device in zip(message.person, message.device, strict=True):
                if device is not None:
                    run.carriers[int(person)] = device


def _ask_api(demo: Demo, run: PetsRun, stopping: threading.Event) -> None:
    """Ask for the positions about seven times a second, as a client of the museum would."""
    with httpx.Client(base_url=demo.api_url, headers={"Authorization": f"Bearer {API_KEY}"}, timeout=5.0) as client:
        while not stopping.wait(1.0 / FRAMES_PER_S):
            try:
                answer = client.get("/v1/positions")
            except httpx.HTTPError:
                continue
            now = time.time()
            if answer.status_code == 200:
                run.samples.append(Sample(now, {p["device"]: _place(p) for p in answer.json()["positions"]}))


def _place(position: dict[str, Any]) -> tuple[float, float, float]:
    return float(position["x"]), float(position["y"]), float(position["age"])
