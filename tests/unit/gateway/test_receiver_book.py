"""What receivers hear: enrolled tags become scans on a real bus, strangers and those who withdrew leave no trace."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
import yaml
from conftest import ROOT, unused_port
from prometheus_client import REGISTRY, generate_latest
from structlog.testing import capture_logs
from waiting import wait_until

from services.gateway.devices.storage import Registered
from services.gateway.devices.transmitters import digest_of
from services.gateway.phones import receivers
from services.gateway.phones.heard import Heard
from services.gateway.phones.receivers import ReceiverBook
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import RadioScan
from shared.site import Site

KEY = "a key of tests for addresses"
TAG, OTHER, STRANGER = "02:ee:00:00:00:01", "02:ee:00:00:00:02", "7a:11:22:33:44:55"


@dataclass
class World:
    endpoint: str
    bus: Bus
    enrolled: dict[str, Registered]
    book: ReceiverBook = field(init=False)
    now: float = 100.0
    scans: list[RadioScan] = field(default_factory=list)

    def __post_init__(self) -> None:
        document = yaml.safe_load((ROOT / "deploy/sites/hall/site.yaml").read_text())
        for point, name in zip(document["access_points"], ("entrance", "Pi-Window"), strict=False):
            point["receivers"] = [name]
        site = Site.model_validate(document, context={"folder": ROOT / "deploy/sites/hall"})
        self.book = ReceiverBook(site, self.bus, lambda: self.enrolled, KEY, clock=lambda: self.now)
        self.inbox = self.bus.inbox()
        self.inbox.subscribe(Keys("hall").radio(), RadioScan)
        self.book.refresh()

    def hear(self, *readings: tuple[str, str, float], t: float | None = None, kind: str = "ble") -> dict[str, int]:
        heard = [Heard(where, kind, (who,), level, t) for where, who, level in readings]  # type: ignore[arg-type]
        return self.book.take(heard, time.time())

    def told(self, count: int) -> list[RadioScan]:
        """Let the window end and wait for so many scans."""
        self.now += 2.0
        self.book.flush()

        def all_here() -> bool:
            self.scans += [d.message for d in self.inbox.receive(0.02) if isinstance(d.message, RadioScan)]
            return len(self.scans) >= count

        wait_until(all_here, 10, f"{count} scans")
        assert len(self.scans) == count
        return self.scans


@pytest.fixture
def world(zenoh_router: str) -> Iterator[World]:
    bus = Bus([zenoh_router])
    tags = {digest_of(TAG, KEY): Registered("d-1", "hand"), digest_of(OTHER, KEY): Registered("d-2", "hand")}
    yield World(zenoh_router, bus, tags)
    bus.close()


def test_what_all_receivers_hear_in_a_second_becomes_one_scan(world: World) -> None:
    assert world.hear(("entrance", TAG, -60), ("pi-window ", TAG.upper(), -80), ("entrance", TAG, -64)) == {"used": 3}
    (scan,) = world.told(1)
    assert scan.heard_by_site
    assert not scan.late
    assert (scan.device, scan.kind) == ("d-1", "ble")
    assert dict(zip(scan.access_point, scan.rssi, strict=True)) == {"ap-1": -62.0, "ap-2": -80.0}
    assert abs(scan.t - time.time()) < 5.0


def test_kinds_devices_and_seconds_are_kept_apart(world: World) -> None:
    now = time.time()
    world.hear(("entrance", TAG, -60), ("entrance", OTHER, -61), t=now)
    world.hear(("entrance", TAG, -50), t=now - 3.0)
    world.hear(("entrance", TAG, -70), t=now, kind="wifi")
    scans = world.told(4)
    found = {(scan.device, scan.kind, round(scan.t - now)): scan.rssi for scan in scans}
    assert found == {
        ("d-1", "ble", 0): [-60],
        ("d-2", "ble", 0): [-61],
        ("d-1", "ble", -3): [-50],
        ("d-1", "wifi", 0): [-70],
    }


@pytest.mark.parametrize("wrong", [-3600.0, 90.0, 1e15])
def test_a_receivers_stamp_that_cannot_be_is_not_believed(world: World, wrong: float) -> None:
    world.hear(("entrance", TAG, -60), t=time.time() + wrong)
    assert abs(world.told(1)[0].t - time.time()) < 5.0


def test_an_old_stamp_is_believed_and_told_late(world: World) -> None:
    world.hear(("entrance", TAG, -60), t=time.time() - 30.0)
    (scan,) = world.told(1)
    assert scan.late
    assert scan.t == pytest.approx(time.time() - 30.0, abs=5.0)


def test_of_a_transmitter_that_is_not_enrolled_nothing_is_left_but_a_number(world: World) -> None:
    with capture_logs() as logs:
        assert world.hear(("entrance", STRANGER, -60), ("nowhere", STRANGER, -61)) == {
            "not enrolled": 1,
            "unknown receiver": 1,
        }
        world.hear(("entrance", TAG, -60))
        (scan,) = world.told(1)
    traces = [str(logs), str(vars(world.book)), generate_latest(REGISTRY).decode(), str(scan)]
    for shape in (STRANGER, STRANGER.replace(":", ""), digest_of(STRANGER, KEY)):
        assert not any(shape in trace.lower() for trace in traces)


def test_the_operator_is_told_once_of_an_unknown_receiver_by_name(world: World) -> None:
    with capture_logs() as logs:
        for _ in range(3):
            world.hear(("no\nwhere", TAG, -60))
            assert not world.book.knows("no\nwhere")
    assert [entry["receiver"] for entry in logs] == ["no\\nwhere"]


def test_names_of_unknown_receivers_are_told_only_so_often(world: World) -> None:
    with capture_logs() as logs:
        for number in range(3 * receivers.STRANGERS):
            world.book.knows(f"receiver {number}")
    assert len(logs) == receivers.STRANGERS


def test_whoever_withdraws_is_dropped_also_while_it_waits(world: World) -> None:
    world.hear(("entrance", TAG, -60), ("entrance", OTHER, -61))
    world.book.forget("d-1")
    assert world.hear(("entrance", TAG, -60)) == {"not enrolled": 1}
    assert [scan.device for scan in world.told(1)] == ["d-2"]


def test_an_answer_of_the_database_from_before_a_withdrawal_does_not_bring_a_tag_back(world: World) -> None:
    asked, go_on = threading.Event(), threading.Event()
    before = dict(world.enrolled)

    def slow() -> dict[str, Registered]:
        asked.set()
        assert go_on.wait(10)
        return before

    world.book._enrolled = slow
    thread = threading.Thread(target=world.book.refresh)
    thread.start()
    assert asked.wait(10)
    world.book.forget("d-1")
    go_on.set()
    thread.join(10)
    assert world.hear(("entrance", TAG, -60)) == {"not enrolled": 1}


def test_the_numbers_of_a_device_that_is_enrolled_no_more_are_forgotten(world: World) -> None:
    world.hear(("entrance", TAG, -60), ("entrance", OTHER, -60))
    world.told(2)
    del world.enrolled[digest_of(TAG, KEY)]
    world.book.refresh()
    assert world.book._seq == {"d-2": 0}


def test_readings_that_give_way_to_newer_ones_are_counted(world: World) -> None:
    def given_up() -> float:
        return REGISTRY.get_sample_value("atrium_gateway_receiver_readings_total", {"result": "given up"}) or 0.0

    before = given_up()
    world.hear(*[("entrance", TAG, -60.0)] * (receivers.PENDING + 7))
    assert given_up() == before + 7


def test_whoever_enrols_is_heard_soon(world: World) -> None:
    stopping = threading.Event()
    thread = threading.Thread(target=world.book.run, args=(stopping, 3600.0))
    thread.start()
    try:
        assert world.hear(("entrance", STRANGER, -60)) == {"not enrolled": 1}
        world.enrolled[digest_of(STRANGER, KEY)] = Registered("d-3", "hand")
        world.book.expect_news()
        wait_until(lambda: world.hear(("entrance", STRANGER, -60)) == {"used": 1}, 10, "the newcomer to be known")
    finally:
        stopping.set()
        thread.join(10)


def test_while_the_bus_is_away_the_newest_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receivers, "OUTBOX", 3)
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    session = router(endpoint)
    bus = Bus([endpoint])
    world = World(endpoint, bus, {digest_of(TAG, KEY): Registered("d-1", "hand")})
    session.close()
    wait_until(lambda: not bus.connected, 10, "the bus to be away")
    now = time.time()
    for second in range(6):
        world.hear(("entrance", TAG, -60 - second), t=now - 40.0 + second)
    world.now += 2.0
    world.book.flush()
    session = router(endpoint)
    wait_until(lambda: bus.connected, 20, "the bus to be back")
    assert [scan.rssi for scan in world.told(3)] == [[-63], [-64], [-65]]
    assert [scan.seq for scan in world.scans] == [3, 4, 5]
    bus.close()
    session.close()
