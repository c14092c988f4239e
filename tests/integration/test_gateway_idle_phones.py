"""Idle phones cost nothing, and are taken back as if nothing had been."""

import json
import time
from pathlib import Path

import pytest
from waiting import wait_until

from services.gateway.devices.storage import Registered
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.heard_site import LEAST
from services.gateway.phones.phone_book import PhoneBook
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import Message, RadioScan, StrideModel
from shared.site import load_site

DEVICE = Registered("d-1", "hand")


def body(seq: int) -> bytes:
    scan = {"t": 100.0, "address": ["02:a7:00:00:00:01"], "rssi": [-50]}
    return json.dumps({"sent": 100.0, "seq": seq, "radio": [scan]}).encode()


@pytest.fixture
def site_file(project: Path) -> Path:
    return project / "deploy/sites/hall/site.yaml"


def test_an_idle_phone_holds_no_publisher_and_goes_on_where_it_was(zenoh_router: str, site_file: Path) -> None:
    site = load_site(site_file)
    with Bus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), idle=10.0) as phones:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        before = len(bus._declared)
        phones.post(DEVICE, body(0), time.time())
        assert len(bus._declared) == before + 1
        phones.rest(time.monotonic() + 11.0)
        assert len(bus._declared) == before
        assert phones.post(DEVICE, body(0), time.time()).duplicate
        phones.post(DEVICE, body(1), time.time())
        received: list[Message] = []

        def both() -> bool:
            received.extend(delivery.message for delivery in inbox.receive(0.1))
            return len(received) >= 2

        wait_until(both, 20, "both scans")
        assert [message.seq for message in received if isinstance(message, RadioScan)] == [0, 1]


def test_a_phone_silent_for_very_long_is_forgotten_whole(zenoh_router: str, site_file: Path) -> None:
    with Bus([zenoh_router]) as bus, PhoneBook(load_site(site_file), bus, Limits(), idle=10.0) as phones:
        phones.post(DEVICE, body(0), time.time())
        phones.rest(time.monotonic() + 121.0)
        assert not phones._entries
        assert not phones.post(DEVICE, body(0), time.time()).duplicate


def test_phones_that_hear_none_of_the_sites_access_points_are_told_of(zenoh_router: str, site_file: Path) -> None:
    with Bus([zenoh_router]) as bus, PhoneBook(load_site(site_file), bus, Limits(), idle=10.0) as phones:
        for seq in range(LEAST):
            assert phones.heard.problem(time.monotonic()) is None
            phones.post(DEVICE, body(seq).replace(b"02:a7:00:00:00:01", b"0e:00:00:00:00:99"), time.time())
        assert "unknown access points only" in str(phones.heard.problem(time.monotonic()))


def test_a_bus_that_is_gone_keeps_the_batch_for_the_next_try(zenoh_router: str, site_file: Path) -> None:
    bus = Bus([zenoh_router])
    with PhoneBook(load_site(site_file), bus, Limits(), idle=10.0) as phones:
        phones.post(DEVICE, body(0), time.time())
        bus.close()
        with pytest.raises(RequestError) as caught:
            phones.post(DEVICE, body(1), time.time())
        assert caught.value.status == 503
        assert len(phones._entries[DEVICE.id].phone.outbox) == 1


class LosingBus(Bus):
    """A bus that is seen to be away right after the next publication, once."""

    lose = False
    published = 0

    @property
    def connected(self) -> bool:
        if self.lose and self.published:
            self.lose = False
            return False
        self.published += self.lose
        return super().connected


def test_what_is_published_again_after_the_bus_went_away_keeps_its_number(zenoh_router: str, site_file: Path) -> None:
    site = load_site(site_file)
    with LosingBus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), idle=10.0) as phones:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        phones.post(DEVICE, body(0), time.time())
        bus.lose = True
        with pytest.raises(RequestError) as caught:
            phones.post(DEVICE, body(1), time.time())
        assert caught.value.status == 503
        assert phones.post(DEVICE, body(1), time.time()).duplicate
        phones.post(DEVICE, body(2), time.time())
        received: list[RadioScan] = []

        def heard() -> bool:
            received.extend(d.message for d in inbox.receive(0.1) if isinstance(d.message, RadioScan))
            return len(received) >= 4

        wait_until(heard, 20, "three scans, one of them twice")
        assert [scan.seq for scan in received] == [0, 1, 1, 2]
        assert received[1] == received[2]


def test_a_forgotten_phone_is_not_taken_in_again_by_a_batch_that_was_on_its_way(
    zenoh_router: str, site_file: Path
) -> None:
    with Bus([zenoh_router]) as bus, PhoneBook(load_site(site_file), bus, Limits(), idle=10.0) as phones:
        phones.post(DEVICE, body(0), time.time())
        phones.forget(DEVICE.id)
        with pytest.raises(RequestError) as caught:
            phones.post(DEVICE, body(1), time.time())
        assert caught.value.status == 401
        assert not phones._entries


def test_one_bad_batch_of_a_group_hurts_no_other_and_a_phones_own_come_one_after_the_other(
    zenoh_router: str, site_file: Path
) -> None:
    site = load_site(site_file)
    with Bus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), idle=10.0) as phones:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        bodies = [body(0), b"{", body(1), body(1), body(2)]
        waiting = [phones.submit(DEVICE, each, time.time()) for each in bodies]
        assert [waiting[k].result(10.0).duplicate for k in (0, 2, 3, 4)] == [False, False, True, False]
        with pytest.raises(RequestError):
            waiting[1].result(10.0)
        told: list[int] = []

        def all_told() -> bool:
            told.extend(d.message.seq for d in inbox.receive(0.1) if isinstance(d.message, RadioScan))
            return len(told) >= 3

        wait_until(all_told, 20, "three scans")
        assert told == [0, 1, 2]


def test_a_learned_stride_model_is_used_for_its_person(zenoh_router: str, site_file: Path) -> None:
    site = load_site(site_file)
    with Bus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), idle=10.0) as phones:
        phones.post(DEVICE, body(0), time.time())
        publisher = bus.publisher(Keys(site.site).stride_model(DEVICE.id), StrideModel, cached=True)
        publisher.publish(StrideModel(t=1.0, device=DEVICE.id, version=2, slope=0.4, offset=0.1, scale_variance=0.001))
        line = wait_until(lambda: phones._entries[DEVICE.id].phone.walk.line, 10, "the model")
        assert (float(line.slope), float(line.offset)) == (0.4, 0.1)
        phones.rest(time.monotonic() + 11.0)
        assert phones._entries[DEVICE.id].phone.walk.line is line
        phones.forget(DEVICE.id)
        assert DEVICE.id not in phones._models
