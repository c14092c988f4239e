"""Emulated phones against a real HTTP server that records, refuses, forgets and goes away."""

import dataclasses
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from phone_carriers import WalkingPeople
from waiting import wait_until

from services.simulator.phones.carrying import Carrying
from services.simulator.phones.magnetic import MagneticField, MagneticParameters
from services.simulator.phones.phone import EmulatedPhone, FleetParameters, PhoneBatch
from services.simulator.phones.phones import Phones
from services.simulator.radio.radio_world import RadioParameters, RadioWorld
from shared.site import load_site

SITE = load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


class Server:
    """A gateway that remembers what it was told and answers as it is told."""

    def __init__(self, port: int) -> None:
        self.enrolments: list[dict[str, Any]] = []
        self.batches: list[tuple[str, str, dict[str, Any]]] = []
        self.refuse_with: int | None = None
        self.refused = 0
        self.accepts_with = 200
        self.nonsense: tuple[Any, ...] | None = None
        self.received: list[float] = []
        self.known: set[str] = set()
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                received = time.time()
                if server.nonsense is not None:
                    server.refused += 1
                    status, payload, headers = server.nonsense
                    self.answer_with(status, payload, headers)
                elif server.refuse_with is not None:
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
                    server.received.append(received)
                    server.batches.append((device, self.headers["Authorization"], body))
                    self.answer(server.accepts_with, {"seq": body["seq"], "replied": time.time()})

            def answer(self, status: int, body: dict[str, Any], headers: dict[str, str] | None = None) -> None:
                self.answer_with(status, json.dumps(body).encode(), headers or {})

            def answer_with(self, status: int, payload: bytes, headers: dict[str, str]) -> None:
                self.send_response(status)
                for name, value in {"Content-Length": str(len(payload)), **headers}.items():
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


class World(Phones):
    """Phones that are given what they measure when its time comes, as the service does it."""

    def __init__(
        self, port: int, persons: int = 1, reports: list[str | None] | None = None, carrying: Carrying = "hand"
    ) -> None:
        self.people = WalkingPeople([(600.0, 0.02, 0.0)], persons=[str(p + 1) for p in range(persons)])
        radio, magnetic = RadioWorld(SITE, 1, RadioParameters()), MagneticField(SITE, MagneticParameters(), 1)
        fleet = FleetParameters(count=persons, hole_every=0.0, carrying=carrying)
        self.emulated = [EmulatedPhone(SITE, radio, magnetic, person, fleet, 1) for person in self.people.persons]
        reported = [] if reports is None else reports
        super().__init__(self.emulated, f"http://127.0.0.1:{port}", "the key", report=reported.append)
        self._over = threading.Event()

    def __enter__(self) -> "World":
        self.start()
        epoch = time.time()
        self.follow(epoch)
        threading.Thread(target=self._play, args=(epoch,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.stop()

    def measured(self, start: float, end: float) -> list[PhoneBatch]:
        found = [batch for phone in self.emulated for batch in phone.block(self.people, start, end)]
        return sorted(found, key=lambda batch: batch.arrival)

    def _play(self, epoch: float) -> None:
        for block in range(12):
            for batch in self.measured(5.0 * block, 5.0 * block + 5.0):
                if self._over.wait(max(0.0, epoch + batch.arrival - time.time())):
                    return
                self.post(batch)


def test_phones_enrol_with_consent_and_post_numbered_batches_of_a_second(server: Server, free_port: int) -> None:
    with World(free_port, persons=2) as phones:
        wait_until(lambda: len(server.batches) >= 6, 15, "six batches")
        devices = phones.devices
    assert len(server.enrolments) == 2
    assert all(body["consent"] is True and body["enrolment_key"] == "the key" for body in server.enrolments)
    assert sorted(devices.values()) == ["d-0", "d-1"]
    for device in ("d-0", "d-1"):
        mine = [(token, body) for d, token, body in server.batches if d == device]
        assert {token for token, _ in mine} == {f"Bearer secret-{device}"}
        assert [body["seq"] for _, body in mine] == list(range(len(mine)))
        assert all(len(body["imu"]["t"]) == 50 for _, body in mine)
        stamps = np.concatenate([body["imu"]["t"] for _, body in mine])
        np.testing.assert_allclose(np.diff(stamps), 0.02, atol=2e-3)
        for _, body in mine:
            assert 0 <= body["sent"] - body["imu"]["t"][-1] < 2.5
        assert "echo" not in mine[0][1]
        assert mine[-1][1]["echo"]["arrived"] <= mine[-1][1]["sent"]


def test_nothing_is_lost_while_the_gateway_is_busy(server: Server, free_port: int) -> None:
    reports: list[str | None] = []
    with World(free_port, reports=reports):
        wait_until(lambda: len(server.batches) >= 2, 15, "two batches")
        server.refuse_with = 503
        wait_until(lambda: server.refused >= 2, 15, "a refused batch, tried again")
        wait_until(lambda: reports and reports[-1] is not None, 20, "the report")
        assert "busy: 503" in str(reports[-1])
        held = len(server.batches)
        server.refuse_with = None
        wait_until(lambda: len(server.batches) >= held + 3, 15, "what waited")
        wait_until(lambda: reports[-1] is None, 20, "the all-clear")
    seqs = [body["seq"] for _, _, body in server.batches]
    assert seqs == list(range(len(seqs)))
    stamps = np.concatenate([body["imu"]["t"] for _, _, body in server.batches])
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=2e-3)


def test_a_batch_accepted_as_late_is_not_sent_again(server: Server, free_port: int) -> None:
    server.accepts_with = 202
    with World(free_port):
        wait_until(lambda: len(server.batches) >= 4, 15, "four batches")
    seqs = [body["seq"] for _, _, body in server.batches]
    assert seqs == list(range(len(seqs)))


NONSENSE: list[tuple[bool, int, bytes, dict[str, str]]] = [
    (False, 201, b"<html>Welcome to our Wi-Fi</html>", {}),
    (False, 201, b'{"device": "d-1"}', {}),
    (False, 201, b'{"device": "d-1\\n", "token": "t"}', {}),
    (False, 201, b'{"device": "d-1", "token": "\\u00e9"}', {}),
    (False, 201, b"\xff", {}),
    (True, 200, b"<html>Welcome to our Wi-Fi</html>", {}),
    (True, 200, b'{"seq": 0}', {}),
    (True, 200, b"no gzip", {"Content-Encoding": "gzip"}),
    (True, 302, b"", {"Location": "http://127.0.0.1:1/"}),
    (True, 503, b"", {"Retry-After": "\xb2"}),
]


@pytest.mark.parametrize("nonsense", NONSENSE)
def test_phones_outlive_answers_that_are_none(
    server: Server,
    free_port: int,
    nonsense: tuple[bool, int, bytes, dict[str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A captive portal, a proxy's page, another version: nothing of it ends the phones or costs a batch."""
    monkeypatch.setattr("services.simulator.phones.phones._LONGEST_PAUSE", 0.1)
    enrolled, *answer = nonsense
    reports: list[str | None] = []
    phones = World(free_port, reports=reports)
    batches = phones.measured(0.0, 5.0)[:2]
    if not enrolled:
        server.nonsense = tuple(answer)
    phones.start()
    try:
        phones.follow(time.time())
        if enrolled:
            wait_until(lambda: phones.devices, 15, "an enrolment")
            server.nonsense = tuple(answer)
        for batch in batches:
            phones.post(batch)
        wait_until(lambda: server.refused >= 2, 15, "two tries")
        wait_until(lambda: reports and reports[-1] is not None, 20, "the report")
        server.nonsense = None
        wait_until(lambda: len(server.batches) == 2, 15, "the batches")
        wait_until(lambda: reports[-1] is None, 20, "the all-clear")
    finally:
        phones.stop()
    assert [body["seq"] for _, _, body in server.batches] == [0, 1]


def test_a_mistake_that_ends_the_phones_is_reported_and_the_world_goes_on(
    server: Server, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports: list[str | None] = []
    phones = World(free_port, reports=reports)
    batches = phones.measured(0.0, 5.0)[:2]

    def mistaken(*_: object) -> None:
        raise AttributeError("a bug")

    monkeypatch.setattr("services.simulator.phones.phones.body_of", mistaken)
    phones.start()
    try:
        phones.follow(time.time())
        phones.post(batches[0])
        wait_until(lambda: reports and reports[-1] is not None, 15, "the report")
        assert "emulated phones have ended" in str(reports[-1])
        assert "a bug" in str(reports[-1])
        wait_until(phones._loop.is_closed, 20, "the end of the thread")
        phones.post(batches[1])  # and raises nothing
        phones.follow(time.time())
    finally:
        phones.stop()


def test_stamps_tell_of_the_journey_that_the_twin_gave_a_batch(server: Server, free_port: int) -> None:
    """A gateway aligns clocks by the quickest journeys, there and back: live as off-line."""
    phones = World(free_port)
    slow = [
        dataclasses.replace(batch, sent=batch.measured_until, arrival=batch.measured_until + 0.4)
        for batch in phones.measured(0.0, 5.0)
    ]
    phones.start()
    epoch = time.time()
    phones.follow(epoch)
    try:
        for batch in slow[:3]:
            wait_until(lambda batch=batch: time.time() >= epoch + batch.arrival, 10, "its arrival")  # type: ignore[misc]
            phones.post(batch)
        wait_until(lambda: len(server.batches) == 3, 15, "three batches")
    finally:
        phones.stop()
    clock = slow[0].clock
    for received, batch, (_, _, body) in zip(server.received, slow, server.batches, strict=False):
        assert body["sent"] == pytest.approx(epoch + batch.sent_stamp, abs=0.3)
        sent = received - epoch - 0.4
        assert body["sent"] <= epoch + clock.read(np.array([sent]))[0] + 1e-3
        assert body["sent"] > epoch + clock.read(np.array([sent - 0.2]))[0]
    for received, (_, _, body) in zip(server.received, server.batches[1:], strict=False):
        assert body["echo"]["arrived"] > epoch + clock.read(np.array([received - epoch + 0.4]))[0] - 1e-3
        assert body["echo"]["arrived"] <= body["sent"]


def test_phones_that_are_sometimes_in_a_pocket_claim_no_heading(server: Server, free_port: int) -> None:
    """To the gateway ``unknown`` is held flat or upright: it would tell the headings of pockets as known."""
    chosen: list[tuple[Carrying, str]] = [("hand", "hand"), ("pocket", "pocket"), ("mixed", "pocket")]
    for carrying, told in chosen:
        server.enrolments.clear()
        phones = World(free_port, carrying=carrying)
        phones.start()
        try:
            wait_until(lambda: server.enrolments, 15, "an enrolment")
        finally:
            phones.stop()
        assert server.enrolments[0]["carrying"] == told


def test_phones_wait_for_a_gateway_that_starts_after_them(free_port: int) -> None:
    reports: list[str | None] = []
    with World(free_port, reports=reports):
        wait_until(lambda: reports, 10, "a report that nobody answers")
        assert "no answer" in str(reports[0])
        server = Server(free_port)
        try:
            wait_until(lambda: server.batches, 20, "the first batch")
        finally:
            server.close()
        assert server.batches[0][2]["seq"] == 0


def test_a_phone_that_the_gateway_has_forgotten_enrols_anew(server: Server, free_port: int) -> None:
    with World(free_port) as phones:
        wait_until(lambda: server.batches, 15, "the first batch")
        server.known.clear()
        wait_until(lambda: any(device == "d-1" for device, _, _ in server.batches), 15, "a batch of the new device")
        assert phones.devices == {"1": "d-1"}
    fresh = [body["seq"] for device, _, body in server.batches if device == "d-1"]
    assert fresh == list(range(len(fresh)))


def test_a_batch_given_twice_is_posted_twice_under_one_number(server: Server, free_port: int) -> None:
    phones = World(free_port)
    first, second, third = phones.measured(0.0, 5.0)[:3]
    phones.start()
    phones.follow(time.time())
    for batch in (first, second, first, third):
        phones.post(batch)
    try:
        wait_until(lambda: len(server.batches) == 4, 15, "four batches")
    finally:
        phones.stop()
    assert [body["seq"] for _, _, body in server.batches] == [0, 1, 0, 2]
    assert server.batches[0][2]["imu"] == server.batches[2][2]["imu"]


def test_a_new_pass_of_the_world_is_no_duplicate_of_the_last(server: Server, free_port: int) -> None:
    """A clip that loops begins anew at second zero; to the gateway it is the same phone that goes on."""
    phones = World(free_port)
    batches = phones.measured(0.0, 5.0)[:3]
    phones.start()
    try:
        for done in (3, 6):
            phones.follow(time.time())
            for batch in batches:
                phones.post(batch)
            wait_until(lambda done=done: len(server.batches) == done, 15, "three batches more")  # type: ignore[misc]
    finally:
        phones.stop()
    assert [body["seq"] for _, _, body in server.batches] == list(range(6))
    assert len(server.enrolments) == 1
