"""Stands in for the API: keeps zones and alerts as the contract says, and tells of a day in the demo hall.

A browser test of the dashboard changes what it keeps and looks at what came.
"""

import asyncio
import json
import math
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import httpx
import msgspec
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from waiting import wait_until

from services.api.site_view import site_view
from services.api.zones_drawn import zones_of
from shared.http_server import serve
from shared.site import Site
from shared.zones import ZoneDefinition

KEY = "the-key-of-the-office"
DEVICES = ["d-7f3a11c1b07", None, "d-11c0a5520e4", None]


@dataclass
class Double:
    """What it keeps, and what it was told."""

    site: Site
    zones: dict[str, dict[str, Any]] = field(default_factory=dict)
    exhibits: dict[str, dict[str, Any]] = field(default_factory=dict)
    alerts: list[dict[str, Any]] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    """Method, path and query of every request but the stream's."""
    erased: list[str] = field(default_factory=list)
    """Devices whose consent staff ended."""
    problems: list[str] = field(default_factory=list)
    """Of its health."""
    scopes: list[str] = field(default_factory=lambda: ["acknowledge", "zones-admin"])
    """Of the key, as far as the pages look at them."""
    key_ends: float = 2e9
    """When the one key of a program ends."""
    refuse: dict[str, Any] | None = None
    """With which problem the next change is refused."""

    def keep(self, zone: ZoneDefinition) -> dict[str, Any]:
        """Keep a zone and return it as told."""
        told = msgspec.to_builtins(zone) | {"inside": 1, "unseen": 0, "etag": _etag()}
        self.zones[zone.id] = told | {"polygon": told["points"]}
        return self.zones[zone.id]

    def keep_exhibit(self, exhibit: dict[str, Any]) -> dict[str, Any]:
        """Keep an exhibit and return it as told."""
        self.exhibits[exhibit["id"]] = {"name": "", "reach": 8.0, "facing": None, **exhibit, "etag": _etag()}
        return self.exhibits[exhibit["id"]]

    def raise_alert(self, **changes: Any) -> dict[str, Any]:
        """Add an alert, newest first."""
        alert = {
            "t": time.time(),
            "id": f"605d049a-{len(self.alerts) + 1}",
            "zone": "entrance",
            "kind": "enter",
            "area": "hall",
            "track": 1,
            "floor": "ground",
            "x": 10.0,
            "y": 1.2,
            "device": DEVICES[0],
            "rule": "enter",
            "value": None,
            "limit": None,
            "direction": None,
            "other_track": None,
            "other_device": None,
            "acknowledged": None,
        } | changes
        self.alerts.insert(0, alert)
        return alert


@contextmanager
def running(site: Site, port: int) -> Iterator[Double]:
    """Serve the double until the block ends."""
    double = Double(site)
    for zone in site.zones:
        double.keep(ZoneDefinition(id=zone.id, name=zone.name, floor=zone.floor, points=zone.polygon))
    double.keep_exhibit({"id": "model", "name": "The model", "floor": "ground", "x": 10.0, "y": 8.0})
    stopping = threading.Event()
    app = _app(double, stopping)
    thread = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), daemon=True)
    thread.start()
    wait_until(lambda: _answers(port), 10, "the double of the API")
    yield double
    stopping.set()
    thread.join(6)


def _app(double: Double, stopping: threading.Event) -> FastAPI:
    app = FastAPI(openapi_url=None)

    @app.middleware("http")
    async def noted(request: Request, call_next: Any) -> Any:
        if request.headers.get("authorization") != f"Bearer {KEY}":
            return _problem(401, "no key")
        if request.url.path != "/v1/stream":
            query = f"?{request.url.query}" if request.url.query else ""
            double.asked.append(f"{request.method} {request.url.path}{query}")
        if request.method != "GET" and double.refuse is not None:
            refused, double.refuse = double.refuse, None
            return JSONResponse(refused, refused["status"])
        return await call_next(request)

    @app.get("/v1/site")
    async def site() -> Response:
        return _json(msgspec.to_builtins(site_view(double.site, zones_of(double.site))))

    @app.get("/v1/session")
    async def session() -> Response:
        return _json({"name": "office", "role": None, "scopes": double.scopes, "expires": None})

    @app.get("/v1/users")
    async def users() -> Response:
        return _json({"users": [{"name": "anna", "role": "guard", "created": 1.7e9}]})

    @app.get("/v1/keys")
    async def keys() -> Response:
        row = {"id": "k1", "name": "the dashboard", "scopes": ["read", "zones-admin"], "rate": 50.0, "created": 1.7e9}
        return _json({"keys": [row | {"expires": double.key_ends}]})

    @app.get("/v1/webhooks")
    async def webhooks() -> Response:
        row = {
            "id": "w1",
            "name": "the guards",
            "url": "https://guards.example/alerts",
            "kinds": ["crowd"],
            "zones": [],
        }
        state = {"enabled": True, "waiting": 0, "dead": 2, "last_success": 1.7e9, "last_reason": "status 503"}
        return _json({"webhooks": [row | state]})

    @app.get("/v1/audit")
    async def audit() -> Response:
        row = {"t": 1.7e9, "who": "dashboard", "action": "change the zone", "subject": "zones/entrance", "status": 200}
        return _json({"entries": [row | {"times": 1, "detail": '{"points": [[7, 0], [13, 0]]}'}], "next": None})

    @app.get("/v1/zones")
    async def zones() -> Response:
        return _json({"t": time.time(), "zones": list(double.zones.values())})

    @app.post("/v1/zones")
    async def add(request: Request) -> Response:
        return _kept(double, await request.body(), None)

    @app.put("/v1/zones/{zone}")
    async def replace(zone: str, request: Request) -> Response:
        if request.headers.get("if-match") not in (None, double.zones[zone]["etag"]):
            return _problem(412, "it was changed meanwhile")
        return _kept(double, await request.body(), zone)

    @app.delete("/v1/zones/{zone}")
    async def remove(zone: str) -> Response:
        del double.zones[zone]
        return Response(status_code=204)

    @app.get("/v1/alerts")
    async def alerts(
        zone: str | None = None, kinds: str | None = None, device: str | None = None, acknowledged: bool | None = None
    ) -> Response:
        wanted = {"zone": zone, "kind": kinds, "device": device}
        rows = [row for row in double.alerts if all(value in (None, row[name]) for name, value in wanted.items())]
        if acknowledged is not None:
            rows = [row for row in rows if (row["acknowledged"] is not None) == acknowledged]
        return _json({"t": time.time(), "alerts": rows, "next": None})

    @app.post("/v1/alerts/{alert}/acknowledge")
    async def acknowledge(alert: str, request: Request) -> Response:
        row = next(row for row in double.alerts if row["id"] == alert)
        row["acknowledged"] = {"by": "office", "at": time.time(), "note": (await request.json())["note"]}
        return _json(row)

    @app.get("/v1/cameras")
    async def cameras() -> Response:
        return _json({"t": time.time(), "cameras": [_camera()]})

    @app.get("/v1/tracks")
    async def tracks() -> Response:
        return _json({"t": time.time(), "tracks": _tracks(time.time())})

    @app.get("/v1/positions/{device}")
    async def position(device: str) -> Response:
        row = next((row for row in _tracks(time.time()) if row["device"] == device), None)
        return _problem(404, "there is no such device") if row is None else _json(row)

    @app.get("/v1/positions")
    async def positions() -> Response:
        return _json({"t": time.time(), "positions": [row for row in _tracks(time.time()) if row["device"]]})

    @app.get("/v1/health")
    async def health() -> Response:
        services = [("api", True), ("fusion", True), ("gateway", not double.problems)]
        return _json(
            {
                "t": time.time(),
                "status": "degraded" if double.problems else "ok",
                "problems": double.problems,
                "services": [{"service": name, "instance": "0", "alive": alive} for name, alive in services],
                "areas": [{"area": "hall", "t": time.time(), "age": 0.1, "people": 4}],
                "cameras": [_camera()],
            }
        )

    @app.get("/v1/heatmap")
    async def heatmap(floor: str, since: float, until: float, cell: float) -> Response:
        return _json(_heat(floor, cell))

    @app.get("/v1/exhibits")
    async def exhibits() -> Response:
        return _json({"t": time.time(), "exhibits": list(double.exhibits.values())})

    @app.post("/v1/exhibits")
    async def add_exhibit(request: Request) -> Response:
        return _json(double.keep_exhibit(await request.json()), 201)

    @app.put("/v1/exhibits/{exhibit}")
    async def replace_exhibit(exhibit: str, request: Request) -> Response:
        if request.headers.get("if-match") != double.exhibits[exhibit]["etag"]:
            return _problem(412, "it was changed meanwhile")
        return _json(double.keep_exhibit(await request.json()))

    @app.delete("/v1/exhibits/{exhibit}")
    async def remove_exhibit(exhibit: str) -> Response:
        del double.exhibits[exhibit]
        return Response(status_code=204)

    @app.get("/v1/dwell")
    async def dwell(since: float, until: float, at: str = "zones") -> Response:
        if at == "exhibits":
            row = {"id": "model", "people": 77, "visits": 90, "mean": 61.0, "median": 40.0, "p90": 170.0}
            return _json({"since": since, "until": until, "places": [row]})
        rows = [
            {"id": "entrance", "people": 412, "visits": 530, "mean": 48.0, "median": 22.0, "p90": 130.0},
            {"id": "model-corner", "people": None, "visits": None, "mean": None, "median": None, "p90": None},
        ]
        rows += [rows[1] | {"id": name} for name in list(double.zones)[2:] if name.startswith("z")][:148]
        return _json({"since": since, "until": until, "places": rows})

    @app.get("/v1/flows")
    async def flows() -> Response:
        counts: list[list[int | None]] = [[12, 131], [None, 0]]
        more = [name for name in double.zones if name.startswith("z")][:148]
        rows = [[*row, *[0] * len(more)] for row in counts] + [[0] * (2 + len(more)) for _ in more]
        return _json({"zones": ["entrance", "model-corner", *more], "counts": rows})

    @app.get("/v1/occupancy")
    async def occupancy(since: float, until: float, step: int) -> Response:
        t = [since + step * n for n in range(max(int((until - since) / step), 1))]
        people = [None if n % 7 == 3 else 8.0 + 6.0 * math.sin(n / 3.0) for n in range(len(t))]
        most = [None if value is None else round(value) + 3 for value in people]
        places = [{"id": name, "people": people, "most": most, "phones": people} for name in double.zones]
        for place in places:
            if place["id"] == "z1999":
                place["people"] = [value and value + 1.0 for value in people]
        return _json({"time_zone": "UTC", "t": t, "places": places})

    def erasure(device: str, *waiting: str) -> dict[str, Any]:
        done = [{"service": "history", "t": time.time()}]
        return {"device": device, "t": time.time() - 60, "waiting": waiting, "done": done}

    @app.get("/v1/erasures")
    async def erasures() -> Response:
        rows = [erasure("d-0badc0ffee1", "learning"), *(erasure(device) for device in double.erased)]
        return _json({"t": time.time(), "erasures": rows})

    @app.delete("/v1/devices/{device}")
    async def erase(device: str) -> Response:
        if device not in DEVICES:
            return _problem(404, f"there is no device {device!r}")
        double.erased.append(device)
        return _json(erasure(device, "learning"), 202)

    @app.get("/v1/privacy/retention")
    async def retention() -> Response:
        row = {"what": "where phones were", "settings": ["history_phone_days"], "seconds": 2.5 * 86400.0, "note": ""}
        return _json({"t": time.time(), "kept": [row | {"service": "history"}], "silent": ["learning"]})

    @app.get("/v1/stream")
    async def stream() -> StreamingResponse:
        return StreamingResponse(_events(double, stopping), media_type="text/event-stream")

    return app


def _kept(double: Double, body: bytes, replaced: str | None) -> Response:
    try:
        zone = msgspec.json.decode(body, type=ZoneDefinition)
    except msgspec.ValidationError as error:
        words, _, place = str(error).partition(" - at `$.")
        return _problem(422, words, field=place.rstrip("`"))
    if replaced is None and zone.id in double.zones:
        return _problem(409, f"there is a zone {zone.id!r} already", field="id")
    return _json(double.keep(zone), 201 if replaced is None else 200)


async def _events(double: Double, stopping: threading.Event) -> AsyncIterator[bytes]:
    told = {alert["id"] for alert in double.alerts}
    while not stopping.is_set():
        yield b"event: tracks\ndata: " + json.dumps(_columns(time.time())).encode() + b"\n\n"
        for alert in [row for row in double.alerts if row["id"] not in told]:
            told.add(alert["id"])
            yield b"event: alert\ndata: " + json.dumps(alert).encode() + b"\n\n"
        await asyncio.sleep(0.1)


def _tracks(now: float) -> list[dict[str, Any]]:
    rows = []
    for number, device in enumerate(DEVICES):
        angle = 0.1 * now + 2.0 * math.pi * number / len(DEVICES)
        rows.append(
            {
                "track": number + 1,
                "area": "hall",
                "floor": "ground",
                "x": 10.0 + 7.0 * math.cos(angle),
                "y": 5.5 + 4.0 * math.sin(angle),
                "covariance": [0.04, 0.0, 0.09],
                "vx": -0.7 * math.sin(angle),
                "vy": 0.4 * math.cos(angle),
                "t": now,
                "age": 0.1,
                "state": "confirmed",
                "device": device,
                "probability": 0.93 if device else 0.8,
                "runner_up": DEVICES[2] if number == 0 else None,
                "runner_up_probability": 0.05 if number == 0 else 0.0,
                "former": [7, 9] if number == 0 else [],
                "device_since": now - 60.0 if device else None,
                "sources": ["hall-east", device] if device else ["hall-east"],
                "quality": 0.9,
            }
        )
    return rows


def _columns(now: float) -> dict[str, Any]:
    rows = _tracks(now)
    names = (
        "floor",
        "track",
        "x",
        "y",
        "vx",
        "vy",
        "state",
        "device",
        "device_since",
        "probability",
        "quality",
    )
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in names}
    return {"area": "hall", "t": now, **columns, "accuracy": [0.3] * len(rows)}


def _camera() -> dict[str, Any]:
    return {
        "camera": "hall-east",
        "area": "hall",
        "state": "ok",
        "reason": "",
        "frames": 120,
        "dropped": 0,
        "frames_per_s": 15.0,
        "t": time.time(),
        "age": 0.5,
    }


def _heat(floor: str, cell: float) -> dict[str, Any]:
    """A warm middle, a cold wall, and cells of few people that nobody is told of."""
    wide, high = round(20.0 / cell), round(12.0 / cell)
    seconds: list[list[float | None]] = []
    people: list[list[int | None]] = []
    for j in range(high):
        far = [math.hypot((i + 0.5) * cell - 10.0, (j + 0.5) * cell - 7.0) for i in range(wide)]
        warm = [900.0 * math.exp(-((d / 3.0) ** 2)) for d in far]
        seconds.append([None if 1.0 < w < 6.0 else 0.0 if w <= 1.0 else w for w in warm])
        people.append([None if 1.0 < w < 6.0 else 0 if w <= 1.0 else 5 + int(w / 10.0) for w in warm])
    return {"floor": floor, "origin": [0.0, 0.0], "cell": cell, "seconds": seconds, "people": people}


def _json(document: Any, status: int = 200) -> Response:
    return Response(json.dumps(document), status, media_type="application/json")


def _etag() -> str:
    return f'"{time.monotonic_ns()}"'


def _problem(status: int, detail: str, field: str | None = None) -> JSONResponse:
    body = {"type": "urn:atrium:test", "title": "Refused", "status": status, "detail": detail, "field": field}
    return JSONResponse(body, status, media_type="application/problem+json")


def _answers(port: int) -> bool:
    try:
        return httpx.get(f"http://127.0.0.1:{port}/v1/site", timeout=2).status_code == 401
    except httpx.HTTPError:
        return False
