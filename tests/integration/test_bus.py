"""The bus on a real router: what arrives, what is counted when it does not, and what outlives the router."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from prometheus_client import REGISTRY
from waiting import wait_until

from shared.bus import LONGEST_WAIT, QUEUE, Bus, BusError, BusTimeoutError, Inbox, router
from shared.keys import Keys
from shared.messages import CameraStatus, DetectionFrame, Message, RadioScan

KEYS = Keys("bus-test")


@pytest.fixture
def join(zenoh_router: str) -> Iterator[Callable[[], Bus]]:
    """Make any number of members of the bus."""
    members: list[Bus] = []

    def make() -> Bus:
        members.append(Bus([zenoh_router], wait=5.0))
        return members[-1]

    yield make
    for member in members:
        member.close()


def dropped(kind: type[Message], reason: str) -> float:
    labels = {"kind": kind.__name__, "reason": reason}
    return REGISTRY.get_sample_value("atrium_bus_dropped_total", labels) or 0.0


def frame(seq: int) -> DetectionFrame:
    return DetectionFrame(t=float(seq), camera="c", floor="f", seq=seq)


def scan(seq: int) -> RadioScan:
    return RadioScan(t=float(seq), device="d", seq=seq)


def collect(inbox: Inbox, count: int, timeout: float = 5.0) -> list[Message]:
    found: list[Message] = []

    def enough() -> bool:
        found.extend(delivery.message for delivery in inbox.receive(0.1))
        return len(found) >= count

    wait_until(enough, timeout, f"{count} messages")
    return found


def published_until_heard(publish: Callable[[int], object], inbox: Inbox) -> Message:
    """Publish until one arrives: a subscription takes a moment to reach the publisher through the router."""
    number = iter(range(10_000))

    def heard() -> Message | None:
        publish(next(number))
        deliveries = inbox.receive(0.05)
        return deliveries[-1].message if deliveries else None

    return wait_until(heard, 10.0, "a message")  # type: ignore[return-value]


def waiting_in(inbox: Inbox, count: int) -> None:
    wait_until(lambda: len(inbox._waiting) >= count, 20.0, f"{count} messages in the queue")


def test_messages_arrive_in_order_with_their_key_and_trace(join: Callable[[], Bus]) -> None:
    inbox = join().inbox()
    inbox.subscribe(KEYS.radio(), RadioScan)
    publisher = join().publisher(KEYS.radio("d"), RadioScan)
    published_until_heard(lambda n: publisher.publish(scan(n)), inbox)
    inbox.receive(0.2)
    before = time.time()
    traces = [publisher.publish(scan(100 + number), origin=before - 1.0) for number in range(50)]
    found = []
    wait_until(lambda: found.extend(inbox.receive(0.1)) or len(found) >= 50, 20.0, "50 messages")
    assert [delivery.message for delivery in found] == [scan(100 + number) for number in range(50)]
    assert {delivery.key for delivery in found} == {KEYS.radio("d")}
    assert [delivery.trace for delivery in found] == traces
    assert found[0].trace.origin == before - 1.0
    assert found[0].trace.sent >= before
    assert len({trace.id for trace in traces}) == 50


def test_a_late_joiner_gets_the_cached_state(join: Callable[[], Bus]) -> None:
    status = CameraStatus(t=1.0, camera="c", state="degraded", reason="the stream is silent")
    join().publisher(KEYS.camera_status("c"), CameraStatus, cached=True).publish(status)
    inbox = join().inbox()
    inbox.subscribe(KEYS.camera_status(), CameraStatus, cached=True)
    assert collect(inbox, 1) == [status]


def test_a_late_joiner_gets_as_much_history_as_the_publisher_keeps(join: Callable[[], Bus]) -> None:
    publisher = join().publisher(KEYS.camera_status("c"), CameraStatus, cached=True, history=3)
    for number in range(5):
        publisher.publish(CameraStatus(t=float(number), camera="c", state="ok"))
    inbox = join().inbox()
    inbox.subscribe(KEYS.camera_status(), CameraStatus, cached=True)
    assert [message.t for message in collect(inbox, 3)] == [2.0, 3.0, 4.0]


def test_state_of_a_publisher_that_comes_later_reaches_who_was_there_first(join: Callable[[], Bus]) -> None:
    inbox = join().inbox()
    inbox.subscribe(KEYS.camera_status(), CameraStatus, cached=True)
    join().publisher(KEYS.camera_status("c"), CameraStatus, cached=True).publish(
        CameraStatus(t=1.0, camera="c", state="ok")
    )
    assert collect(inbox, 1)[0].t == 1.0


def test_overtaken_sensor_frames_are_dropped_oldest_first_and_counted(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox(capacity=3)
    inbox.subscribe(KEYS.detections(), DetectionFrame, newest=True)
    inbox.subscribe(KEYS.radio(), RadioScan)
    frames, scans = bus.publisher(KEYS.detections("c"), DetectionFrame), bus.publisher(KEYS.radio("d"), RadioScan)
    before = dropped(DetectionFrame, "overtaken")
    scans.publish(scan(0))
    waiting_in(inbox, 1)
    for number in range(6):
        frames.publish(frame(number))
    wait_until(lambda: dropped(DetectionFrame, "overtaken") == before + 4, 20.0, "four frames to be overtaken")
    found = [delivery.message for delivery in inbox.receive(1.0)]
    assert found == [scan(0), frame(4), frame(5)]  # the reliable scan stayed


def test_a_reader_that_fell_behind_finds_the_newest_few_of_every_key(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox()
    inbox.subscribe(KEYS.detections(), DetectionFrame, newest=True, depth=2)
    inbox.subscribe(KEYS.radio(), RadioScan)
    busy, calm = (bus.publisher(KEYS.detections(camera), DetectionFrame) for camera in ("busy", "calm"))
    scans = bus.publisher(KEYS.radio("d"), RadioScan)
    before = dropped(DetectionFrame, "overtaken")
    calm.publish(frame(0))
    for number in range(100):
        busy.publish(frame(number))
        scans.publish(scan(number))
    calm.publish(frame(1))
    wait_until(lambda: dropped(DetectionFrame, "overtaken") == before + 98, 20.0, "98 frames to be overtaken")
    waiting_in(inbox, 104)
    found = inbox.receive(1.0)
    assert [d.message.t for d in found if d.key == KEYS.detections("busy")] == [98.0, 99.0]
    assert [d.message.t for d in found if d.key == KEYS.detections("calm")] == [0.0, 1.0]
    assert [d.message for d in found if d.key == KEYS.radio("d")] == [scan(number) for number in range(100)]


def test_by_default_a_handful_of_frames_of_a_key_waits(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox()
    inbox.subscribe(KEYS.detections(), DetectionFrame, newest=True)
    publisher = bus.publisher(KEYS.detections("c"), DetectionFrame)
    before = dropped(DetectionFrame, "overtaken")
    for number in range(100):
        publisher.publish(frame(number))
    wait_until(lambda: dropped(DetectionFrame, "overtaken") == before + 92, 20.0, "all but eight to be overtaken")
    assert [delivery.message for delivery in inbox.receive(1.0)] == [frame(number) for number in range(92, 100)]


def test_what_was_dropped_here_is_not_counted_again_as_a_gap(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox()
    inbox.subscribe(KEYS.detections(), DetectionFrame, newest=True, depth=2)
    publisher = bus.publisher(KEYS.detections("c"), DetectionFrame)
    overtaken, gap = dropped(DetectionFrame, "overtaken"), dropped(DetectionFrame, "gap")
    publisher.publish(frame(0))
    assert collect(inbox, 1) == [frame(0)]
    for number in (1, 2, 3, 4, 6, 7):  # 5 is lost on its way
        publisher.publish(frame(number))
    wait_until(lambda: dropped(DetectionFrame, "overtaken") == overtaken + 4, 20.0, "four frames to be overtaken")
    assert collect(inbox, 2) == [frame(6), frame(7)]
    assert dropped(DetectionFrame, "gap") == gap + 1
    bus._session.put(KEYS.detections("c"), b"rubbish")
    publisher.publish(frame(9))
    assert collect(inbox, 1) == [frame(9)]
    assert dropped(DetectionFrame, "gap") == gap + 1


def test_a_full_queue_of_reliable_messages_costs_its_senders_no_time(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox(capacity=10_000)
    inbox.subscribe(KEYS.radio(), RadioScan)
    publisher = bus.publisher(KEYS.radio("d"), RadioScan)
    before = dropped(RadioScan, "queue full")
    for number in range(20_000):
        publisher.publish(scan(number))
    wait_until(lambda: dropped(RadioScan, "queue full") == before + 10_000, 20.0, "ten thousand drops")
    gap = dropped(RadioScan, "gap")
    assert [delivery.message.t for delivery in inbox.receive(1.0)] == [float(n) for n in range(10_000, 20_000)]
    assert dropped(RadioScan, "gap") == gap


def test_a_full_queue_of_reliable_messages_drops_the_oldest_and_counts_it(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox(capacity=2)
    inbox.subscribe(KEYS.radio(), RadioScan)
    publisher = bus.publisher(KEYS.radio("d"), RadioScan)
    before = dropped(RadioScan, "queue full")
    for number in range(5):
        publisher.publish(scan(number))
    wait_until(lambda: dropped(RadioScan, "queue full") == before + 3, 20.0, "three drops")
    assert [delivery.message for delivery in inbox.receive(1.0)] == [scan(3), scan(4)]


def test_what_is_not_understood_is_counted_and_the_rest_still_arrives(
    join: Callable[[], Bus], zenoh_router: str
) -> None:
    bus = join()
    inbox = bus.inbox()
    inbox.subscribe(KEYS.radio(), RadioScan)
    before = dropped(RadioScan, "not understood")
    for payload in (b"rubbish", b'{"t": 1}', b"\xff" * 10, b""):
        bus._session.put(KEYS.radio("d"), payload)
    bus._session.put(KEYS.radio("d"), b'{"t":1,"device":"d","seq":1}', attachment=b"no trace")
    bus.publisher(KEYS.radio("d"), RadioScan).publish(scan(7))
    assert collect(inbox, 1) == [scan(7)]
    assert dropped(RadioScan, "not understood") == before + 5


def test_numbers_that_never_arrived_are_counted_as_a_gap(join: Callable[[], Bus]) -> None:
    bus = join()
    inbox = bus.inbox()
    inbox.subscribe(KEYS.radio(), RadioScan)
    publisher = bus.publisher(KEYS.radio("d"), RadioScan)
    before = dropped(RadioScan, "gap")
    for number in (1, 2, 6, 7, 1, 2):  # three missing, then the publisher starts anew
        publisher.publish(scan(number))
    collect(inbox, 6)
    assert dropped(RadioScan, "gap") == before + 3


def test_presence_appears_and_disappears_with_its_process(join: Callable[[], Bus]) -> None:
    watcher, member = join(), join()
    assert watcher.present(KEYS.alive()) == []
    member.announce(KEYS.alive("camera", "c1"))
    wait_until(lambda: watcher.present(KEYS.alive()) == [KEYS.alive("camera", "c1")], 20.0, "the token")
    member.close()
    wait_until(lambda: watcher.present(KEYS.alive()) == [], 20.0, "the token to vanish")


def test_a_question_is_answered_and_a_failing_answer_is_silence(join: Callable[[], Bus]) -> None:
    asker, owner = join(), join()
    owner.answer(KEYS.fusion_state("hall"), lambda: b'{"chunk": 7}')

    def fail() -> bytes:
        raise RuntimeError("nothing to tell yet")

    owner.answer(KEYS.fusion_state("cellar"), fail)
    expected = [(KEYS.fusion_state("hall"), b'{"chunk": 7}')]
    wait_until(lambda: list(asker.ask(KEYS.fusion_state("hall"), timeout=1.0)) == expected, 20.0, "the answer")
    assert list(asker.ask(KEYS.fusion_state(), timeout=1.0)) == expected


def test_a_waiting_reader_can_be_woken_also_before_it_waits(join: Callable[[], Bus]) -> None:
    inbox = join().inbox()
    inbox.wake()
    begin = time.monotonic()
    assert inbox.receive(20.0) == []
    threading.Timer(0.1, inbox.wake).start()
    assert inbox.receive(20.0) == []
    assert time.monotonic() - begin < 10.0


def router_process(endpoint: str) -> "subprocess.Popen[bytes]":
    program = f"import signal; from shared.bus import router; session = router({endpoint!r}); signal.pause()"
    return subprocess.Popen([sys.executable, "-c", program])


def test_everything_works_again_after_the_router_was_killed_and_came_back(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    first = router_process(endpoint)
    with Bus([endpoint], wait=20.0) as sender, Bus([endpoint], wait=20.0) as reader:
        inbox = reader.inbox()
        inbox.subscribe(KEYS.radio(), RadioScan)
        publisher = sender.publisher(KEYS.radio("d"), RadioScan)
        sender.announce(KEYS.alive("gateway", "0"))
        state = sender.publisher(KEYS.camera_status("c"), CameraStatus, cached=True)
        state.publish(CameraStatus(t=5.0, camera="c", state="ok"))
        published_until_heard(lambda n: publisher.publish(scan(n)), inbox)
        first.kill()  # no farewell
        first.wait()
        wait_until(lambda: not sender.connected and not reader.connected, 20.0, "both to notice")
        publisher.publish(scan(50_000))  # into the void: neither an error nor a hang
        second = router(endpoint)
        try:
            wait_until(lambda: sender.connected and reader.connected, 10.0, "both to reconnect")
            published_until_heard(lambda n: publisher.publish(scan(60_000 + n)), inbox)
            wait_until(lambda: reader.present(KEYS.alive()) == [KEYS.alive("gateway", "0")], 20.0, "the token again")
            late = reader.inbox()
            late.subscribe(KEYS.camera_status(), CameraStatus, cached=True)
            assert collect(late, 1)[0].t == 5.0
        finally:
            close(second)


def test_opening_waits_for_a_router_that_starts_later(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    opened: list[Bus] = []
    opening = threading.Thread(target=lambda: opened.append(Bus([endpoint], wait=20.0)))
    opening.start()
    session = router(endpoint)
    opening.join(20.0)
    assert opened
    assert opened[0].connected
    opened[0].close()
    close(session)


def test_opening_gives_up_when_told_to(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with pytest.raises(BusTimeoutError, match=f"no router at {endpoint}"):
        Bus([endpoint], wait=0.2)
    stopping = threading.Event()
    threading.Timer(0.2, stopping.set).start()
    with pytest.raises(BusTimeoutError, match="no router"):
        Bus([endpoint], stopping=stopping)


def test_a_malformed_endpoint_is_named() -> None:
    with pytest.raises(BusError, match=r"nonsense.*must be of the form") as refusal:
        Bus(["nonsense"], wait=5.0)
    assert "cargo" not in str(refusal.value)


def test_a_router_cannot_listen_where_another_does(zenoh_router: str) -> None:
    with pytest.raises(BusError, match=zenoh_router):
        router(zenoh_router)


def close(session: zenoh.Session) -> None:
    session.close()  # type: ignore[no-untyped-call]


def test_the_router_that_is_deployed_lets_as_many_messages_wait_as_the_local_one() -> None:
    deployed = zenoh.Config.from_file(str(Path(__file__).parents[2] / "deploy" / "zenoh" / "router.json5"))
    assert int(deployed.get_json("transport/link/tx/queue/size/data")) == QUEUE
    drop = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"
    assert int(deployed.get_json(drop)) == LONGEST_WAIT
