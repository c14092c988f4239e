import json
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from served import served
from standin_api import KEY, StandInApi, tracks
from waiting import wait_until

from services.dashboard.event_stream import EventReader
from services.dashboard.sessions import Sessions, Visitor


@contextmanager
def browser(address: str, session: str = "") -> Iterator["Browser"]:
    """A reader of /live on a connection of its own."""
    watching = Browser(address, session)
    yield watching
    watching.close()


class Browser:
    def __init__(self, address: str, session: str = "") -> None:
        self.raw = b""
        self.ended = threading.Event()
        self._heard: queue.Queue[tuple[str, Any]] = queue.Queue()
        self._client = httpx.Client(timeout=20, cookies={"atrium_session": session})
        self._thread = threading.Thread(target=self._read, args=(address,), daemon=True)
        self._thread.start()

    def wait_for(self, name: str, matching: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the next event of this name that matches, skipping the others."""
        while True:
            heard, body = self._heard.get(timeout=15)
            if heard == name and matching(body):
                return body

    def close(self) -> None:
        self._client.close()

    def _read(self, address: str) -> None:
        reader = EventReader()
        try:
            with self._client.stream("GET", address + "/live") as response:
                for chunk in response.iter_bytes():
                    self.raw += chunk
                    for event in reader.feed(chunk):
                        self._heard.put((event.name, json.loads(event.data)))
        except httpx.HTTPError:
            pass
        self.ended.set()


@pytest.fixture
def ports() -> tuple[int, int]:
    with socket.socket() as one, socket.socket() as two:
        one.bind(("127.0.0.1", 0))
        two.bind(("127.0.0.1", 0))
        return one.getsockname()[1], two.getsockname()[1]


@pytest.fixture
def api(ports: tuple[int, int]) -> Iterator[StandInApi]:
    standin = StandInApi(ports[0]).start()
    yield standin
    standin.stop()


def test_a_browser_gets_the_present_then_every_change_and_never_the_key(
    ports: tuple[int, int], api: StandInApi
) -> None:
    api.zones = [{"id": "entrance", "name": "Entr\u2028ée", "inside": 3}]
    with served(ports[1], api.url) as address:
        wait_until(lambda: api.streams, 10, "the dashboard's stream")
        with browser(address) as first:
            first.wait_for("connection", lambda news: news["connected"])
            api.publish("tracks", tracks(track=[1], x=[4.5], device=["d-1"]))
            assert first.wait_for("tracks")["x"] == [4.5]
            api.publish("alert", {"id": "a1", "t": 5.0, "zone": "entrance", "kind": "enter"})
            assert first.wait_for("alert")["id"] == "a1"
            api.publish("camera", {"camera": "hall-east", "state": "degraded", "reason": "dark"})
            assert first.wait_for("cameras", bool)[0]["reason"] == "dark"
            # Who joins later is told the same without asking.
            with browser(address) as second:
                assert second.wait_for("site")["site"] == "test"
                assert second.wait_for("zones")[0]["inside"] == 3
                assert second.wait_for("alerts")[0]["id"] == "a1"
                assert second.wait_for("tracks")["device"] == ["d-1"]
                api.publish("tracks", tracks(track=[1], x=[5.5]))
                assert second.wait_for("tracks")["x"] == [5.5]
            # A camera that was calibrated anew is drawn anew.
            api.site = {**api.site, "cameras": [{"id": "hall-east", "position": [1, 2, 3]}]}
            assert first.wait_for("site", lambda site: site["cameras"])["cameras"][0]["position"] == [1, 2, 3]
            assert KEY.encode() not in first.raw
            assert api.keys_seen == {KEY}
            assert len(api.streams) == 1  # one connection for all browsers


def test_the_dashboard_says_that_the_api_is_gone_and_comes_back_by_itself(ports: tuple[int, int]) -> None:
    with served(ports[1], f"http://127.0.0.1:{ports[0]}") as address, browser(address) as watching:
        first = watching.wait_for("connection")
        assert not first["connected"]
        api = StandInApi(ports[0]).start()
        watching.wait_for("connection", lambda news: news["connected"])
        api.publish("tracks", tracks(track=[1], x=[1.0]))
        watching.wait_for("tracks")
        api.stop()
        lost = watching.wait_for("connection", lambda news: not news["connected"])
        assert lost["reason"]
        # Old positions are not the present.
        with browser(address) as late:
            late.wait_for("connection")
            assert b"event: tracks" not in late.raw
        api = StandInApi(ports[0]).start()
        watching.wait_for("connection", lambda news: news["connected"])
        api.publish("tracks", tracks(track=[1], x=[2.0]))
        assert watching.wait_for("tracks")["x"] == [2.0]
        api.stop()


def test_a_refused_key_is_told_in_plain_words(ports: tuple[int, int], api: StandInApi) -> None:
    with served(ports[1], api.url, key="wrong-key") as address, browser(address) as watching:
        news = watching.wait_for("connection", lambda news: "key" in news["reason"])
        assert "ATRIUM_API_KEY" in news["reason"]
        assert b"wrong-key" not in watching.raw


def test_events_that_make_no_sense_are_skipped_and_the_stream_goes_on(ports: tuple[int, int], api: StandInApi) -> None:
    with served(ports[1], api.url) as address, browser(address) as watching:
        watching.wait_for("connection", lambda news: news["connected"])
        api.send(b"event: tracks\ndata: {broken\n\nevent: tracks\ndata: 7\n\nevent: alert\ndata: {}\n\n")
        api.send(b"event: camera\ndata: []\n\nevent: unheard-of\ndata: 1\n\n")
        api.publish("tracks", tracks(track=[9]))
        assert watching.wait_for("tracks")["track"] == [9]


def test_an_alert_told_twice_is_shown_once(ports: tuple[int, int], api: StandInApi) -> None:
    with served(ports[1], api.url) as address, browser(address) as watching:
        watching.wait_for("connection", lambda news: news["connected"])
        for alert in ("a1", "a1", "a2"):
            api.publish("alert", {"id": alert, "t": 1.0, "zone": "z", "kind": "enter"})
        assert watching.wait_for("alert")["id"] == "a1"
        assert watching.wait_for("alert")["id"] == "a2"


def test_stopping_ends_open_streams_at_once(ports: tuple[int, int], api: StandInApi) -> None:
    with served(ports[1], api.url) as address:
        watching = Browser(address)
        watching.wait_for("connection", lambda news: news["connected"])
    assert watching.ended.wait(5)


def test_what_a_role_may_not_see_never_reaches_its_browser(ports: tuple[int, int], api: StandInApi) -> None:
    api.alerts = [{"id": "a-0", "device": "phone-of-ada"}]
    sessions = Sessions("a long password", KEY, 1.0)
    usher = sessions.begin(Visitor(KEY, "otto", "usher", frozenset({"site"})))
    guard = sessions.begin(Visitor(KEY, "maria", "guard", frozenset({"site", "positions", "alerts"})))
    with served(ports[1], api.url, sessions=sessions) as address:
        wait_until(lambda: api.streams, 10, "the dashboard's stream")
        with browser(address, usher) as one, browser(address, guard) as other:
            for watching in (one, other):
                watching.wait_for("connection", lambda news: news["connected"])
            api.publish("tracks", tracks(track=[1], device=["phone-of-ada"]))
            api.publish("alert", {"id": "a-1", "device": "phone-of-ada"})
            api.publish("camera", {"camera": "last"})
            for watching in (one, other):
                watching.wait_for("cameras", lambda rows: [row["camera"] for row in rows] == ["last"])
            assert [other.raw.count(f"event: {name}\n".encode()) for name in ("tracks", "alert", "alerts")] == [1, 1, 1]
            assert b"phone-of-ada" not in one.raw
            with browser(address, usher) as late:
                late.wait_for("cameras")
                assert b"phone-of-ada" not in late.raw
