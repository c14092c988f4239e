"""A small real HTTP server that keeps the API's contract, for tests that must make the API misbehave."""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator
from typing import Any

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from waiting import wait_until

KEY = "key-of-the-test"


class StandInApi:
    """Serves ``/v1/…`` on a port; what is published goes to every open stream."""

    def __init__(self, port: int, site: dict[str, Any] | None = None) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.site = site or {"site": "test", "floors": [], "areas": [], "cameras": [], "zones": [], "access_points": []}
        self.zones: list[dict[str, Any]] = []
        self.exhibits: list[dict[str, Any]] = []
        self.cameras: list[dict[str, Any]] = []
        self.alerts: list[dict[str, Any]] = []
        self.streams: set[asyncio.Queue[bytes | None]] = set()
        self.keys_seen: set[str] = set()
        self._port = port

    def start(self) -> "StandInApi":
        app = FastAPI()

        @app.middleware("http")
        async def guard(request: Request, call_next: Any) -> Response:
            key = request.headers.get("authorization", "").removeprefix("Bearer ")
            self.keys_seen.add(key)
            if key != KEY:
                return JSONResponse({"detail": "no valid key"}, 401)
            return await call_next(request)

        @app.get("/v1/{what}")
        async def answer(what: str) -> Response:
            if what == "site":
                return JSONResponse(self.site)
            if what != "stream":
                return JSONResponse({"t": time.time(), what: getattr(self, what)})
            return StreamingResponse(self._stream(), media_type="text/event-stream")

        config = uvicorn.Config(app, port=self._port, log_level="error", timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        wait_until(lambda: self._server.started, 10, "the stand-in API")
        return self

    def stop(self) -> None:
        self._each(None)
        self._server.should_exit = True
        self._thread.join(10)

    def publish(self, event: str, body: dict[str, Any]) -> None:
        self.send(b"event: " + event.encode() + b"\ndata: " + json.dumps(body, ensure_ascii=False).encode() + b"\n\n")

    def send(self, raw: bytes) -> None:
        self._each(raw)

    def _each(self, raw: bytes | None) -> None:
        def put() -> None:
            for stream in self.streams:
                stream.put_nowait(raw)

        self._loop.call_soon_threadsafe(put)

    def _run(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._loop.run_until_complete(self._server.serve())

    async def _stream(self) -> AsyncIterator[bytes]:
        queue: asyncio.Queue[bytes | None] = asyncio.Queue()
        self.streams.add(queue)
        try:
            yield b": stream\n\n"
            while (raw := await queue.get()) is not None:
                yield raw
        finally:
            self.streams.discard(queue)


def tracks(area: str = "hall", **columns: list[Any]) -> dict[str, Any]:
    """A ``tracks`` event as the API sends it; columns not given are filled up."""
    count = len(columns.get("track", []))
    filled: dict[str, list[Any]] = {
        "floor": ["ground"] * count,
        "x": [0.0] * count,
        "y": [0.0] * count,
        "vx": [0.0] * count,
        "vy": [0.0] * count,
        "state": ["confirmed"] * count,
        "device": [None] * count,
        "probability": [0.9] * count,
    }
    return {"area": area, "t": time.time(), "track": [], **filled, **columns}
