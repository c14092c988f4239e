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

import pytest
from conftest import unused_port
from fusion_world import SITE, frame
from waiting import wait_until

from services.cli.recorder import record
from services.cli.recording import Recording
from services.cli.replay import verify
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import DetectionFrame, RadioScan, TrackFrame
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
