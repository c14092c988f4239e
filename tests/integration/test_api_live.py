"""The api service as a client meets it: a real router, real messages on the bus, real HTTP and a real event stream."""

import json
import re
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from api_in_process import running
from waiting import wait_until

from services.api.stream import READERS, SKIPPED
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Alert, CameraStatus, TrackFrame
from shared.site import Site, load_site

KEY = {"Authorization": "Bearer demo-api-key"}
KEYS = Keys("hall")
DEADLINE = 15.0


def frame(t: float, chunk: int = 0, people: int = 2, area: str = "hall") -> TrackFrame:
    return TrackFrame(
        t=t,
        area=area,
        chunk=chunk,
        tracker="test",
        track=list(range(1, people + 1)),
        floor=["ground"] * people,
        x=[9.0 + n for n in range(people)],
        y=[1.0] * people,
        covariance=[(0.04, 0.0, 0.05)] * people,
        vx=[1.0] * people,
        vy=[0.0] * people,
        state=["confirmed"] * people,
        device=["phone-1", *[None] * (people - 1)][:people],
        probability=[0.9] * people,
        runner_up=[None] * people,
        runner_up_probability=[0.0] * people,
        former=[[] for _ in range(people)],
        sources=[["hall-east"] for _ in range(people)],
        quality=[0.8] * people,
    )


def alert(number: int, zone: str = "entrance") -> Alert:
    return Alert(
        t=1000.0 + number, id=f"a-{number}", zone=zone, kind="enter", area="hall", track=1, floor="ground", x=9.0, y=1.0
    )


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


class Events:
    """Reads a server-sent stream in the background."""

    def __init__(self, address: str, headers: dict[str, str] | None = None, query: str = "") -> None:
        self.seen: list[tuple[str, dict[str, object]]] = []
        self.comments: list[str] = []
        self.ids: list[str] = []
        self.status = 0
        self._url = f"{address}/v1/stream{query}"
        self._headers = KEY | (headers or {})
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def of(self, event: str) -> list[dict[str, object]]:
        return [data for name, data in list(self.seen) if name == event]

    @property
    def ended(self) -> bool:
        return not self._thread.is_alive()

    def close(self) -> None:
        self._closing.set()
        self._thread.join(DEADLINE)

    def _read(self) -> None:
        try:
            with httpx.stream("GET", self._url, headers=self._headers, timeout=DEADLINE) as reply:
                self.status = reply.status_code
                name = ""
                for line in reply.iter_lines():
                    if self._closing.is_set():
                        return
                    if line.startswith(":"):
                        self.comments.append(line)
                    elif line.startswith("id: "):
                        self.ids.append(line.removeprefix("id: "))
                    elif line.startswith("event: "):
                        name = line.removeprefix("event: ")
                    elif line.startswith("data: "):
                        self.seen.append((name, json.loads(line.removeprefix("data: "))))
        except httpx.HTTPError:
            return


def get(address: str, path: str, status: int = 200) -> dict[str, object]:
    reply = httpx.get(address + path, headers=KEY)
    assert reply.status_code == status, reply.text
    body: dict[str, object] = reply.json()
    return body


def publishing(bus: Bus, condition: Callable[[], object], what: str) -> None:
    """Publish frames until ``condition`` holds."""
    tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)
    number = 0

    def step() -> object:
        nonlocal number
        number += 1
        tracks.publish(frame(time.time(), chunk=number))
        return condition()

    wait_until(step, DEADLINE, what)


def test_reads_and_stream_show_what_is_on_the_bus(site: Site, project: Path, zenoh_router: str, free_port: int) -> None:
    with running(site, project, zenoh_router, free_port) as address, Bus([zenoh_router]) as bus:
        assert get(address, "/v1/positions")["positions"] == []
        events = Events(address)
        publishing(bus, lambda: events.of("tracks"), "a tracks event")
        body = httpx.get(f"{address}/v1/positions", headers={"X-API-Key": "demo-api-key"}).json()
        assert [(p["device"], p["x"], p["state"]) for p in body["positions"]] == [("phone-1", 9.0, "confirmed")]
        assert body["positions"][0]["age"] < 5.0
        assert get(address, "/v1/positions/phone-1")["track"] == 1
        missing = get(address, "/v1/positions/phone-2", status=404)
        assert (missing["field"], missing["found"]) == ("device", "phone-2")
        everybody = get(address, "/v1/tracks?area=hall")["tracks"]
        assert [(t["track"], t["device"]) for t in everybody] == [(1, "phone-1"), (2, None)]  # type: ignore[attr-defined]
        entrance = get(address, "/v1/zones")["zones"][0]  # type: ignore[index]
        assert (entrance["id"], entrance["inside"]) == ("entrance", 2)
        columns = events.of("tracks")[-1]
        assert columns["track"] == [1, 2]
        assert columns["device"] == ["phone-1", None]
        told = bus.publisher(KEYS.alert("entrance"), Alert, cached=True, history=10)
        told.publish(alert(1))
        status = bus.publisher(KEYS.camera_status("hall-east"), CameraStatus, cached=True)
        status.publish(CameraStatus(t=time.time(), camera="hall-east", state="degraded", reason="no picture for 5 s"))
        wait_until(lambda: events.of("alert"), DEADLINE, "the alert on the stream")
        wait_until(
            lambda: [c for c in events.of("camera") if c["state"] == "degraded"], DEADLINE, "the camera's status"
        )
        assert events.ids == sorted(events.ids, key=int)
        assert len(set(events.ids)) == len(events.ids)
        assert get(address, "/v1/cameras")["cameras"][0]["reason"] == "no picture for 5 s"  # type: ignore[index]
        health = get(address, "/v1/health")
        assert "camera hall-east: no picture for 5 s" in health["problems"]  # type: ignore[operator]
        assert health["status"] == "degraded"
    wait_until(lambda: events.ended, DEADLINE, "the open stream to end with the service")


def test_a_late_joiner_gets_the_cached_alerts_and_can_resume(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with Bus([zenoh_router]) as bus:
        told = bus.publisher(KEYS.alert("entrance"), Alert, cached=True, history=10)
        for number in range(5):
            told.publish(alert(number))
        with running(site, project, zenoh_router, free_port) as address:
            wait_until(lambda: len(get(address, "/v1/alerts")["alerts"]) == 5, DEADLINE, "five alerts")  # type: ignore[arg-type]
            newest = get(address, "/v1/alerts?limit=2&zone=entrance")["alerts"]
            assert [a["id"] for a in newest] == ["a-4", "a-3"]  # type: ignore[attr-defined]
            (point,) = get(address, "/v1/alerts?limit=1&format=geojson&crs=wgs84")["features"]  # type: ignore[misc]
            assert (point["id"], point["properties"]["zone"]) == ("a-4", "entrance")
            assert point["geometry"]["coordinates"] == pytest.approx([12.45, 41.91], abs=0.01)
            after = get(address, "/v1/alerts?since=1970-01-01T00:16:43Z")["alerts"]
            assert [a["id"] for a in after] == ["a-4"]  # type: ignore[attr-defined]
            polled = get(address, "/v1/alerts?after=a-1&limit=2")["alerts"]
            assert [a["id"] for a in polled] == ["a-2", "a-3"]  # type: ignore[attr-defined]
            events = Events(address, {"Last-Event-ID": "a-2"})
            wait_until(lambda: len(events.of("alert")) == 2, DEADLINE, "the alerts missed")
            assert [told["id"] for told in events.of("alert")] == ["a-3", "a-4"]
            events.close()


def test_a_router_that_restarts_in_mid_run_is_survived(site: Site, project: Path, free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    broker = router(endpoint)
    from conftest import unused_port

    with running(site, project, endpoint, unused_port()) as address, Bus([endpoint]) as bus:
        events = Events(address)
        publishing(bus, lambda: events.of("tracks"), "tracks before the restart")
        broker.close()
        wait_until(
            lambda: "the bus router cannot be reached" in str(get(address, "/v1/health")["problems"]),
            DEADLINE,
            "health to tell of the lost router",
        )
        assert get(address, "/v1/positions/phone-1")["device"] == "phone-1"
        broker = router(endpoint)
        before = len(events.of("tracks"))
        publishing(bus, lambda: len(events.of("tracks")) > before + 3, "tracks on the same stream after the restart")
        events.close()
    broker.close()


def test_positions_age_and_health_tells_when_tracks_stop(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with (
        running(site, project, zenoh_router, free_port, stale_after=0.3) as address,
        Bus([zenoh_router]) as bus,
    ):
        publishing(bus, lambda: get(address, "/v1/positions")["positions"], "a position")
        first = get(address, "/v1/positions")["positions"][0]["age"]  # type: ignore[index]
        wait_until(
            lambda: get(address, "/v1/positions")["positions"][0]["age"] > first + 0.4,  # type: ignore[index]
            DEADLINE,
            "the age to grow",
        )
        wait_until(
            lambda: "positions are getting old" in str(get(address, "/v1/health")["problems"]), DEADLINE, "plain words"
        )
        wait_until(
            lambda: {"service": "api", "instance": "0", "alive": True} in get(address, "/v1/health")["services"],  # type: ignore[operator]
            DEADLINE,
            "liveliness",
        )
        events = Events(address)
        wait_until(lambda: any("still here" in c for c in events.comments), DEADLINE, "a keep-alive comment")
        events.close()


def test_health_says_what_services_find_wrong_themselves(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with running(site, project, zenoh_router, free_port) as address, Bus([zenoh_router]) as bus:
        bus.answer(Keys(site.site).health("fusion", "0"), lambda: b'{"time": "time went backwards, 5 or more"}')
        bus.answer(Keys(site.site).health("odd", "0"), lambda: b"no JSON")
        wait_until(
            lambda: "fusion: time went backwards, 5 or more" in get(address, "/v1/health")["problems"],  # type: ignore[operator]
            DEADLINE,
            "fusion's own words",
        )


def test_a_wrong_key_is_refused_everywhere(site: Site, project: Path, zenoh_router: str, free_port: int) -> None:
    keys = '[{"name": "guide", "key": "guide-app-key-0001", "scopes": ["positions"]}, "demo-api-key"]'
    with running(site, project, zenoh_router, free_port, api_keys=keys) as address:
        paths = list(httpx.get(f"{address}/openapi.json").json()["paths"])
        assert len(paths) >= 40
        with httpx.Client(base_url=address) as stranger:
            for path in [*paths, "/v1/nothing", "/v2"]:
                for headers in (
                    {},
                    {"Authorization": "Bearer wrong-key"},
                    {"X-API-Key": ""},
                    {"Authorization": "Basic x"},
                ):
                    reply = stranger.get(path, headers=headers)
                    assert reply.status_code == 401
                    assert reply.json()["type"] == "urn:atrium:unauthorized"
                    assert "Bearer" in reply.headers["WWW-Authenticate"]
        guide = {"Authorization": "Bearer guide-app-key-0001"}
        assert httpx.get(f"{address}/v1/positions", headers=guide).status_code == 200
        refused = httpx.get(f"{address}/v1/alerts", headers=guide)
        assert (refused.status_code, refused.json()["allowed"]) == (403, "a key with the scope alerts")
        assert httpx.get(f"{address}/v1/site", headers=guide | {"Origin": "http://evil"}).status_code == 403
        assert "access-control-allow-origin" not in httpx.get(f"{address}/docs", headers={"Origin": "http://x"}).headers


def test_bad_input_is_a_typed_answer(site: Site, project: Path, zenoh_router: str, free_port: int) -> None:
    with running(site, project, zenoh_router, free_port) as address:
        for path, status, field in (
            ("/v1/alerts?limit=0", 422, "limit"),
            ("/v1/alerts?limit=many", 422, "limit"),
            ("/v1/alerts?since=nan", 422, "since"),
            ("/v1/alerts?since=yesterday", 422, "since"),
            ("/v1/alerts?zone=nowhere", 404, "zone"),
            ("/v1/alerts?after=forgotten", 404, "after"),
            ("/v1/tracks?area=nowhere", 404, "area"),
            ("/v1/stream?area=nowhere", 404, "area"),
            ("/v1/nothing", 404, "path"),
        ):
            problem = get(address, path, status)
            assert problem["field"] == field
            assert problem["found"]
            assert problem["allowed"]
        wrong = httpx.post(f"{address}/v1/positions", headers=KEY)
        assert (wrong.status_code, wrong.json()["field"]) == (405, "method")
        page = httpx.get(address, follow_redirects=True)
        assert page.url.path == "/docs"
        assets = re.findall(r'(?:src|href)="([^"]+)"', page.text)
        assert any(asset.endswith(".js") for asset in assets)
        for asset in assets:
            assert asset.startswith("/"), "the page loads nothing from the internet"
            assert httpx.get(address + asset).status_code == 200
        site_body = httpx.get(f"{address}/v1/site", headers=KEY).text
        assert "mjpeg" not in site_body
        assert "02:a7" not in site_body


def test_a_reader_that_stops_reading_costs_nothing_and_finds_the_newest(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with (
        running(site, project, zenoh_router, free_port, stream_rate=100.0),
        Bus([zenoh_router]) as bus,
        socket.socket() as client,
    ):
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", free_port))
        client.sendall(b"GET /v1/stream HTTP/1.1\r\nHost: x\r\nX-API-Key: demo-api-key\r\n\r\n")
        tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)
        number, skipped = 0, SKIPPED.labels("tracks")._value.get()

        def crowd() -> bool:
            nonlocal number
            number += 1
            tracks.publish(frame(float(number), chunk=number, people=1000))
            return number > 100

        wait_until(crowd, DEADLINE, "more events than wait on the way to the reader that does not read")
        client.settimeout(DEADLINE)
        last = f'"t":{number}.0,'.encode()
        seen = b""
        while last not in seen:
            seen = seen[-40:] + client.recv(1 << 20)
        assert SKIPPED.labels("tracks")._value.get() > skipped + 20


def test_streams_that_are_left_make_room_for_others(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with running(site, project, zenoh_router, free_port, stream_readers=2, stream_keep_alive=0.1) as address:
        before = READERS._value.get()
        for _ in range(3):
            two = [Events(address), Events(address)]
            wait_until(lambda two=two: all(each.comments for each in two), DEADLINE, "two open streams")
            refused = httpx.get(f"{address}/v1/stream", headers=KEY)
            assert (refused.status_code, refused.headers["Retry-After"]) == (503, "5")
            for each in two:
                each.close()
            wait_until(lambda: READERS._value.get() == before, DEADLINE, "both readers to be forgotten")
