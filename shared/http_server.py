"""Run an ASGI application for as long as a service lives; used by the services that speak HTTP."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from shared.runner import ServiceError

__all__ = ["Tls", "serve", "timed_out"]

log = structlog.get_logger(__name__)

STREAM_BUFFER = 128 * 1024
"""Bytes that wait in the system for a client of a stream."""
_TIMED_OUT = "connection_timed_out"
"""Of the state of a request."""


@dataclass(frozen=True, slots=True)
class Tls:
    """PEM files with which a server proves who it is."""

    certificate: Path
    key: Path


def serve(
    app: Any,
    host: str,
    port: int,
    stopping: threading.Event,
    *,
    tls: Tls | None = None,
    frame_bytes: int = 1 << 20,
    proxies: Sequence[str] = (),
    keep_alive: int = 5,
    connections: int | None = None,
    head_within: float = 10.0,
    stalled_after: float | None = None,
) -> None:
    """Serve ``app`` with uvicorn until ``stopping`` is set, then give open requests two seconds to end.

    Args:
        app: the ASGI application.
        host: where to listen.
        port: where to listen; 0: any free port.
        stopping: ends serving.
        tls: speak HTTPS.
        frame_bytes: largest message of a WebSocket; a larger one closes it (1009).
        proxies: addresses or networks whose ``X-Forwarded-For`` and ``X-Forwarded-Proto`` are believed.
        keep_alive: seconds after which an idle connection is closed.
        connections: open at once; more are answered 503.
        head_within: seconds from the beginning of a connection, or of a later request on it, in which the request's
            head must be there; else the connection is closed: who sends half of it would keep the place of another.
        stalled_after: for applications that stream: seconds after which the system cuts a connection whose other end
            takes nothing of what waits for it (Linux; ``timed_out`` tells). What waits there is then bounded, so that
            an application that has much to say notices before, and WebSockets are sent uncompressed, so that what
            many are told is made once.

    Raises:
        ServiceError: the address cannot be listened on, or certificate and key cannot be used.
    """
    import uvicorn
    from uvicorn.protocols.http.auto import AutoHTTPProtocol
    from uvicorn.protocols.websockets.auto import AutoWebSocketsProtocol

    if tls is not None:
        _check(tls)

    try:
        listener = socket.create_server((host, port), reuse_port=False)
    except OSError as error:
        raise ServiceError(f"cannot listen on {host}:{port}: {error.strerror}") from error
    if stalled_after is not None:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, STREAM_BUFFER)
    if stalled_after is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(stalled_after * 1000.0))
    config = uvicorn.Config(
        app,
        http=_punctual(_telling(AutoHTTPProtocol), head_within),
        ws=_telling(AutoWebSocketsProtocol),
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=2,
        lifespan="on",
        server_header=False,
        ssl_certfile=None if tls is None else tls.certificate,
        ssl_keyfile=None if tls is None else tls.key,
        ws_max_size=frame_bytes,
        ws_per_message_deflate=stalled_after is None,
        proxy_headers=bool(proxies),
        forwarded_allow_ips=list(proxies),
        timeout_keep_alive=keep_alive,
        limit_concurrency=connections,
    )
    server = uvicorn.Server(config)

    # Off the main thread uvicorn leaves the signals alone: the runner owns them.
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="http", daemon=True)
    thread.start()
    scheme = "http" if tls is None else "https"
    log.info("listening", url=f"{scheme}://{host}:{listener.getsockname()[1]}")
    while thread.is_alive() and not stopping.wait(0.2):
        pass
    server.should_exit = True
    thread.join(timeout=4.0)
    if not stopping.is_set():
        raise ServiceError("the HTTP server ended by itself; the reason stands above in the log")


def timed_out(scope: Mapping[str, Any]) -> bool:
    """Return whether the system cut a request's connection because its other end took nothing (``stalled_after``)."""
    return _TIMED_OUT in scope["state"]


def _telling(protocol: Any) -> Any:
    """Return a protocol of uvicorn that notes with the request why the system cut its connection."""

    class Telling(protocol):  # type: ignore[misc]
        def connection_lost(self, exc: Exception | None) -> None:
            scope = getattr(self, "scope", None)
            if isinstance(exc, TimeoutError) and scope is not None:
                scope["state"][_TIMED_OUT] = True
            super().connection_lost(exc)

    return Telling


def _punctual(protocol: Any, head_within: float) -> Any:
    """Return an HTTP protocol of uvicorn that closes a connection whose next request does not get to its body.

    Uvicorn's own timer runs between the end of an answer and the first byte of the next request.
    """

    class Punctual(protocol):  # type: ignore[misc]
        _head_by: float | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._await_head()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.cycle is None or self.cycle.response_complete:
                self._await_head()
            else:
                self._head_by = None

        def _await_head(self) -> None:
            if self.transport.is_closing() or self.transport.get_protocol() is not self:
                return
            if self._head_by is None:
                self._head_by = self.loop.time() + head_within
            self.timeout_keep_alive_task = self.loop.call_at(self._head_by, self.timeout_keep_alive_handler)

    return Punctual


def _check(tls: Tls) -> None:
    for path in (tls.certificate, tls.key):
        try:
            path.read_bytes()
        except OSError as error:
            raise ServiceError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(tls.certificate, tls.key, password="")
    except (ssl.SSLError, ValueError) as error:
        raise ServiceError(
            f"{tls.certificate} and {tls.key}: no certificate with its key in PEM form, without a passphrase: {error}"
        ) from error
