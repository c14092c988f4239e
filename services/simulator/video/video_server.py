"""Rendered cameras as real network cameras serve theirs: an MJPEG stream and single stills over HTTP."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Iterable, Mapping

from fastapi import FastAPI, HTTPException
from fastapi.responses import PlainTextResponse, Response, StreamingResponse

__all__ = ["FrameFeed", "video_app"]

_BOUNDARY = "frame"


class FrameFeed:
    """The newest picture of one camera, from the thread that renders to any number of readers.

    A reader that is slow misses pictures and never holds up the renderer or other readers.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._readers: dict[object, tuple[asyncio.AbstractEventLoop, asyncio.Event]] = {}
        self._jpeg = b""
        self._t = 0.0
        self._number = 0
        self._closed = False
        self.someone_watches = threading.Event()

    def publish(self, jpeg: bytes, t: float) -> None:
        """Make ``jpeg``, the picture at true time ``t``, the newest."""
        with self._lock:
            self._jpeg, self._t = jpeg, t
            self._number += 1
            self._wake()

    def close(self) -> None:
        """End all streams."""
        with self._lock:
            self._closed = True
            self._wake()
        self.someone_watches.set()

    async def pictures(self) -> AsyncIterator[tuple[float, bytes]]:
        """Yield (true time, JPEG) of each new picture from now on."""
        changed = asyncio.Event()
        reader = object()
        with self._lock:
            self._readers[reader] = (asyncio.get_running_loop(), changed)
            seen = self._number
            self.someone_watches.set()
        try:
            while True:
                await changed.wait()
                changed.clear()
                with self._lock:
                    if self._closed:
                        return
                    fresh, seen = self._number != seen, self._number
                    t, jpeg = self._t, self._jpeg
                if fresh:
                    yield t, jpeg
        finally:
            with self._lock:
                del self._readers[reader]
                if not self._readers and not self._closed:
                    self.someone_watches.clear()

    def _wake(self) -> None:
        for loop, changed in self._readers.values():
            loop.call_soon_threadsafe(changed.set)


def video_app(feeds: Mapping[str, FrameFeed]) -> FastAPI:
    """Return the application that serves ``feeds`` by camera id."""
    app = FastAPI(title="Atrium simulator: rendered cameras", docs_url=None, redoc_url=None, openapi_url=None)

    @app.get("/cameras", response_class=PlainTextResponse)
    async def cameras() -> str:
        """List what can be watched."""
        return "".join(f"/cameras/{camera}.mjpeg\n/cameras/{camera}.jpg\n" for camera in feeds)

    @app.get("/cameras/{camera}.mjpeg")
    async def stream(camera: str) -> StreamingResponse:
        """Stream a camera's pictures for as long as the reader stays."""
        feed = _feed(feeds, camera)

        async def parts() -> AsyncIterator[bytes]:
            async for t, jpeg in feed.pictures():
                head = (
                    f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\nX-Timestamp: {t:.3f}"
                )
                yield b"".join([head.encode(), b"\r\n\r\n", jpeg, b"\r\n"])

        return StreamingResponse(
            parts(),
            media_type=f"multipart/x-mixed-replace; boundary={_BOUNDARY}",
            headers={"Cache-Control": "no-store"},
        )

    @app.get("/cameras/{camera}.jpg")
    async def still(camera: str) -> Response:
        """Return a camera's next picture."""
        async for t, jpeg in _feed(feeds, camera).pictures():
            return Response(
                jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store", "X-Timestamp": f"{t:.3f}"}
            )
        raise HTTPException(503, "the camera has been switched off")

    return app


def _feed(feeds: Mapping[str, FrameFeed], camera: str) -> FrameFeed:
    feed = feeds.get(camera)
    if feed is None:
        raise HTTPException(404, f"no rendered camera {camera!r}; there are: {_names(feeds)}")
    return feed


def _names(feeds: Iterable[str]) -> str:
    return ", ".join(feeds) or "none"
