"""The Python client against a real API: what its README promises."""

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
from api_app import people
from api_in_process import running
from atrium_client import (
    AtriumClient,
    AtriumError,
    Conflict,
    Event,
    Exhibit,
    NotAllowed,
    NotFound,
    Rule,
    TryLater,
    Zone,
)
from atrium_client.event_stream import lines, parse
from conftest import unused_port
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_until

from services.api.alerts.event_numbers import BLOCK
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Alert, Erasure, TrackFrame
from shared.site import load_site

KEYS = Keys("hall")
VAULT = Zone(id="vault", floor="ground", points=[(1.0, 6.0), (4.0, 6.0), (4.0, 9.0)])


def alert(number: int) -> Alert:
    return Alert(
        t=1000.0 + number,
        id=f"a-{number}",
        zone="entrance",
        kind="enter",
        area="hall",
        track=1,
        floor="ground",
        x=9.0,
        y=1.0,
    )


@pytest.fixture(scope="module")
def world(project: Path) -> Iterator[tuple[str, Bus]]:
    """An API's address, and the bus it listens to."""
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    broker = router(endpoint)
    site = load_site(project / "deploy/sites/hall/site.yaml")
    with running(site, project, endpoint, unused_port()) as address, Bus([endpoint]) as bus:
        yield address, bus
    broker.close()


@pytest.fixture
def atrium(world: tuple[str, Bus]) -> Iterator[AtriumClient]:
    with AtriumClient(world[0], "demo-api-key") as client:
        yield client


def seen(world: tuple[str, Bus], atrium: AtriumClient) -> None:
    tracks = world[1].publisher(KEYS.tracks("hall"), TrackFrame)
    numbers = iter(range(10_000))

    def step() -> bool:
        walking = {"vx": [1.0, 0.0], "chunk": next(numbers)}
        tracks.publish(people(time.time(), ("phone-1", 9.0, 1.0), (None, 10.0, 1.0), **walking))
        return bool(atrium.positions())

    wait_until(step, 15.0, "a position")


def test_who_is_where(world: tuple[str, Bus], atrium: AtriumClient) -> None:
    seen(world, atrium)
    assert [(p.device, p.x, p.floor) for p in atrium.positions(zone="entrance", near=(9.0, 1.0, 0.5))] == [
        ("phone-1", 9.0, "ground")
    ]
    here = atrium.position("phone-1")
    assert here is not None
    assert here.state == "confirmed"
    assert atrium.position("nobody/../phone-1") is None
    assert [(t.track, t.device) for t in atrium.tracks(area="hall")] == [(1, "phone-1"), (2, None)]
    assert [(d.device, d.zones) for d in atrium.devices()] == [("phone-1", ["entrance"])]
    assert atrium.positions(confidence=1.0) == []
    with pytest.raises(NotFound) as caught:
        atrium.positions(zone="nowhere")
    assert (caught.value.field, caught.value.found) == ("zone", "nowhere")


def test_zones_are_drawn_and_nobodys_change_is_lost(atrium: AtriumClient) -> None:
    made = atrium.add_zone(VAULT)
    made.rules.append(Rule(id="too-long", kind="dwell", limit=30.0))
    mine, other = atrium.zone("vault"), atrium.zone("vault")
    mine.name, other.name = "Mine", "Other"
    mine.rules = made.rules
    kept = atrium.put_zone(mine)
    assert (kept.name, kept.rules[0].limit) == ("Mine", 30.0)
    with pytest.raises(Conflict):
        atrium.put_zone(other)
    with pytest.raises(AtriumError) as caught:
        atrium.put_zone(Zone(id="vault", floor="ground", points=[(0.0, 0.0), (1.0, 1.0)]))
    assert (caught.value.status, caught.value.field) == (422, "points")
    atrium.delete_zone("vault", etag=kept.etag)
    assert "vault" not in [zone.id for zone in atrium.zones()]


def test_alerts_are_acknowledged_once_and_erasures_followed(world: tuple[str, Bus], atrium: AtriumClient) -> None:
    publisher = world[1].publisher(KEYS.alert("entrance"), Alert)
    publisher.publish(alert(77))
    (waiting,) = wait_until(lambda: [one for one in atrium.alerts() if one.id == "a-77"], 15.0, "the alert")
    assert waiting.acknowledged is None
    seen = atrium.acknowledge("a-77", note="all is well").acknowledged
    assert seen is not None
    assert (seen.by, seen.note) == ("demo", "all is well")
    with pytest.raises(Conflict):
        atrium.acknowledge("a-77")
    with pytest.raises(TryLater):
        atrium.erase("d-1")  # no gateway runs here
    erasures = world[1].publisher(KEYS.erasure(), Erasure)
    erasures.publish(Erasure(t=5.0, device="d-1"))
    (erased,) = wait_until(atrium.erasures, 15.0, "the erasure")
    assert (erased.device, erased.t) == ("d-1", 5.0)
    assert "history" in erased.waiting


def test_a_guide_app_asks_what_is_in_front_of_its_visitor(world: tuple[str, Bus], atrium: AtriumClient) -> None:
    seen(world, atrium)
    bust = atrium.add_exhibit(Exhibit(id="bust", floor="ground", x=12.0, y=1.0))
    far = atrium.in_front_of("phone-1")
    assert far is not None
    assert (far.exhibits[0].id, far.exhibits[0].distance, far.exhibits[0].bearing) == ("bust", 3.0, 0.0)
    bust.x = 10.0
    atrium.put_exhibit(bust)
    near = atrium.in_front_of("phone-1")
    assert near is not None
    assert (near.exhibits[0].probability or 0.0) > (far.exhibits[0].probability or 0.0) > 0.0
    assert atrium.in_front_of("nobody") is None
    atrium.delete_exhibit("bust")
    assert [one.id for one in atrium.exhibits()] == ["vase", "statue", "model", "cabinet", "globe"]


def test_staff_sign_in(world: tuple[str, Bus]) -> None:
    user = {"name": "maria", "role": "viewer", "password": "correct horse battery"}
    httpx.post(f"{world[0]}/v1/users", json=user, headers={"X-API-Key": "demo-api-key"}).raise_for_status()
    with AtriumClient(world[0]) as client:
        with pytest.raises(NotAllowed):
            client.positions()
        assert client.sign_in("maria", "correct horse battery").role == "viewer"
        assert client.site()["site"] == "hall"
        assert client.health()["status"] in ("ok", "degraded")
        with pytest.raises(NotAllowed, match="zones"):
            client.add_zone(VAULT)
        client.sign_out()
        with pytest.raises(NotAllowed):
            client.positions()


def test_a_stream_that_is_lost_goes_on_after_the_last_alert(project: Path, tmp_path: Path) -> None:
    endpoint, port = f"tcp/127.0.0.1:{unused_port()}", unused_port()
    broker = router(endpoint)
    site = load_site(project / "deploy/sites/hall/site.yaml")
    told, numbers = list[str](), list[int]()
    database = f"sqlite:///{tmp_path}/api.db"
    joined = threading.Event()

    def follow() -> None:
        with AtriumClient(f"http://127.0.0.1:{port}", "demo-api-key") as client:
            for event in client.events(area="hall"):
                joined.set()
                if event.name == "alert":
                    numbers.append(int(event.id))
                    told.append(event.data["id"])
                if told[-1:] == ["a-3"]:
                    return

    with Bus([endpoint]) as bus:
        publisher = bus.publisher(KEYS.alert("entrance"), Alert, cached=True, history=10)
        with running(site, project, endpoint, port, api_database_url=database):
            reader = threading.Thread(target=follow, daemon=True)
            reader.start()
            assert joined.wait(15.0)
            for number in range(2):
                publisher.publish(alert(number))
                wait_until(lambda number=number: len(told) > number, 15.0, "the alert")  # type: ignore[misc]
        publisher.publish(alert(2))
        with running(site, project, endpoint, port, api_database_url=database):
            with AtriumClient(f"http://127.0.0.1:{port}", "demo-api-key") as client:
                wait_until(lambda: len(client.alerts()) == 3, 15.0, "the cached alerts")
                assert [one.id for one in client.alerts_after("a-0")] == ["a-1", "a-2"]
            wait_until(lambda: told[-1:] == ["a-2"], 20.0, "the alert missed meanwhile")
            publisher.publish(alert(3))
            reader.join(15.0)
    broker.close()
    assert told == ["a-0", "a-1", "a-2", "a-3"]
    # Not of the clock, which may be set back meanwhile: above all that the first run had in reserve.
    assert numbers[1] + BLOCK - 1_000_000 < numbers[2] < numbers[3]


def test_a_stream_waits_when_the_api_is_busy_and_gives_up_when_it_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    monkeypatch.setattr("atrium_client.client.time.sleep", pauses.append)
    answers = [
        httpx.Response(503, headers={"Retry-After": "5"}, json={"title": "Too many streams"}),
        httpx.Response(502, text="<html>"),
        httpx.Response(200, text="id: a-1\nevent: alert\ndata: {}\n\n"),
        httpx.Response(403, json={"title": "Scope missing"}),
    ]
    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.headers.get("Last-Event-ID", ""))
        return answers[len(asked) - 1]

    client = AtriumClient("http://x", "k", transport=httpx.MockTransport(answer))
    events = client.events(after="a-0")
    assert next(events) == Event("alert", {}, "a-1")
    with pytest.raises(NotAllowed):
        next(events)
    assert asked == ["a-0", "a-0", "a-0", "a-1"]
    assert pauses[0] == 5.0
    assert pauses[-1] == 0.5, "once it works the pauses begin anew"


def test_a_stream_without_loss_asks_for_every_event_since_and_says_when_they_are_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("atrium_client.client.time.sleep", lambda seconds: None)
    answers = [
        httpx.Response(200, text="id: 8\nevent: alert\ndata: {}\n\nid: 9\nevent: tracks\ndata: {}\n\n"),
        httpx.Response(410, json={"title": "No longer held"}),
    ]
    asked: list[dict[str, str]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(dict(request.url.params))
        return answers[len(asked) - 1]

    client = AtriumClient("http://x", "k", transport=httpx.MockTransport(answer))
    events = client.events(kinds=["alert"], after="7", lossless=True)
    assert next(events).id == "8"
    with pytest.raises(AtriumError, match="410"):
        next(events)
    assert asked == [{"kinds": "alert", "from": "7"}, {"kinds": "alert", "from": "8"}]


def test_errors_say_when_to_come_again_and_survive_a_proxys_page() -> None:
    answers = {
        "/v1/positions": httpx.Response(429, headers={"Retry-After": "3"}, json={"detail": "slow down"}),
        "/v1/site": httpx.Response(502, text="<html>bad gateway"),
    }
    client = AtriumClient("http://x", transport=httpx.MockTransport(lambda request: answers[request.url.path]))
    with pytest.raises(TryLater) as caught:
        client.positions()
    assert caught.value.retry_after == 3.0
    with pytest.raises(AtriumError, match="bad gateway"):
        client.site()


def test_long_lists_are_asked_for_in_pages() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        first = int(request.url.params.get("cursor", "-1")) + 1
        row: dict[str, Any] = {"state": "lost", "area": "a", "floor": "f", "zones": [], "probability": 1.0}
        rows = [row | {"device": str(n), "t": 0.0, "age": 0.0} for n in range(first, min(first + 2, 5))]
        return httpx.Response(200, json={"devices": rows, "next": str(first + 1) if first + 2 < 5 else None})

    client = AtriumClient("http://x", transport=httpx.MockTransport(answer))
    assert [row.device for row in client.devices()] == ["0", "1", "2", "3", "4"]


def test_a_stream_goes_on_over_any_text_in_a_note() -> None:
    note = "two\u2028lines\u2029and\x85more"
    told = f'id: 8\nevent: acknowledged\ndata: {{"note": "{note}"}}\n\nid: 9\r\nevent: alert\r\ndata: {{}}\r\n\r\n'
    answer = httpx.MockTransport(lambda _: httpx.Response(200, text=told))
    events = AtriumClient("http://x", "k", transport=answer).events()
    assert [next(events), next(events)] == [Event("acknowledged", {"note": note}, "8"), Event("alert", {}, "9")]


words = st.text(st.characters(exclude_characters="\r\n", exclude_categories=["Cs"]), max_size=20)


@given(st.lists(st.tuples(words, words, st.booleans()), max_size=10), st.integers(1, 50))
def test_events_are_read_as_they_were_written(events: list[tuple[str, str, bool]], size: int) -> None:
    written = []
    for name, data, numbered in events:
        written += [": a comment", f"event: {name}", *(["id: 7"] if numbered else [])]
        written += [f"data: {msgspec.json.encode(data).decode()}", ""]
    stream = "".join(f"{line}\n" for line in written).encode()
    chunks = [stream[at : at + size] for at in range(0, len(stream), size)]
    read = [event for event in parse(lines(chunks)) if event is not None]
    assert [(event.name, event.data, event.id == "7") for event in read] == events


def test_what_the_readme_shows_runs(world: tuple[str, Bus], project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (project / "clients/python/README.md").read_text(encoding="utf-8")
    first, second, _ = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    with AtriumClient(world[0], "demo-api-key") as atrium:
        seen(world, atrium)
        exec(second, {"atrium": atrium, "Conflict": Conflict})
        assert atrium.zone("entrance").name == "Main entrance"
    shown = first.replace("http://127.0.0.1:8081", world[0])
    shown = shown[: shown.index("    for event")]
    exec(shown)
    assert "phone-1 ground 9.0 1.0" in capsys.readouterr().out


def test_what_the_readme_shows_staff_do_runs(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (project / "clients/python/README.md").read_text(encoding="utf-8")
    told = msgspec.to_builtins(alert(1)) | {"acknowledged": None}
    erased = {"device": "d-7f3a", "t": 1.0, "done": [], "waiting": ["history"]}
    answers = {
        ("POST", "/v1/session"): {"token": "x", "user": "maria", "role": "desk", "scopes": [], "expires": 9.0},
        ("GET", "/v1/alerts"): {"t": 1.0, "alerts": [told]},
        ("POST", "/v1/alerts/a-1/acknowledge"): told | {"acknowledged": {"by": "maria", "at": 2.0, "note": ""}},
        ("DELETE", "/v1/devices/d-7f3a"): erased,
    }
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append((request.method, request.url.path))
        return httpx.Response(200, json=answers[asked[-1]])

    with AtriumClient("http://x", transport=httpx.MockTransport(answer)) as atrium:
        exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[2], {"atrium": atrium})
    assert asked == list(answers)
    assert capsys.readouterr().out == "['history']\n"
