"""Emulated phones against a real HTTP server that records, refuses, forgets and goes away."""

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from waiting import wait_until

from services.simulator.phone import EmulatedPhone
from services.simulator.phones import Phones
from services.simulator.radio_world import RadioWorld
from services.simulator.trajectories import Trajectories
from shared.site import load_site

SITE = load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


class Server:
    """A gateway that remembers what it was told and answers as it is told."""

    def __init__(self, port: int) -> None:
        self.enrolments: list[dict[str, Any]] = []
        self.batches: list[tuple[str, str, dict[str, Any]]] = []
        self.refuse_with: int | None = None
        self.refused = 0
        self.known: set[str] = set()
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                if server.refuse_with is not None:
                    server.refused += 1
                    self.answer(server.refuse_with, {"detail": []}, {"Retry-After": "0"})
                elif self.path == "/v1/devices":
                    device = f"d-{len(server.enrolments)}"
                    server.enrolments.append(body)
                    server.known.add(device)
                    self.answer(201, {"device": device, "token": "secret-" + device, "site": "hall"})
                else:
                    device = self.path.split("/")[3]
                    if device not in server.known:
                        self.answer(401, {"detail": []})
                        return
                    server.batches.append((device, self.headers["Authorization"], body))
                    self.answer(200, {"seq": body["seq"], "replied": time.time()})

            def answer(self, status: int, body: dict[str, Any], headers: dict[str, str] | None = None) -> None:
                payload = json.dumps(body).encode()
                self.send_response(status)
                for name, value in {"Content-Length": str(len(payload)), **(headers or {})}.items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(payload)

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server(free_port: int) -> Iterator[Server]:
    running = Server(free_port)
    yield running
    running.close()


def start(port: int, persons: int = 2, reports: list[str | None] | None = None) -> Phones:
    t = np.arange(0.0, 600.0, 1.0)
    rows = [np.column_stack([t, np.full(len(t), p), 2 + 0.02 * t, np.full(len(t), p)]) for p in range(1, persons + 1)]
    people = Trajectories(np.vstack(rows))
    world = RadioWorld(SITE, 1)
    emulated = [EmulatedPhone(SITE, world, person, "ground", 1, started=time.time()) for person in people.persons]
    reported = [] if reports is None else reports
    phones = Phones(emulated, f"http://127.0.0.1:{port}", "the key", report=reported.append)
    phones.start()
    phones.follow(people, time.time() - 100.0)
    return phones


def test_phones_enrol_with_consent_and_post_numbered_batches_of_a_second(server: Server, free_port: int) -> None:
    phones = start(free_port)
    try:
        wait_until(lambda: len(server.batches) >= 6, 15, "six batches")
    finally:
        phones.stop()
    assert len(server.enrolments) == 2
    assert all(body["consent"] is True and body["enrolment_key"] == "the key" for body in server.enrolments)
    assert sorted(phones.devices.values()) == ["d-0", "d-1"]
    for device in ("d-0", "d-1"):
        mine = [(token, body) for d, token, body in server.batches if d == device]
        assert {token for token, _ in mine} == {f"Bearer secret-{device}"}
        assert [body["seq"] for _, body in mine] == list(range(len(mine)))
        assert all(len(body["imu"]["t"]) <= 76 for _, body in mine)
        stamps = np.concatenate([body["imu"]["t"] for _, body in mine])
        np.testing.assert_allclose(np.diff(stamps), 0.02, atol=2e-4)
        for _, body in mine:
            assert 0 <= body["sent"] - body["imu"]["t"][-1] < 2.5
        assert "echo" not in mine[0][1]
        assert mine[-1][1]["echo"]["arrived"] <= mine[-1][1]["sent"]


def test_nothing_is_lost_while_the_gateway_is_busy(server: Server, free_port: int) -> None:
    reports: list[str | None] = []
    phones = start(free_port, persons=1, reports=reports)
    try:
        wait_until(lambda: len(server.batches) >= 2, 15, "two batches")
        server.refuse_with = 503
        wait_until(lambda: server.refused >= 2, 15, "a refused batch, tried again")
        wait_until(lambda: reports and reports[-1] is not None, 5, "the report")
        assert "busy: 503" in str(reports[-1])
        held = len(server.batches)
        server.refuse_with = None
        wait_until(lambda: len(server.batches) >= held + 3, 15, "what waited")
        wait_until(lambda: reports[-1] is None, 5, "the all-clear")
    finally:
        phones.stop()
    seqs = [body["seq"] for _, _, body in server.batches]
    assert seqs == list(range(len(seqs)))
    stamps = np.concatenate([body["imu"]["t"] for _, _, body in server.batches])
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=2e-4)


def test_phones_wait_for_a_gateway_that_starts_after_them(free_port: int) -> None:
    reports: list[str | None] = []
    phones = start(free_port, persons=1, reports=reports)
    try:
        wait_until(lambda: reports, 10, "a report that nobody answers")
        assert "no answer" in str(reports[0])
        server = Server(free_port)
        try:
            wait_until(lambda: server.batches, 20, "the first batch")
        finally:
            server.close()
        assert server.batches[0][2]["seq"] == 0
    finally:
        phones.stop()


def test_a_phone_that_the_gateway_has_forgotten_enrols_anew(server: Server, free_port: int) -> None:
    phones = start(free_port, persons=1)
    try:
        wait_until(lambda: server.batches, 15, "the first batch")
        server.known.clear()
        wait_until(lambda: any(device == "d-1" for device, _, _ in server.batches), 15, "a batch of the new device")
        assert phones.devices == {"1": "d-1"}
    finally:
        phones.stop()
    fresh = [body["seq"] for device, _, body in server.batches if device == "d-1"]
    assert fresh == list(range(len(fresh)))
