import asyncio

from services.dashboard.mailbox import Mailbox


def test_a_slow_browser_gets_the_newest_positions_and_every_alert() -> None:
    async def scenario() -> bytes:
        mailbox = Mailbox()
        for number in range(1000):
            mailbox.post("tracks/hall", b"t%d " % number)
            if number % 250 == 0:
                mailbox.post(f"alert/{number}", b"a%d " % number)
        return await mailbox.take(1.0)

    assert asyncio.run(scenario()) == b"t999 a0 a250 a500 a750 "


def test_a_stalled_browser_holds_no_more_than_the_bound() -> None:
    async def scenario() -> tuple[int, bytes]:
        mailbox = Mailbox(capacity=3)
        for number in range(10):
            mailbox.post(f"alert/{number}", b"%d" % number)
        return mailbox.dropped, await mailbox.take(1.0)

    assert asyncio.run(scenario()) == (7, b"789")


def test_waiting_in_vain_returns_nothing_and_loses_nothing() -> None:
    async def scenario() -> tuple[bytes, bytes]:
        mailbox = Mailbox()
        nothing = await mailbox.take(0.01)
        mailbox.post("site", b"s")
        return nothing, await mailbox.take(0.01)

    assert asyncio.run(scenario()) == (b"", b"s")


def test_closing_wakes_the_reader() -> None:
    async def scenario() -> bool:
        mailbox = Mailbox()
        reading = asyncio.create_task(mailbox.take(60.0))
        await asyncio.sleep(0)
        mailbox.close()
        await asyncio.wait_for(reading, 5)
        return mailbox.closed

    assert asyncio.run(scenario())
