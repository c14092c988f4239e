"""The HTTP server inside a service: a taken port is told, a reader that never leaves does not keep the service."""

import socket
import threading
import time
from collections.abc import AsyncIterator
from http.client import HTTPConnection

import pytest
from conftest import unused_port
from fastapi import FastAPI, Request
from fastapi.responses import StreamingResponse
from waiting import wait_until

from shared.http_server import serve
from shared.runner import STOP_WITHIN, ServiceError


def endless_app() -> FastAPI:
    import asyncio

    app = FastAPI()

    async def lines() -> AsyncIterator[bytes]:
        while True:
            yield b"data: still here\n\n"
            await asyncio.sleep(0.05)

    @app.get("/stream")
    async def stream() -> StreamingResponse:
        return StreamingResponse(lines(), media_type="text/event-stream")

    return app


def test_a_taken_port_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ServiceError, match=f"cannot listen on 127.0.0.1:{port}: Address already in use"):
            serve(endless_app(), "127.0.0.1", port, threading.Event())


def test_a_reader_of_an_endless_stream_does_not_keep_the_service_from_stopping() -> None:
    port, stopping = unused_port(), threading.Event()
    server = threading.Thread(target=serve, args=(endless_app(), "127.0.0.1", port, stopping))
    server.start()
    connection = HTTPConnection("127.0.0.1", port, timeout=10)

    def connected() -> bool:
        try:
            connection.connect()
        except OSError:
            return False
        return True

    wait_until(connected, 10.0, "the server to listen")
    connection.request("GET", "/stream")
    reply = connection.getresponse()
    assert reply.read(4) == b"data"
    begin = time.monotonic()
    stopping.set()
    server.join(10.0)
    assert not server.is_alive()
    assert time.monotonic() - begin < STOP_WITHIN - 0.5  # before the runner's patience ends
    connection.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=1)


def test_only_a_named_proxy_is_believed_whom_it_speaks_for() -> None:
    app = FastAPI()

    @app.get("/")
    async def who(request: Request) -> str:
        return f"{request.client.host if request.client else ''} {request.url.scheme}"

    for proxies, told in (
        ((), "127.0.0.1 http"),
        (("127.0.0.0/8",), "10.1.1.1 https"),
        (("10.0.0.9",), "127.0.0.1 http"),
    ):
        port, stopping = unused_port(), threading.Event()
        server = threading.Thread(
            target=serve, args=(app, "127.0.0.1", port, stopping), kwargs={"proxies": proxies}, daemon=True
        )
        server.start()

        def answer(port: int = port) -> str | None:
            connection = HTTPConnection("127.0.0.1", port, timeout=10)
            headers = {"X-Forwarded-For": "6.6.6.6, 10.1.1.1", "X-Forwarded-Proto": "https"}
            try:
                connection.request("GET", "/", headers=headers)
                return connection.getresponse().read().decode()
            except OSError:
                return None
            finally:
                connection.close()

        try:
            assert wait_until(answer, 10.0, "an answer") == f'"{told}"'
        finally:
            stopping.set()
            server.join()
