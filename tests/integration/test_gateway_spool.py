"""What is acknowledged while the bus is away is not lost: it waits in the database, over a restart, in order."""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from gateway_process import Listener, Phone, Running, finish, is_ready, launch
from sqlalchemy.exc import OperationalError
from waiting import wait_until

from services.gateway.devices.database import migrate, open_engine
from services.gateway.devices.erasures import Erasures
from services.gateway.devices.storage import DeviceStore, Newcomer, Registered
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.phones.spool import Spool, SpoolFullError
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Erasure, RadioScan
from shared.site import Site, load_site


@pytest.fixture
def spool(tmp_path: Path) -> Spool:
    url = f"sqlite:///{tmp_path / 'spool.db'}"
    migrate(url)
    return Spool(open_engine(url), 10_000)


@pytest.fixture
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


def scan(device: str, seq: int) -> RadioScan:
    return RadioScan(t=100.0 + seq, device=device, seq=seq, access_point=["ap-1"], rssi=[-50.0])


def body(seq: int) -> bytes:
    heard = {"t": 100.0 + seq, "address": ["02:a7:00:00:00:01"], "rssi": [-50]}
    return json.dumps({"sent": 100.0 + seq, "seq": seq, "radio": [heard]}).encode()


def test_what_waits_comes_back_oldest_first_and_is_erased_with_its_device(spool: Spool) -> None:
    spool.put([scan("d-1", 0), scan("d-2", 0)])
    spool.put([scan("d-1", 1)])
    again = Spool(spool._engine, 10_000)
    assert (len(again), "d-1" in again, "d-3" in again) == (3, True, False)
    assert [(e.device, e.message and e.message.seq) for e in again.oldest(10)] == [("d-1", 0), ("d-2", 0), ("d-1", 1)]
    again.forget("d-1")
    assert [e.device for e in again.oldest(10)] == ["d-2"]
    again.drop(again.oldest(10))
    assert not again
    assert not again.oldest(1)


def test_a_full_spool_stores_nothing_of_what_does_not_fit(spool: Spool) -> None:
    for seq in range(80):
        spool.put([scan("d-1", seq)])
    with pytest.raises(SpoolFullError):
        spool.put([scan("d-1", seq) for seq in range(100, 200)])
    assert len(spool) == len(spool.oldest(1000)) == 80


class AwayBus(Bus):
    """A bus that can be seen as away while it is not."""

    away = False

    @property
    def connected(self) -> bool:
        return not self.away and super().connected


def test_a_phone_s_newer_messages_wait_behind_its_older_ones(zenoh_router: str, site: Site, spool: Spool) -> None:
    with AwayBus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), 10.0, spool) as phones:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        mine = Registered("d-1", "hand")
        phones.post(mine, body(0), time.time())
        bus.away = True
        for seq in (1, 2):
            assert not phones.post(mine, body(seq), time.time()).duplicate
        assert len(spool) == 2
        bus.away = False
        for seq in (3, 4):
            phones.post(mine, body(seq), time.time())
        told: list[int] = []

        def all_told() -> bool:
            told.extend(d.message.seq for d in inbox.receive(0.05) if isinstance(d.message, RadioScan))
            return len(told) >= 5

        wait_until(all_told, 20, "five scans")
        assert told == [0, 1, 2, 3, 4]
        wait_until(lambda: not spool, 20, "the spool to be empty")


def test_a_full_spool_refuses_the_batch_and_keeps_it_for_the_next_try(
    zenoh_router: str, site: Site, spool: Spool
) -> None:
    full = Spool(spool._engine, 10)
    with AwayBus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), 10.0, full) as phones:
        bus.away = True
        with pytest.raises(RequestError) as caught:
            phones.post(Registered("d-1", "hand"), body(0), time.time())
        assert caught.value.status == 503
        bus.away = False
        assert phones.post(Registered("d-1", "hand"), body(0), time.time()).duplicate
        assert not full


def test_a_withdrawn_consent_erases_what_waits(zenoh_router: str, site: Site, spool: Spool) -> None:
    with AwayBus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), 10.0, spool) as phones:
        bus.away = True
        for device in ("d-1", "d-2"):
            phones.post(Registered(device, "hand"), body(0), time.time())
        phones.forget("d-1")
        assert [entry.device for entry in spool.oldest(10)] == ["d-2"]


@pytest.fixture
def gateways(tmp_path: Path) -> Iterator[Callable[[str], Running]]:
    started: list[Running] = []

    def start(endpoint: str) -> Running:
        started.append(launch(endpoint, tmp_path))
        return started[-1]

    yield start
    for running in started:
        if running.process.poll() is None:
            finish(running)


def test_what_is_acknowledged_without_a_router_arrives_once_after_a_restart(
    gateways: Callable[[str], Running], free_port: int
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    session = router(endpoint)
    first = gateways(endpoint)
    wait_until(lambda: is_ready(first), 30, "the gateway to be ready")
    phone = Phone(first)
    session.close()
    wait_until(lambda: not is_ready(first), 15, "the gateway to miss its router")
    for seq in range(5):
        assert phone.post(phone.batch(seq)).status_code in (200, 202)
    assert finish(first) == 0
    session = router(endpoint)
    listener = Listener(endpoint)
    second = gateways(endpoint)
    wait_until(lambda: is_ready(second), 30, "the gateway to be ready again")
    phone.http = second.http
    wait_until(lambda: len(listener.heard(phone.device)[0]) >= 5, 10, "the scans that waited")
    assert phone.post(phone.batch(5)).status_code in (200, 202)
    wait_until(lambda: len(listener.heard(phone.device)[0]) >= 6, 10, "the scan after them")
    scans = listener.heard(phone.device)[0]
    assert [scan.t for scan in scans] == sorted({scan.t for scan in scans})
    assert len(scans) == 6
    listener.bus.close()
    session.close()


def test_an_erasure_without_a_router_is_told_after_a_restart(
    gateways: Callable[[str], Running], free_port: int
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    session = router(endpoint)
    first = gateways(endpoint)
    wait_until(lambda: is_ready(first), 30, "the gateway to be ready")
    phone = Phone(first)
    session.close()
    wait_until(lambda: not is_ready(first), 15, "the gateway to miss its router")
    assert phone.post(phone.batch(0)).status_code in (200, 202)
    assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 204
    assert finish(first) == 0
    session = router(endpoint)
    listener = Listener(endpoint)
    gateways(endpoint)
    wait_until(lambda: phone.device in listener.erased(), 20, "everybody to be told whom to forget")
    assert listener.heard(phone.device) == ([], [])
    with Bus([endpoint]) as bus:  # joins when all was told: it is told what it missed
        inbox = bus.inbox()
        inbox.subscribe(Keys("hall").erasure(), Erasure, cached=True)
        (late,) = wait_until(lambda: inbox.receive(0.05), 10, "who was not there to be told") or []
        assert isinstance(late.message, Erasure)
        assert late.message.device == phone.device
    listener.bus.close()
    session.close()


def test_an_erasure_waits_while_the_bus_or_what_forgets_fails(zenoh_router: str, site: Site, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'spool.db'}"
    migrate(url)
    engine = open_engine(url)
    store = DeviceStore(engine)
    device, _ = store.enrol(100.0, Newcomer("1"), ("manage",), 200.0, "a key for addresses")
    store.withdraw(device.id, 101.0)
    forgotten: list[str] = []

    def forget(which: str) -> None:
        forgotten.append(which)
        if len(forgotten) == 1:
            raise OperationalError("", {}, Exception("locked"))

    with AwayBus([zenoh_router]) as bus:
        inbox = bus.inbox()
        inbox.subscribe(Keys(site.site).erasure(), Erasure)
        erasures = Erasures(engine, bus, Keys(site.site), forget)
        bus.away = True
        erasures.tell()
        assert (erasures.waiting(), forgotten) == ([device.id], [])
        bus.away = False
        erasures.tell()
        assert erasures.waiting() == [device.id]
        erasures.tell()
        assert erasures.waiting() == []
        told: list[str] = []

        def heard() -> bool:
            told.extend(d.message.device for d in inbox.receive(0.05) if isinstance(d.message, Erasure))
            return bool(told)

        wait_until(heard, 20, "the erasure")
        assert (told, forgotten) == ([device.id], [device.id, device.id])
