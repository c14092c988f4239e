"""The stream's promises: newest wins, rates and queues have bounds, nobody waits for a slow reader."""

import asyncio
import json

import msgspec
from test_api_state import alert, frame

from services.api.stream import ALERTS_WAITING, Hub, Reader, alert_event, revision_event, tracks_event
from shared.messages import Revision

ALL = frozenset({"tracks", "alert", "camera"})


async def collected(reader: Reader) -> list[str]:
    """Return what waits for this reader now."""
    events = reader.events()
    await anext(events)
    text = (await anext(events)).decode()
    await events.aclose()  # type: ignore[attr-defined]
    return [part for part in text.split("\n\n") if part]


def test_a_slow_reader_finds_the_newest_of_each_area_and_all_alerts() -> None:
    async def scenario() -> list[str]:
        hub = Hub(rate=10.0, keep_alive=5.0, most=2)
        reader = hub.join(ALL, None)
        for number in range(1000):
            for area in ("hall", "yard"):
                hub.send("tracks", area, area, f"event: tracks\ndata: {area}-{number}\n\n".encode())
        hub.send("alert", "entrance", "hall", alert_event(alert(1)))
        hub.send("alert", "entrance", "hall", alert_event(alert(2)))
        return await collected(reader)

    waiting = asyncio.run(scenario())
    assert [part.split("data: ")[1] for part in waiting if "tracks" in part] == ["hall-999", "yard-999"]
    assert [json.loads(part.split("data: ")[1])["id"] for part in waiting if "alert" in part] == ["a-1", "a-2"]


def test_revisions_are_told_each_and_with_every_point() -> None:
    async def scenario() -> list[str]:
        hub = Hub(rate=10.0, keep_alive=5.0, most=2)
        reader, other = hub.join(frozenset({"revision"}), "hall"), hub.join(ALL, None)
        for chunk in (1, 2):
            revision = Revision(t=9.0, area="hall", chunk=chunk, tracker="x", device=["d"], since=[4.0])
            hub.send("revision", "hall", "hall", revision_event(revision))
            hub.send("revision", "yard", "yard", revision_event(revision))
        hub.send("camera", "c", "hall", b"event: camera\ndata: {}\n\n")
        assert len(await collected(other)) == 1  # who did not ask for revisions gets none
        return await collected(reader)

    waiting = asyncio.run(scenario())
    told = [json.loads(part.split("data: ")[1]) for part in waiting]
    assert [(one["chunk"], one["device"], one["since"]) for one in told] == [(1, ["d"], [4.0]), (2, ["d"], [4.0])]


def test_the_stream_says_how_accurate_each_place_is() -> None:
    one = msgspec.structs.replace(frame(1.0, ["p"]), covariance=[(2.5, 1.5, 2.5)])  # eigenvalues 4 and 1
    assert json.loads(tracks_event(one).split(b"data: ")[1])["accuracy"] == [2.0]


def test_alerts_that_wait_have_a_bound() -> None:
    async def scenario() -> list[str]:
        reader = Reader(5.0, ALL, None)
        for number in range(ALERTS_WAITING + 10):
            reader.offer("alert", "entrance", "hall", alert_event(alert(number)))
        return await collected(reader)

    waiting = asyncio.run(scenario())
    assert len(waiting) == ALERTS_WAITING
    assert "id: a-10\n" in waiting[0], "the oldest gave way"


def test_tracks_come_at_the_rate_and_end_with_the_newest() -> None:
    async def scenario() -> list[float]:
        hub = Hub(rate=20.0, keep_alive=5.0, most=2)
        reader = hub.join(ALL, None)
        seen: list[float] = []

        async def read() -> None:
            async for chunk in reader.events():
                text = chunk.decode()
                if "data: " in text:
                    seen.append(json.loads(text.split("data: ")[1])["t"])
                    if seen[-1] == 99.0:
                        return

        reading = asyncio.ensure_future(read())
        for number in range(100):
            hub.tracks(frame(float(number), ["p"]))
            await asyncio.sleep(0.002)
        await asyncio.wait_for(reading, 5.0)
        return seen

    seen = asyncio.run(scenario())
    assert seen == sorted(seen)
    assert 2 <= len(seen) <= 40, "a hundred frames in well under a second, twenty events a second"


def test_a_reader_of_one_area_with_few_scopes_gets_no_more() -> None:
    async def scenario() -> list[str]:
        reader = Reader(0.01, frozenset({"tracks"}), "hall")
        reader.offer("tracks", "yard", "yard", b"other area\n\n")
        reader.offer("alert", "entrance", "hall", b"other scope\n\n")
        return await collected(reader)

    assert asyncio.run(scenario()) == [": still here"]


def test_readers_have_a_bound_and_closing_ends_them() -> None:
    async def scenario() -> None:
        hub = Hub(rate=10.0, keep_alive=60.0, most=1)
        reader = hub.join(ALL, None)
        assert hub.full
        hub.leave(reader)
        assert not hub.full
        reader = hub.join(ALL, None)
        asyncio.get_running_loop().call_soon(hub.close)
        async with asyncio.timeout(5.0):
            async for _ in reader.events():
                pass
        assert hub.full

    asyncio.run(scenario())


def test_revisions_that_wait_are_dropped_when_somebody_withdraws_consent() -> None:
    async def scenario() -> list[str]:
        hub = Hub(rate=10.0, keep_alive=5.0, most=2)
        reader = hub.join(frozenset({"revision", "alert"}), None)
        revision = Revision(t=9.0, area="hall", chunk=1, tracker="x", device=["gone"], since=[4.0])
        hub.send("revision", "hall", "hall", revision_event(revision))
        hub.send("alert", "entrance", "hall", alert_event(alert(1)))
        hub.drop("revision")
        return await collected(reader)

    (told,) = asyncio.run(scenario())
    assert "alert" in told
    assert "gone" not in told
