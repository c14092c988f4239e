"""An alert that somebody acknowledged is told to the browsers that watch and to those that come later."""

import json

from services.dashboard.event_stream import Event
from services.dashboard.live_state import LiveState

ALERT = {"id": "a-1", "zone": "entrance", "kind": "enter"}
SEEN = {"by": "office", "at": 2.0, "note": "fine"}


def test_an_acknowledgement_is_passed_on_and_remembered() -> None:
    state = LiveState()
    state.event(Event("alert", json.dumps(ALERT).encode()))
    ((topic, chunk),) = state.event(_acknowledged("a-1"))
    assert topic == "acknowledged/a-1"
    assert chunk.startswith(b"event: acknowledged\n")
    (line,) = [line for line in state.everything().split(b"\n") if b'"a-1"' in line]
    assert json.loads(line.removeprefix(b"data: ")) == [{**ALERT, "acknowledged": SEEN}]


def test_one_of_an_alert_long_forgotten_is_only_passed_on() -> None:
    state = LiveState()
    before = state.everything()
    assert len(state.event(_acknowledged("long-ago"))) == 1
    assert state.everything() == before


def _acknowledged(alert: str) -> Event:
    return Event("acknowledged", json.dumps({"id": alert, "acknowledged": SEEN}).encode())
