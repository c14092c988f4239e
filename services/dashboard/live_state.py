"""What the dashboard knows at this moment, in the words the browser understands.

The API's answers and events go in; out come posts (topic, bytes) for the browsers. A browser that joins gets
``everything()`` first, so that it needs ``/live`` and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from services.dashboard.event_stream import Event, written

__all__ = ["LiveState", "Post", "scope_of"]

Post = tuple[str, bytes]
"""Topic within which the newest counts, and the event as it travels."""

ALERTS_KEPT = 100
SCOPES = {
    "connection": None,
    "site": "site",
    "zones": "site",
    "cameras": "site",
    "tracks": "positions",
    "alerts": "alerts",
    "alert": "alerts",
    "acknowledged": "alerts",
}
"""The scope that the API asks for each kind of post; None: it tells of nobody."""


def scope_of(topic: str) -> str | None:
    """Return the scope without which a post of this topic must not reach a browser."""
    return SCOPES[topic.partition("/")[0]]


class _Area(msgspec.Struct):
    area: str


_area_of = msgspec.json.Decoder(_Area).decode
_json = msgspec.json.Encoder().encode


class LiveState:
    """The newest of everything, each as a post.

    Every method returns the posts that tell browsers of the change. What is not as the API documents it raises
    msgspec's MsgspecError, KeyError or TypeError and changes nothing.
    """

    def __init__(self) -> None:
        self._posts: dict[str, bytes] = {}
        self._cameras: dict[str, Any] = {}
        self._alerts: dict[str, Any] = {}
        self._site: dict[str, Any] | None = None
        self.connection(False, "The dashboard has just started and is looking for the API.", 0.0)

    def everything(self, may: Callable[[str | None], bool] = lambda _: True) -> bytes:
        """Return all that a browser needs to draw the present, as one chunk: what its scopes allow (``may``)."""
        return b"".join(chunk for topic, chunk in self._posts.items() if may(scope_of(topic)))

    def connection(self, connected: bool, reason: str, since: float) -> list[Post]:
        """Tell whether the API is heard, why not, and since when (seconds since the epoch).

        Without it nobody knows who is where: a browser that joins now is not shown the last positions as the present.
        """
        if not connected:
            self._posts = {topic: chunk for topic, chunk in self._posts.items() if not topic.startswith("tracks/")}
        return [self._set("connection", {"connected": connected, "reason": reason, "since": since})]

    def answer(self, what: str, body: bytes) -> list[Post]:
        """Take the API's answer to ``GET /v1/{what}`` for what = site, zones, cameras or alerts (newest first)."""
        document = msgspec.json.decode(body)
        if what == "site":
            # Its zones are told by themselves: who draws them asks nobody to draw the whole map anew.
            drawn = {name: document[name] for name in document if name != "zones"}
            if drawn == self._site:
                return []
            self._site = drawn
            return [self._set(what, document)]
        rows = document[what]
        if what == "cameras":
            self._cameras = {camera["camera"]: camera for camera in rows}
        if what == "alerts":
            rows = rows[:ALERTS_KEPT]
            self._alerts = {alert["id"]: alert for alert in reversed(rows)}
        return [self._set(what, rows)]

    def event(self, event: Event) -> list[Post]:
        """Take an event of the API's stream; kinds this version does not know are ignored."""
        if event.name == "tracks":
            topic = f"tracks/{_area_of(event.data).area}"
            self._posts[topic] = written("tracks", event.data)
            return [(topic, self._posts[topic])]
        if event.name == "alert":
            alert = msgspec.json.decode(event.data)
            if alert["id"] in self._alerts:
                return []
            self._alerts[alert["id"]] = alert
            while len(self._alerts) > ALERTS_KEPT:
                del self._alerts[next(iter(self._alerts))]
            self._set("alerts", list(reversed(self._alerts.values())))
            return [(f"alert/{alert['id']}", written("alert", event.data))]
        if event.name == "acknowledged":
            news = msgspec.json.decode(event.data)
            topic = f"acknowledged/{news['id']}"
            if news["id"] in self._alerts:
                self._alerts[news["id"]]["acknowledged"] = news["acknowledged"]
                self._set("alerts", list(reversed(self._alerts.values())))
            return [(topic, written("acknowledged", event.data))]
        if event.name == "camera":
            camera = msgspec.json.decode(event.data)
            self._cameras[camera["camera"]] = camera
            return [self._set("cameras", list(self._cameras.values()))]
        return []

    def _set(self, topic: str, document: Any) -> Post:
        self._posts[topic] = written(topic, _json(document))
        return topic, self._posts[topic]
