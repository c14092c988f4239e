"""Whatever is sent to any path of the document, the answer is no 5xx of ours, and every refusal says what is wrong.

Two ways: cases that schemathesis makes from the document, as many right and wrong ones for every operation; and texts
that have broken other people's software, in every text field that the document knows. Bytes that are no document at
all: ``test_api_bad_bodies``.
"""

from __future__ import annotations

import contextlib
import copy
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import requests
import schemathesis
from api_in_process import running
from conftest import unused_port
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from learning_double import learning
from schemathesis.generation import GenerationMode
from test_api_live import KEYS, alert
from waiting import wait_until

from shared.bus import Bus, router
from shared.messages import Alert
from shared.site import load_site

KEY = {"X-API-Key": "demo-api-key"}
CASES = 2
"""Of each operation, right ones and as many wrong ones, where so many can be made."""
TEXTS = [
    "'; DROP TABLE api_alerts; --",
    '" OR ""="',
    "%' UNION SELECT secret FROM api_webhooks --",
    "<script>alert(1)</script>",
    "{{7*7}}${7*7}",
    "../../etc/passwd",
    "a\x00b",
    "\r\nX-Injected: yes",
    "\u202eright to left\U0001f600",
    "\ud7ff\ufffe",
    "9" * 400,
    "x" * 5000,
    "",
    "NaN",
    "-1e999",
]
NOT_NOW = {503}
"""Too many streams, a service that does not run: an answer, not a failure; it has Retry-After."""


@pytest.fixture(scope="module")
def address(project: Path) -> Iterator[str]:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    broker = router(endpoint)
    with (
        Bus([endpoint]) as bus,
        learning(bus, site),
        running(site, project, endpoint, unused_port(), webhook_networks=["127.0.0.0/8"]) as at,
    ):
        bus.publisher(KEYS.alert("entrance"), Alert).publish(alert(1))
        wait_until(lambda: httpx.get(f"{at}/v1/alerts/a-1", headers=KEY).status_code == 200, 15.0, "an alert")
        yield at
    broker.close()


@pytest.fixture(scope="module")
def document(address: str) -> dict[str, Any]:
    told: dict[str, Any] = httpx.get(f"{address}/openapi.json").json()
    return told


def checked(answer: requests.Response, sent: object, tally: Counter[int]) -> None:
    """A stream is left once its status is known; a refusal has the one shape."""
    tally[answer.status_code] += 1
    try:
        where = f"{answer.request.method} {answer.request.url} {sent!r:.300}"
        if answer.status_code in NOT_NOW:
            assert answer.headers["Retry-After"], where
        assert answer.status_code < 500 or answer.status_code in NOT_NOW, f"{where}: {answer.text}"
        if answer.status_code >= 400 and answer.request.method != "HEAD" and answer.text:
            # What is no HTTP at all is refused by the server itself, in plain text.
            if answer.headers.get("Content-Type", "").startswith("application/problem+json"):
                assert answer.json()["status"] == answer.status_code, where
            else:
                assert answer.status_code == 400, where
    finally:
        answer.close()


def takes_text(schema: dict[str, Any]) -> bool:
    """Whether a parameter may be any text; numbers and choices refuse all texts at one place."""
    return any(one.get("type") == "string" and "enum" not in one for one in schema.get("anyOf", [schema]))


def fuzz(session: requests.Session, address: str, operation: Any, mode: GenerationMode, tally: Counter[int]) -> int:
    """Send what schemathesis makes for one operation; return how many cases, those that HTTP cannot carry too."""
    tried = 0

    @settings(max_examples=CASES, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(operation.as_strategy(generation_mode=mode))
    def send(case: schemathesis.Case) -> None:
        nonlocal tried
        tried += 1
        asked = case.as_transport_kwargs(base_url=address)
        asked["headers"] = {**asked.get("headers", {}), **KEY}
        try:
            answer = session.request(**asked, stream=True, timeout=10.0, allow_redirects=False)
        except (requests.exceptions.InvalidHeader, requests.exceptions.InvalidURL, UnicodeError):
            return  # nothing was sent
        checked(answer, asked.get("json"), tally)

    with contextlib.suppress(Unsatisfiable):  # what has no inputs has no wrong ones
        send()
    return tried


def test_nothing_generated_from_the_document_breaks_the_api(address: str, document: dict[str, Any]) -> None:
    operations = [result.ok() for result in schemathesis.openapi.from_dict(document).get_all_operations()]
    assert len(operations) == sum(len(each) for each in document["paths"].values())
    tally: Counter[int] = Counter()
    cases: Counter[str] = Counter()
    with requests.Session() as session:
        for operation in operations:
            for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
                cases[operation.label] += fuzz(session, address, operation, mode, tally)
    with_inputs = {
        f"{method.upper()} {path}"
        for path, each in document["paths"].items()
        for method, operation in each.items()
        if operation.get("parameters") or operation.get("requestBody")
    }
    assert [one for one in cases if cases[one] < (2 * CASES if one in with_inputs else 1)] == []
    assert tally[200] > len(operations) / 3, tally
    assert tally[422] + tally[404] > len(operations) / 3, tally


def replaced(body: Any, text: str) -> Iterator[Any]:
    """Yield the body once for each text or key in it, that replaced."""
    if isinstance(body, str):
        yield text
    elif isinstance(body, dict):
        yield {**body, text: text}
        for name, part in body.items():
            for other in replaced(part, text):
                yield {**body, name: other}
    elif isinstance(body, list):
        yield [*body, text]
        for place, part in enumerate(body):
            for other in replaced(part, text):
                changed = copy.copy(body)
                changed[place] = other
                yield changed


def test_sql_and_script_in_every_text_field_are_only_text(address: str, document: dict[str, Any]) -> None:
    hook = {"url": "http://127.0.0.1:9/hook"}
    made = httpx.post(f"{address}/v1/webhooks", headers=KEY, json=hook).json()["id"]
    real = {"alert": "a-1", "webhook": made, "area": "hall", "device": "phone-1", "kind": "visits"}
    tally: Counter[int] = Counter()
    with requests.Session() as session:
        session.headers.update(KEY)

        def send(method: str, path: str, **more: Any) -> None:
            request = session.prepare_request(requests.Request(method.upper(), address + path, **more))
            checked(session.send(request, stream=True, timeout=10.0, allow_redirects=False), more, tally)

        def filled(path: str, **texts: str) -> str:
            return re.sub(r"\{(\w+)\}", lambda found: texts.get(found[1]) or real.get(found[1], "it"), path)

        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                # What is deleted could be asked no more.
                plain = path if method == "delete" else filled(path)
                for parameter in operation.get("parameters", []):
                    for text in TEXTS if takes_text(parameter["schema"]) else TEXTS[:2]:
                        if parameter["in"] == "query":
                            send(method, plain, params={parameter["name"]: text})
                        elif parameter["in"] == "path":
                            send(method, filled(path, **{parameter["name"]: requests.utils.quote(text, safe="")}))
                for text in TEXTS:
                    for media in operation.get("requestBody", {}).get("content", {}).values():
                        example = media.get("example", {})
                        if path.startswith("/v1/webhooks"):
                            example = example | hook
                        for body in replaced(example, text):
                            send(method, plain, json=body)
                        send(method, plain, data=text.encode())
    assert tally[200] > 50
    assert tally[422] > 300
    told = httpx.get(f"{address}/v1/webhooks", headers=KEY).json()["webhooks"]
    assert TEXTS[0] in [one["name"] for one in told], "text is text"
    assert httpx.get(f"{address}/v1/alerts", headers=KEY).json()["alerts"][0]["id"] == "a-1"
