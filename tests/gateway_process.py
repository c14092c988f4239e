"""A gateway in its own process, a phone that posts to it, and somebody who listens to the bus."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from conftest import ROOT, unused_port
from waiting import wait_until

from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Erasure, Message, MotionBatch, RadioScan

KEY = "a-key-for-tests"
STAFF = "a-key-for-staff"


@dataclass
class Running:
    process: subprocess.Popen[bytes]
    http: httpx.Client
    health: str
    endpoint: str
    database: Path


def launch(endpoint: str, folder: Path, **settings: str) -> Running:
    port, health = unused_port(), unused_port()
    environment = os.environ | {
        "ATRIUM_SITE_FILE": str(ROOT / "deploy/sites/hall/site.yaml"),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": json.dumps([endpoint]),
        "ATRIUM_GATEWAY_PORT": str(port),
        "ATRIUM_HEALTH_PORT": str(health),
        "ATRIUM_ENROLMENT_KEY": KEY,
        "ATRIUM_STAFF_KEY": STAFF,
        "ATRIUM_DATABASE_URL": f"sqlite:///{folder / 'gateway.db'}",
        "ATRIUM_LOG_LEVEL": "warning",
        "ATRIUM_LIVE_LATENESS": "120",  # the walks of these tests began a minute ago
        **settings,
    }
    process = subprocess.Popen([sys.executable, "-m", "services.gateway"], env=environment, cwd=ROOT)
    client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10.0)
    return Running(process, client, f"http://127.0.0.1:{health}", endpoint, folder / "gateway.db")


def is_ready(gateway: Running) -> bool:
    assert gateway.process.poll() is None, "the gateway ended by itself"
    try:
        return httpx.get(f"{gateway.health}/readyz").status_code == 200
    except httpx.HTTPError:
        return False


def finish(gateway: Running) -> int:
    gateway.http.close()
    gateway.process.send_signal(signal.SIGTERM)
    try:
        return gateway.process.wait(6.0)
    finally:
        gateway.process.kill()


@contextmanager
def running_gateway(folder: Path, **settings: str) -> Iterator[Running]:
    """A router and a gateway that is ready."""
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    session = router(endpoint)
    running = launch(endpoint, folder, **settings)
    try:
        wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
        yield running
    finally:
        status = finish(running)
        session.close()
    assert status == 0


class Phone:
    """An app in thirty lines."""

    def __init__(self, gateway: Running, clock: float = 0.0) -> None:
        self.http = gateway.http
        body = {"enrolment_key": KEY, "consent": True, "platform": "test", "carrying": "hand"}
        answer = self.http.post("/v1/devices", json=body)
        assert answer.status_code == 201, answer.text
        self.enrolled = answer.json()
        self.device: str = self.enrolled["device"]
        self.headers = {"Authorization": f"Bearer {self.enrolled['token']}"}
        self.clock = clock
        self.start = time.time() - 60.0

    def batch(self, seq: int) -> dict[str, Any]:
        """One second of a walk east, and one scan."""
        begin = self.start + seq + self.clock
        t = [begin + i / 50 for i in range(50)]
        columns = {name: [0.0] * 50 for name in ("ax", "ay", "gx", "gy", "gz", "my")}
        columns["az"] = [9.81 + 3.0 * math.sin(2 * math.pi * 1.9 * (stamp - self.clock - self.start)) for stamp in t]
        columns |= {"mx": [-20.0] * 50, "mz": [-43.0] * 50}  # the top of the phone points east, north is to its left
        heard = {"02:A7:00:00:00:01": -50.0, "02:a7:00:00:00:02": -61.0, "de:ad:be:ef:00:00": -40.0}
        radio = [{"t": begin + 0.5, "address": list(heard), "rssi": list(heard.values())}]
        return {"sent": time.time() + self.clock, "seq": seq, "imu": {"t": t, **columns}, "radio": radio}

    def post(self, body: Any, **headers: str) -> httpx.Response:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.http.post(self.enrolled["batches"], content=content, headers=self.headers | headers)


class Listener:
    """What the bus brought."""

    def __init__(self, endpoint: str) -> None:
        self.bus = Bus([endpoint])
        self.keys = Keys("hall")
        self.inbox = self.bus.inbox()
        self.inbox.subscribe(self.keys.radio(), RadioScan)
        self.inbox.subscribe(self.keys.motion(), MotionBatch)
        self.inbox.subscribe(self.keys.erasure(), Erasure)
        self.messages: list[Message] = []

    def erased(self) -> set[str]:
        self.messages += [delivery.message for delivery in self.inbox.receive(0.05)]
        return {m.device for m in self.messages if isinstance(m, Erasure)}

    def heard(self, device: str) -> tuple[list[RadioScan], list[MotionBatch]]:
        self.messages += [delivery.message for delivery in self.inbox.receive(0.05)]
        scans = [m for m in self.messages if isinstance(m, RadioScan) and m.device == device]
        motions = [m for m in self.messages if isinstance(m, MotionBatch) and m.device == device]
        return scans, motions


def problem(answer: httpx.Response) -> dict[str, str]:
    detail = answer.json()["detail"]
    assert isinstance(detail, list)
    first: dict[str, str] = detail[0]
    return first
