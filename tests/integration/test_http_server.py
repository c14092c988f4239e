"""The HTTP server inside a service: a taken port is told, a reader that never leaves does not keep the service."""

import socket
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection
from typing import Any

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


@contextmanager
def serving(app: FastAPI, **settings: Any) -> Iterator[int]:
    """The port of a server that lives as long as the block."""
    port, stopping = unused_port(), threading.Event()
    server = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), kwargs=settings, daemon=True)
    server.start()

    def listens() -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5):
            return True
        return False

    try:
        wait_until(listens, 20.0, "the server to listen")
        yield port
    finally:
        stopping.set()
        server.join()


HEAD = b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 5\r\nPad: " + 200 * b"x" + b"\r\n\r\n"


def test_who_does_not_get_to_the_end_of_a_head_loses_the_connection_and_nobody_else_does() -> None:
    app = FastAPI()

    @app.post("/")
    async def size(request: Request) -> int:
        return len(await request.body())

    with serving(app, head_within=2.0, keep_alive=60) as port, ExitStack() as open_ones:

        def connected(sent: bytes) -> socket.socket:
            connection = open_ones.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20))
            connection.sendall(sent)
            return connection

        def answered_in_full(connection: socket.socket) -> bool:
            told = b""
            while part := connection.recv(4096):
                told += part
                if told.endswith(b"\r\n\r\n5"):
                    return True
            return False

        waits_for_body = connected(HEAD)
        answered = connected(HEAD + b"12345")
        assert answered_in_full(answered)
        late = [connected(b""), connected(HEAD[:20])]
        answered.sendall(HEAD[:20])
        late.append(answered)
        drips = connected(HEAD[:1])
        rest = iter(HEAD[1:-1])

        def cut() -> bool:
            """A byte now and then does not help."""
            try:
                drips.sendall(bytes([next(rest)]))
                drips.settimeout(0.05)
                return drips.recv(1) == b""
            except TimeoutError:
                return False
            except (ConnectionError, StopIteration):
                return True

        wait_until(cut, 20.0, "the end of who sends byte by byte")
        assert next(rest, None) is not None
        assert [connection.recv(1) for connection in late] == [b""] * 3
        waits_for_body.sendall(b"12345")
        assert answered_in_full(waits_for_body)
        halves = connected(HEAD[:20])
        halves.sendall(HEAD[20:] + b"12345")
        assert answered_in_full(halves)


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
        with serving(app, proxies=proxies) as port:
            connection = HTTPConnection("127.0.0.1", port, timeout=10)
            headers = {"X-Forwarded-For": "6.6.6.6, 10.1.1.1", "X-Forwarded-Proto": "https"}
            connection.request("GET", "/", headers=headers)
            assert connection.getresponse().read().decode() == f'"{told}"'
            connection.close()
