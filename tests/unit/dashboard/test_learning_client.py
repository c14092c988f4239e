"""The learning page's client: one question for all browsers, and a reason in words where there is no answer."""

import asyncio
import http.server
import threading
from collections.abc import Iterator
from http import HTTPStatus

import pytest

from services.dashboard.learning_client import LearningClient, NoAnswer

KEY = "key-of-the-test"


class Api:
    """Answers everything with one status and body."""

    def __init__(self) -> None:
        self.status, self.body = 200, b'{"t": 1.0, "may_change": true}'
        self.asked: list[str] = []
        api = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                api.asked.append(self.path)
                status = api.status if self.headers["Authorization"] == f"Bearer {KEY}" else HTTPStatus.UNAUTHORIZED
                self.send_response(status)
                self.end_headers()
                self.wfile.write(api.body)

            do_POST = do_GET  # noqa: N815

            def log_message(self, *_: object) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


@pytest.fixture
def api() -> Iterator[Api]:
    running = Api()
    yield running
    running.server.shutdown()
    running.server.server_close()


def test_many_browsers_are_one_question(api: Api) -> None:
    async def ask() -> list[bool]:
        client = LearningClient(api.url, KEY)
        return [report.may_change for report in await asyncio.gather(*(client.report() for _ in range(10)))]

    assert asyncio.run(ask()) == [True] * 10
    assert api.asked == ["/v1/learning"]


@pytest.mark.parametrize(
    ("status", "body", "words"),
    [
        (403, b"{}", "the scope learning"),
        (503, b'{"detail": "the learning service is not running"}', "The learning service is not running."),
        (500, b"<html>", "status 500"),
        (200, b'{"t": "soon"}', "do both have the same version?"),
        (200, b"no JSON", "do both have the same version?"),
    ],
)
def test_where_there_is_no_answer_there_is_a_reason(api: Api, status: int, body: bytes, words: str) -> None:
    api.status, api.body = status, body
    with pytest.raises(NoAnswer, match=words.replace("?", r"\?")):
        asyncio.run(LearningClient(api.url, KEY).report())


def test_a_wrong_key_an_unreachable_api_and_an_odd_answer_to_an_order_are_told(api: Api) -> None:
    with pytest.raises(NoAnswer, match="scope learning"):
        asyncio.run(LearningClient(api.url, "wrong").order("freeze"))
    with pytest.raises(NoAnswer, match="is it running"):
        asyncio.run(LearningClient("http://127.0.0.1:1", KEY).picture("hall", "visits", None))
    with pytest.raises(NoAnswer, match="not understood"):
        asyncio.run(LearningClient(api.url, KEY).order("freeze"))
