"""A camera that gives no video says why, and keeps its password to itself."""

import base64
import hashlib
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from socketserver import StreamRequestHandler, ThreadingTCPServer

import pytest

from services.camera.no_stream import why_no_stream

Answer = Callable[[str], str]
REALM, NONCE, USER, PASSWORD = "cam", "abc", "viewer", "p@ss"


@contextmanager
def camera(answer: Answer) -> Iterator[int]:
    """A server that answers each request's head with ``answer``; yields its port."""

    class Handler(StreamRequestHandler):
        def handle(self) -> None:
            head = ""
            while not head.endswith("\r\n\r\n"):
                head += self.rfile.readline().decode()
            self.wfile.write(answer(head).encode())

    with ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


def digest(head: str) -> str:
    """A camera as most are: Digest without quality of protection."""
    said = dict(re.findall(r'(\w+)="([^"]*)"', head))
    method, target = head.split(" ")[:2]
    secret = hashlib.md5(f"{USER}:{REALM}:{PASSWORD}".encode()).hexdigest()
    wanted = hashlib.md5(f"{secret}:{NONCE}:{hashlib.md5(f'{method}:{target}'.encode()).hexdigest()}".encode())
    if said.get("response") == wanted.hexdigest() and said.get("username") == USER:
        return "RTSP/1.0 404 Not Found\r\nCSeq: 1\r\n\r\n"
    return f'RTSP/1.0 401 Unauthorized\r\nWWW-Authenticate: Digest realm="{REALM}", nonce="{NONCE}"\r\n\r\n'


def basic(head: str) -> str:
    right = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode() in head
    status = "200 OK\r\nContent-Type: text/html" if right else '401 No\r\nWWW-Authenticate: Basic realm="x"'
    return f"HTTP/1.0 {status}\r\n\r\n"


@pytest.mark.parametrize(
    ("answer", "address", "words"),
    [
        (digest, "rtsp://viewer:wrong@127.0.0.1:{}/stream2", "refuses this user and password"),
        (digest, "rtsp://127.0.0.1:{}/stream2", "wants a user and a password, and the address has none"),
        (digest, "rtsp://viewer:p%40ss@127.0.0.1:{}/stream2", "has no stream at /stream2"),
        (basic, "http://viewer:wrong@127.0.0.1:{}/video", "refuses this user and password"),
        (basic, "http://viewer:p%40ss@127.0.0.1:{}/video", "sends no video that can be decoded"),
        (lambda _: "220 mail\r\n\r\n", "rtsp://127.0.0.1:{}/stream2", "does not speak RTSP"),
        (lambda _: "RTSP/1.0 503 Busy\r\n\r\n", "rtsp://127.0.0.1:{}/stream2", "error 503"),
    ],
)
def test_what_the_camera_answers_is_told_in_plain_words(answer: Answer, address: str, words: str) -> None:
    with camera(answer) as port:
        told = why_no_stream(address.format(port))
    assert words in told
    assert "wrong" not in told
    assert "p%40ss" not in told


def test_where_nobody_answers_it_says_who_is_missing(free_port: int) -> None:
    assert f"nobody listens on port {free_port}" in why_no_stream(f"rtsp://127.0.0.1:{free_port}/stream2")
    assert "there is no host no-such-camera.invalid" in why_no_stream("rtsp://viewer:secret@no-such-camera.invalid/1")
    assert "the address is none" in why_no_stream("rtsp://127.0.0.1:port/1")


@pytest.mark.parametrize("host", ["192.168.1..20", f"{'x' * 64}.example", "no.such.host.invalid"])
def test_an_address_nobody_can_have_is_said_to_be_no_host(host: str) -> None:
    assert f"there is no host {host}" in why_no_stream(f"rtsp://{USER}:{PASSWORD}@{host}:554/x")
