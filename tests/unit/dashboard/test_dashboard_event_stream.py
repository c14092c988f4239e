import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.dashboard.event_stream import LARGEST_EVENT, Event, EventReader, StreamError, written

names = st.sampled_from(["tracks", "alert", "camera", "something-new"])
documents = st.recursive(st.none() | st.integers() | st.text(max_size=20), lambda inner: st.lists(inner, max_size=3))


@given(st.lists(st.tuples(names, documents), max_size=8), st.data())
def test_events_survive_wherever_the_network_cuts_them(events: list[tuple[str, object]], data: st.DataObject) -> None:
    sent = [Event(name, json.dumps(document, ensure_ascii=False).encode()) for name, document in events]
    stream = b": hello\n\n" + b"".join(written(event.name, event.data) + b": still here\n\n" for event in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    reader = EventReader()
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [event for piece in pieces for event in reader.feed(piece)] == sent


def test_line_separators_inside_text_end_no_line() -> None:
    name = "Caf\u2028e\x85\x0b"
    assert EventReader().feed(b"data: " + name.encode() + b"\n\n") == [Event("message", name.encode())]


def test_windows_line_ends_and_unknown_fields_are_read() -> None:
    assert EventReader().feed(b"event: alert\r\nid: 7\r\nretry: 5\r\ndata:{}\r\n\r\n") == [Event("alert", b"{}")]


def test_a_line_feed_in_the_data_does_not_tear_the_event() -> None:
    (event,) = EventReader().feed(written("site", b'{\n  "a": 1\n}'))
    assert json.loads(event.data) == {"a": 1}


def test_an_endless_event_does_not_fill_the_memory() -> None:
    reader = EventReader()
    line = b"data: " + b"x" * 2**20 + b"\n"
    for _ in range(LARGEST_EVENT // 2**20):
        reader.feed(line)
    with pytest.raises(StreamError, match="8 MiB"):
        reader.feed(line)
