"""Whatever bytes are sent to whichever operation takes a body: the answer is a refusal that says what is wrong."""

import asyncio
import json
import re
from collections.abc import Iterator
from typing import Any

import pytest
from api_app import Api, api
from starlette.requests import Request

from services.api import request_body
from services.api.admin.geojson import GEOJSON
from services.api.problems import ProblemError
from services.api.request_body import DEEPEST, read_body, read_json

DEEP = 3000
REAL = {"camera": "hall-east", "item": "entrance", "name": "maria", "webhook": "wh-0", "alert": "a-0"}
BAD: list[bytes] = [
    b'{"\xff":1}',
    b'{"name":"\xff\xfe"}',
    b'{"name":"\xed\xa0\x80"}',
    b"\x00",
    b'{"name":"a\x00b"}',
    b'{"a\x00b":1}',
    b"\xff\xfe{\x00}\x00",
    b"\x80",
    b"[" * DEEP + b"]" * DEEP,
    b'{"name":' * DEEP + b"1" + b"}" * DEEP,
    b'{"name":' + b"[" * DEEP + b"]" * DEEP + b"}",
    b'{"name":1e999}',
    b'{"name":' + b"9" * 400 + b"}",
    b'{"name":"\\ud800"}',
    b"{",
    b"nothing",
]
"""None of them is a document that any operation takes."""
TEXTS = [b'{"%s":"a\\u0000b"}', b'{"%s":"Vault \\u202esretne"}', b'{"%s":"\\u0085"}', b'{"%s":"\\u2067x"}']
"""JSON, with a text in a field that no text of ours may be."""


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with api(tmp_path_factory.mktemp("bodies")) as one:
        yield one


def is_json(body: bytes) -> bool:
    try:
        json.loads(body.decode())
    except (ValueError, RecursionError):
        return False
    return True


def bodies(document: dict[str, Any]) -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """Yield method, path, media type and schema of every body the document knows."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for media, told in operation.get("requestBody", {}).get("content", {}).items():
                kind = told["schema"].get("$ref", "").rpartition("/")[2]
                schema = document["components"]["schemas"].get(kind, {})
                yield method, re.sub(r"\{(\w+)\}", lambda found: REAL[found[1]], path), media, schema


def test_every_operation_that_takes_a_body_refuses_bytes_that_are_none(here: Api) -> None:
    asked = 0
    for method, path, media, schema in bodies(here.client.get("/openapi.json").json()):
        for body in BAD + [text % field.encode() for text in TEXTS for field in schema.get("properties", ["name"])]:
            answer = here.client.request(method.upper(), path, content=body, headers={"Content-Type": media})
            where = f"{method} {path} {media} {body[:40]!r}: {answer.status_code} {answer.text[:200]}"
            if path.endswith("/import") and is_json(body):
                assert answer.status_code in (422, 503), f"learning's to judge, which does not run: {where}"
            else:
                assert 400 <= answer.status_code < 500, where
            assert answer.headers["Content-Type"] == "application/problem+json", where
            asked += 1
    assert asked > 15 * len(BAD)


def test_text_that_shows_itself_as_another_is_refused_and_right_to_left_text_is_not(here: Api) -> None:
    zone = {"id": "vault", "floor": "ground", "points": [[1, 6], [4, 6], [4, 9]]}
    told = here.client.post("/v1/zones", json=zone | {"name": "Vault \u202esretne"})
    assert (told.status_code, told.json()["field"]) == (422, "name")
    assert here.client.post("/v1/zones", json=zone | {"name": "כספת, line\u2028two"}).status_code == 201
    drawn = here.client.get("/v1/zones/vault", headers={"Accept": GEOJSON}).json()
    drawn["properties"] |= {"id": "other", "name": "\u2066x"}
    assert here.client.post("/v1/zones", json=drawn, headers={"Content-Type": GEOJSON}).status_code == 422


def test_a_document_may_be_as_deep_as_any_of_ours_and_no_deeper() -> None:
    read_json(b"[" * DEEPEST + b"]" * DEEPEST, "")
    with pytest.raises(ProblemError, match="within each other"):
        read_json(b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "")


def reading(*messages: dict[str, Any]) -> int:
    """The status with which a body is refused of which these parts come, and then nothing."""
    left = list(messages)

    async def receive() -> dict[str, Any]:
        if not left:
            await asyncio.Event().wait()
        return left.pop(0)

    with pytest.raises(ProblemError) as refused:
        asyncio.run(read_body(Request({"type": "http", "method": "POST", "headers": []}, receive), 1000))
    return refused.value.problem.status


def test_a_body_that_never_ends_is_waited_for_no_longer_than_it_may_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(request_body, "PATIENCE", 0.05)
    part = {"type": "http.request", "body": b"{", "more_body": True}
    assert reading(part) == 408
    assert reading(part, {"type": "http.disconnect"}) == 400
    assert reading(part | {"body": b" " * 1001}) == 413
