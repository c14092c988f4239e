"""The streams' promises: one log in order, resumed without loss, newest of state for the slow, bounds, nobody waits."""

import asyncio
import json

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st
from test_api_state import alert, frame

from services.api.event_log import Entry, EventLog, ndjson_event, sse_event
from services.api.place_filter import Place
from services.api.problems import Problem
from services.api.selection import Selection
from services.api.stream import LARGEST_SEND, Hub, Reader, track_columns
from services.api.zones_drawn import ZonesDrawn
from shared.messages import Occupancy, Revision
from shared.zones import ZoneDefinition

EVERYTHING = frozenset({"tracks", "alert", "camera", "revision", "occupancy"})
ALL = Selection(EVERYTHING)


def log_of(*events: str, most: int = 1000) -> EventLog:
    """A log of events from 101 on, each ``name`` or ``name:subject``."""
    log = EventLog(101, most, 1 << 20)
    for number, told in enumerate(events):
        name, _, subject = told.partition(":")
        log.append(name, subject, "hall", None, b'{"n":%d}' % number)
    return log


def reader_of(log: EventLog, selection: Selection = ALL, after: int = 100, lossless: bool = False) -> Reader:
    return Reader(log, selection, ndjson_event, after, lossless, 5.0)


async def waiting(reader: Reader) -> list[dict[str, object]]:
    """What this reader is told next, at once."""
    chunk = await anext(reader.chunks())
    return [json.loads(line) for line in chunk.splitlines()]


def test_events_are_numbered_in_order_and_travel_in_two_forms() -> None:
    log = log_of("tracks:hall", "alert:a-1")
    assert [entry.id for entry in log.after(100)] == [101, 102]
    (entry,) = log.after(101)
    assert entry.framed(sse_event) == b'event: alert\nid: 102\ndata: {"n":1}\n\n'
    assert json.loads(entry.framed(ndjson_event)) == {"id": 102, "event": "alert", "data": {"n": 1}}
    assert entry.framed(sse_event) is entry.framed(sse_event), "made once for all readers"
    assert log.alert("a-1") == 102
    assert log.alert("a-2") is None


def test_nobody_resumes_where_something_is_gone() -> None:
    log = log_of("alert", "alert", "alert", "alert", most=2)
    assert (log.oldest, log.newest) == (103, 104)
    assert log.refusal(102) is None, "103 and 104 are all that came after 102"
    assert log.refusal(104) is None
    assert log.refusal(101) == "older than the log"
    assert log.refusal(105) == "of no event of this log"


@settings(max_examples=100)
@given(st.lists(st.integers(0, 400), max_size=60), st.integers(1, 30), st.integers(1, 20_000))
def test_the_log_holds_the_newest_within_both_bounds(sizes: list[int], most: int, most_bytes: int) -> None:
    log = EventLog(1, most, most_bytes)
    for size in sizes:
        log.append("alert", "", None, None, b"x" * size)
        held = list(log.after(log.oldest - 1))
        assert [entry.id for entry in held] == list(range(log.oldest, log.newest + 1))
        assert len(held) <= most
        assert log.bytes == sum(entry.cost for entry in held)
        assert log.bytes <= most_bytes or len(held) == 1
    assert log.newest == len(sizes)


@settings(max_examples=50)
@given(st.lists(st.sampled_from(["tracks:hall", "tracks:yard", "alert", "revision"]), max_size=30), st.data())
def test_a_lossless_reader_is_told_everything_once_however_it_comes_and_goes(
    events: list[str], data: st.DataObject
) -> None:
    async def scenario() -> list[object]:
        log, told, last = log_of(), [], 100
        for number, event in enumerate(events):
            name, _, subject = event.partition(":")
            log.append(name, subject, "hall", None, b"%d" % number)
            if data.draw(st.booleans()):
                got = await waiting(reader_of(log, after=last, lossless=True))
                last = int(str(got[-1]["id"]))
                told += got
        if last < log.newest:
            told += await waiting(reader_of(log, after=last, lossless=True))
        return [event["data"] for event in told]

    assert asyncio.run(scenario()) == list(range(len(events)))


def test_a_slow_reader_finds_the_newest_of_each_area_and_every_alert() -> None:
    log = log_of(*[f"tracks:{area}" for _ in range(100) for area in ("hall", "yard")], "alert:1", "alert:2")
    told = asyncio.run(waiting(reader_of(log)))
    assert [event["id"] for event in told] == [299, 300, 301, 302]


def test_a_reader_that_the_log_has_overtaken_is_ended() -> None:
    async def scenario() -> list[bytes]:
        log = log_of("alert")
        reader = reader_of(log, after=100)
        for number in range(2000):
            log.append("alert", str(number), None, None, b"{}")
        return [chunk async for chunk in reader.chunks()]

    (last,) = asyncio.run(scenario())
    assert (json.loads(last)["event"], json.loads(last)["data"]["status"]) == ("ended", 410)


def test_what_is_sent_at_once_has_a_bound() -> None:
    async def scenario() -> list[int]:
        log = EventLog(1, 1000, 1 << 30)
        for _ in range(5):
            log.append("alert", "", None, None, b"x" * (LARGEST_SEND // 2))
        chunks = reader_of(log, after=0).chunks()
        return [len(await anext(chunks)) // (LARGEST_SEND // 2) for _ in range(3)]

    assert asyncio.run(scenario()) == [2, 2, 1]


def test_the_stream_says_how_accurate_each_place_is() -> None:
    one = msgspec.structs.replace(frame(1.0, ["p"]), covariance=[(2.5, 1.5, 2.5)])  # eigenvalues 4 and 1
    assert track_columns(one, {}).accuracy == [2.0]


def told_of(
    selection: Selection, event: str, message: msgspec.Struct, area: str | None = "hall", zone: str = ""
) -> object:
    entry = Entry(1, event, "", area, zone or None, msgspec.json.encode(message))
    framed = selection.framed(entry, ndjson_event)
    return None if framed is None else json.loads(framed)["data"]


def test_a_selection_tells_its_part_and_nothing_else() -> None:
    tracks = track_columns(frame(1.0, ["p", "q"]), {})
    moved = Revision(
        t=9.0,
        area="hall",
        chunk=1,
        tracker="x",
        device=["p", "q"],
        since=[4.0, 5.0],
        of=[0, 1],
        at=[4.0, 5.0],
        track=[1, 2],
        x=[1.0, 2.0],
        y=[1.0, 2.0],
        covariance=[(1.0, 0.0, 1.0)] * 2,
        probability=[1.0, 0.9],
    )
    met = msgspec.structs.replace(alert(1), device="p", other_device="q")
    counts = Occupancy(t=1.0, zone=["entrance", "nave"], people=[3, 4], phones=[1, 2])
    of_q = Selection(EVERYTHING, device="q")
    assert told_of(of_q, "tracks", tracks)["x"] == [tracks.x[1]]  # type: ignore[index]
    told = told_of(of_q, "revision", moved)
    assert (told["device"], told["of"], told["at"]) == (["q"], [0], [5.0])  # type: ignore[index]
    assert told_of(of_q, "alert", met)["id"] == "a-1"  # type: ignore[index]
    assert told_of(of_q, "occupancy", counts, None) is None
    of_nobody = Selection(EVERYTHING, device="r")
    assert [told_of(of_nobody, *each) for each in (("tracks", tracks), ("revision", moved), ("alert", met))] == [
        None
    ] * 3
    of_nave = Selection(EVERYTHING, place=Place(zone="nave"))
    told = told_of(of_nave, "occupancy", counts, None)
    assert (told["zone"], told["people"], told["phones"]) == (["nave"], [4], [2])  # type: ignore[index]
    unknown = Occupancy(t=1.0, zone=["entrance"], people=[3], phones=[1], blind=["nave"])
    told = told_of(of_nave, "occupancy", unknown, None)
    assert (told["zone"], told["blind"]) == ([], ["nave"])  # type: ignore[index]
    assert told_of(of_nave, "alert", met, zone="entrance") is None
    both = Selection(EVERYTHING, device="q", place=Place(zone="entrance"))
    assert told_of(both, "alert", met, zone="entrance") is not None
    assert told_of(Selection(EVERYTHING, area="yard"), "tracks", tracks) is None
    assert told_of(Selection(frozenset({"alert"})), "tracks", tracks) is None


def test_people_revisions_and_alerts_are_told_where_they_are_asked_for() -> None:
    nave = ZoneDefinition(id="nave", floor="ground", points=[(0.0, 0.0), (10.5, 0.0), (10.5, 5.0), (0.0, 5.0)])
    zones = ZonesDrawn([nave])
    here = msgspec.structs.replace(frame(1.0, ["p", None]), quality=[0.9, 0.4])  # at x = 10 and 11
    tracks = track_columns(here, {(0, "p"): 0.5})
    columns = {"of": [0, 0], "at": [4.0, 5.0], "track": [1, 1], "x": [10.0, 11.0], "y": [1.0, 1.0]}
    columns |= {"covariance": [(1.0, 0.0, 1.0)] * 2, "probability": [1.0, 0.9]}
    moved = Revision(t=9.0, area="hall", chunk=1, tracker="x", device=["p"], since=[4.0], **columns)
    came = msgspec.structs.replace(alert(1), x=10.0, y=1.0)
    counts = Occupancy(t=1.0, zone=["nave"], people=[3], phones=[1])

    def there(event: str, message: msgspec.Struct, place: Place, confidence: float = 0.0) -> dict[str, object]:
        chosen = Selection(EVERYTHING, None, None, place, confidence, lambda: zones, {"hall": "ground"})
        return told_of(chosen, event, message, zone="nave")  # type: ignore[return-value]

    for place in (Place(zone="nave"), Place(near=(10.0, 1.0, 0.9)), Place(near=(10.0, 1.0, 0.9), floor="ground")):
        told = there("tracks", tracks, place)
        assert (told["track"], told["device_since"], told["quality"]) == ([0], [0.5], [0.9])
        revised = there("revision", moved, place)
        assert (revised["device"], revised["at"]) == (["p"], [4.0])
        assert there("alert", came, place)["id"] == "a-1"
    elsewhere = Place(near=(0.0, 0.0, 1.0))
    assert there("tracks", tracks, elsewhere)["track"] == [], "that nobody is there is told, too"
    assert there("revision", moved, elsewhere)["device"] == ["p"], "who was told there before was not there"
    assert there("alert", came, elsewhere) is None
    assert there("occupancy", counts, elsewhere) is None
    assert there("tracks", tracks, Place(floor="upper"))["track"] == []
    assert there("tracks", tracks, Place(zone="taken out"))["track"] == []
    assert there("tracks", tracks, Place(), confidence=0.5)["track"] == [0]
    assert there("alert", came, Place(), confidence=0.5)["id"] == "a-1"


def test_who_may_not_read_positions_is_told_alerts_without_names() -> None:
    log = EventLog(1, 10, 1 << 20)
    about = msgspec.structs.replace(alert(1), device="phone-1", other_device="phone-2")
    log.append("alert", "a", "hall", None, msgspec.json.encode(about))
    for nameless, names in ((True, [None, None]), (False, ["phone-1", "phone-2"])):
        reader = reader_of(log, Selection(EVERYTHING, nameless=nameless), after=0)
        (event,) = asyncio.run(waiting(reader))
        assert [event["data"][name] for name in ("device", "other_device")] == names  # type: ignore[index]


def test_a_stream_whose_key_is_revoked_ends_and_says_why() -> None:
    revoked = Problem(type="urn:atrium:unauthorized", title="No valid key", status=401, detail="revoked")

    async def scenario() -> list[bytes]:
        refusals = iter([None, revoked])
        reader = Hub(EventLog(1, 10, 1000), 10.0, 60.0, 1).join(ALL, ndjson_event, refused=lambda: next(refusals))
        async with asyncio.timeout(5.0):
            return [chunk async for chunk in reader.chunks()]

    (last,) = asyncio.run(scenario())
    assert json.loads(last) == {"id": None, "event": "ended", "data": msgspec.to_builtins(revoked)}


def test_a_withdrawn_device_is_out_of_all_that_can_still_be_told() -> None:
    async def scenario() -> tuple[str, int]:
        hub = Hub(EventLog(1, 100, 1 << 20), 1000.0, 5.0, 2)
        seen = frame(1.0, ["gone", "stays"])
        fed = msgspec.structs.replace(seen, sources=[["gone"], ["gone", "stays"]])
        hub.tracks(msgspec.structs.replace(fed, state=["unseen", "confirmed"]), {(1, "stays"): 0.5})
        hub.tracks(fed, {(0, "gone"): 0.25})  # waits for its turn
        moved = Revision(t=9.0, area="hall", chunk=1, tracker="x", device=["gone"], since=[4.0])
        hub.send("revision", "hall", moved, "hall")
        hub.send("alert", "a-1", msgspec.structs.replace(alert(1), other_device="gone"), "hall", "entrance")
        hub.erase("gone")
        reader = hub.join(ALL, ndjson_event, 0, lossless=True)
        chunks, text = reader.chunks(), ""
        while text.count('"tracks"') < 2:
            text += (await anext(chunks)).decode()
        present = b"".join(entry.framed(ndjson_event) for entry in hub.log.present("tracks"))
        assert b"gone" not in present
        assert hub.log.bytes == sum(entry.cost for entry in hub.log.after(0))
        return text, len(text.splitlines())

    text, lines = asyncio.run(scenario())
    assert "gone" not in text
    assert "stays" in text
    assert lines == 3, "nothing is left of the revision"


def test_withdrawals_are_forgotten_once_nothing_from_before_them_is_held() -> None:
    log = EventLog(1, 2, 1 << 20)
    for number in range(5):
        log.append("alert", "", None, None, msgspec.json.encode(msgspec.structs.replace(alert(number), device="p")))
        log.erase("p")
        log.append("alert", "", None, None, msgspec.json.encode(msgspec.structs.replace(alert(number), device="q")))
        assert [json.loads(entry.payload or b"")["device"] for entry in log.after(log.oldest - 1)] == [None, "q"]
        log.erase("q")
        assert [json.loads(entry.payload or b"")["device"] for entry in log.after(log.oldest - 1)] == [None, None]
    assert len(log._withdrawals) <= 2


def test_tracks_come_at_the_rate_and_end_with_the_newest() -> None:
    async def scenario() -> list[float]:
        hub = Hub(EventLog(1, 1000, 1 << 20), rate=20.0, keep_alive=5.0, most=2)
        reader = hub.join(ALL, ndjson_event, lossless=True)
        seen: list[float] = []

        async def read() -> None:
            async for chunk in reader.chunks():
                seen.extend(json.loads(line)["data"]["t"] for line in chunk.splitlines())
                if seen[-1] == 99.0:
                    return

        reading = asyncio.ensure_future(read())
        for number in range(100):
            hub.tracks(frame(float(number), ["p"]), {})
            await asyncio.sleep(0.002)
        await asyncio.wait_for(reading, 5.0)
        return seen

    seen = asyncio.run(scenario())
    assert seen == sorted(seen)
    assert 2 <= len(seen) <= 40, "a hundred frames in well under a second, twenty events a second"


def test_silence_is_told_also_while_others_are_told_something() -> None:
    async def scenario() -> bytes:
        hub = Hub(EventLog(1, 1000, 1 << 20), rate=20.0, keep_alive=0.05, most=2)
        reader = hub.join(Selection(EVERYTHING, device="nobody"), ndjson_event)

        async def talk() -> None:
            while True:
                hub.send("tracks", "hall", track_columns(frame(1.0, ["p"]), {}), "hall")
                await asyncio.sleep(0.005)

        talking = asyncio.ensure_future(talk())
        try:
            return await asyncio.wait_for(anext(reader.chunks()), 5.0)
        finally:
            talking.cancel()

    assert asyncio.run(scenario()) == b""


def test_readers_have_a_bound_and_closing_ends_them() -> None:
    async def scenario() -> None:
        hub = Hub(EventLog(1, 10, 1000), rate=10.0, keep_alive=60.0, most=1)
        reader = hub.join(ALL, ndjson_event)
        assert hub.full
        hub.leave(reader)
        assert not hub.full
        reader = hub.join(ALL, ndjson_event)
        asyncio.get_running_loop().call_soon(hub.close)
        async with asyncio.timeout(5.0):
            (last,) = [chunk async for chunk in reader.chunks()]
        assert json.loads(last)["data"]["type"] == "urn:atrium:stopping"
        assert hub.full

    asyncio.run(scenario())
