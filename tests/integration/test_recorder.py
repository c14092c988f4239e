"""A recording that begins in the middle of a run must still replay to the same bytes, and say so when it cannot."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from conftest import unused_port
from fusion_world import SITE, frame
from waiting import wait_until

from services.cli.recorder import record
from services.cli.recording import Recording
from services.cli.replay import verify
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import DetectionFrame, RadioModelUpdate, RadioScan, TrackFrame
from shared.radio import PathLoss, RadioModel, ShadowingMap, pack_radio_model
from shared.site import load_site

KEYS = Keys("test-hall")
POINTS = ["ap-1", "ap-2"]


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    path.write_text(SITE)
    return path


@contextmanager
def fusion(endpoint: str, site_file: Path) -> Iterator[None]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")}
    flags = ["--site-file", str(site_file), "--area", "hall", "--bus", json.dumps([endpoint])]
    flags += ["--health-port", str(unused_port()), "--log-level", "error"]
    process = subprocess.Popen([sys.executable, "-m", "services.fusion", *flags], env=environment)
    try:
        yield
    finally:
        process.terminate()
        process.wait(10)


class Sensors(threading.Thread):
    """Two cameras at 7 frames/s and six phones, each with a scan a second, so that scans are under way all the time."""

    def __init__(self, bus: Bus) -> None:
        super().__init__(daemon=True)
        self.stopping = threading.Event()
        self._cameras = {name: bus.publisher(KEYS.detections(name), DetectionFrame) for name in ("west", "east")}
        self._phones = {f"p{i}": bus.publisher(KEYS.radio(f"p{i}"), RadioScan) for i in range(6)}

    def run(self) -> None:
        start = time.time()
        n = 0
        while not self.stopping.wait(max(0.0, start + n / 7 - time.time())):
            places = [(6 + 0.05 * (n % 200), 7.0)]
            for number, (device, phone) in enumerate(self._phones.items()):
                if n % 7 == number:
                    scan = RadioScan(t=time.time(), device=device, seq=n, access_point=POINTS, rssi=[-60.0, -62.0])
                    phone.publish(scan)
            for name, publisher in self._cameras.items():
                publisher.publish(frame(start + n / 7, places, name, n))
            n += 1


@pytest.fixture
def bus(zenoh_router: str) -> Iterator[Bus]:
    with Bus([zenoh_router]) as opened:
        yield opened


@pytest.fixture
def sensors(bus: Bus) -> Iterator[Sensors]:
    thread = Sensors(bus)
    thread.start()
    yield thread
    thread.stopping.set()
    thread.join()


@contextmanager
def recording(bus: Bus, site_file: Path, out: Path) -> Iterator[dict[str, int]]:
    """Record in a thread for as long as the block lasts; yields the counts as they grow."""
    stopping = threading.Event()
    counts: dict[str, int] = {}
    arguments = (bus, load_site(site_file), site_file, out, stopping, counts.update)
    thread = threading.Thread(target=record, args=arguments)
    thread.start()
    try:
        yield counts
    finally:
        stopping.set()
        thread.join()


def wait_for_tracks(bus: Bus) -> None:
    inbox = bus.inbox()
    inbox.subscribe(KEYS.tracks("hall"), TrackFrame)
    wait_until(lambda: inbox.receive(0.1), 20, "tracks")


@pytest.mark.alone  # A recorder that gets no core for a while loses frames, as every reader of them may.
def test_recordings_begun_in_mid_run_replay_exactly(
    zenoh_router: str, bus: Bus, sensors: Sensors, site_file: Path, tmp_path: Path
) -> None:
    with fusion(zenoh_router, site_file):
        wait_for_tracks(bus)
        for number in range(3):
            out = tmp_path / f"{number}.mcap"
            with Bus([zenoh_router]) as own, recording(own, site_file, out) as counts:
                wait_until(lambda counts=counts: counts.get("TrackFrame", 0) >= 40, 30, "forty recorded frames")
            opened = Recording(out)
            assert opened.state("hall") is not None
            (verdict,) = verify(opened, load_site(site_file))
            assert verdict.identical, str(verdict)
            assert verdict.frames >= 20


def learned(version: int) -> RadioModelUpdate:
    corners = [(0.3, 0.3), (12.0, 0.3), (23.7, 0.3), (23.7, 13.7), (12.0, 13.7), (0.3, 13.7)]
    names = tuple(f"ap-{number}" for number in range(1, 7))
    positions = np.array([(x, y, 2.8) for x, y in corners])
    radio = PathLoss(names, positions, np.full(6, -42.0 + version), np.full(6, 2.3))
    flat = np.zeros((6, 2, 2))
    model = RadioModel("test-hall", radio, ShadowingMap(names, np.zeros(2), 10.0, flat, flat + 4.0))
    return RadioModelUpdate(t=0.0, area="hall", version=version, model=pack_radio_model(model))


def test_a_radio_model_that_goes_live_in_mid_recording_is_replayed(
    zenoh_router: str, bus: Bus, sensors: Sensors, site_file: Path, tmp_path: Path
) -> None:
    models = bus.publisher(KEYS.radio_model("hall"), RadioModelUpdate, cached=True)
    models.publish(learned(1))
    with fusion(zenoh_router, site_file):
        wait_for_tracks(bus)
        out = tmp_path / "swap.mcap"
        with Bus([zenoh_router]) as own, recording(own, site_file, out) as counts:
            # The state under the first model is stored by now, and what it knows of it.
            wait_until(lambda: counts.get("TrackFrame", 0) >= 25, 30, "frames under the first model")
            trace = models.publish(learned(2))
            before = counts["TrackFrame"]
            wait_until(lambda: counts["TrackFrame"] >= before + 15, 30, "frames under the second")
    opened = Recording(out)
    state = opened.state("hall")
    assert state is not None
    assert json.loads(state)["model"]["version"] == 1
    marks = [one.mark for one in opened.consumed("hall")]
    assert sum(trace.id in mark.consumed for mark in marks) == 1
    (verdict,) = verify(opened, load_site(site_file))
    assert verdict.identical, str(verdict)
    assert verdict.frames >= 20


def test_a_restart_of_fusion_is_told_not_passed_over(
    zenoh_router: str, bus: Bus, sensors: Sensors, site_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "restart.mcap"
    with Bus([zenoh_router]) as own, recording(own, site_file, out) as counts:
        with fusion(zenoh_router, site_file):
            wait_until(lambda: counts.get("TrackFrame", 0) >= 15, 30, "frames of the first process")
        before = counts["TrackFrame"]
        with fusion(zenoh_router, site_file):
            wait_until(lambda: counts["TrackFrame"] >= before + 15, 30, "frames of the second process")
    (verdict,) = verify(Recording(out), load_site(site_file))
    assert verdict.different == 0
    assert verdict.after_restart > 0
    assert not verdict.identical
    assert "started anew" in str(verdict)
