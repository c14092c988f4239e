"""Run an ASGI application for as long as a service lives; used by the services that speak HTTP."""

from __future__ import annotations

import socket
import threading
from typing import Any

import structlog

from shared.runner import ServiceError

__all__ = ["serve"]

log = structlog.get_logger(__name__)


def serve(app: Any, host: str, port: int, stopping: threading.Event) -> None:
    """Serve ``app`` with uvicorn until ``stopping`` is set, then give open requests two seconds to end.

    Raises:
        ServiceError: the address cannot be listened on.
    """
    import uvicorn

    try:
        listener = socket.create_server((host, port), reuse_port=False)
    except OSError as error:
        raise ServiceError(f"cannot listen on {host}:{port}: {error.strerror}") from error
    config = uvicorn.Config(
        app, log_config=None, access_log=False, timeout_graceful_shutdown=2, lifespan="on", server_header=False
    )
    server = uvicorn.Server(config)

    # Off the main thread uvicorn leaves the signals alone: the runner owns them.
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="http", daemon=True)
    thread.start()
    log.info("listening", url=f"http://{host}:{listener.getsockname()[1]}")
    while thread.is_alive() and not stopping.wait(0.2):
        pass
    server.should_exit = True
    thread.join(timeout=4.0)
    if not stopping.is_set():
        raise ServiceError("the HTTP server ended by itself; the reason stands above in the log")
