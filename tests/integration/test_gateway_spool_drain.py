"""What waited for the bus is told late and in spite of what is wrong with the row before it."""

import time
from pathlib import Path

import msgspec
import pytest
from prometheus_client import REGISTRY
from sqlalchemy import insert, update
from structlog.testing import capture_logs
from waiting import wait_until

from services.gateway.devices.database import migrate, open_engine
from services.gateway.devices.tables import SpoolRow
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.phones.spool import Spool
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import RadioScan, StrideModel
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


def test_what_waited_long_is_marked_late_when_it_is_told(zenoh_router: str, site: Site, spool: Spool) -> None:
    spool.put([scan("d-1", 0), msgspec.structs.replace(scan("d-1", 1), t=time.time())])
    with Bus([zenoh_router]) as bus:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        told: list[RadioScan] = []

        def all_told() -> bool:
            told.extend(d.message for d in inbox.receive(0.05) if isinstance(d.message, RadioScan))
            return len(told) >= 2

        with PhoneBook(site, bus, Limits(), 10.0, spool):
            wait_until(all_told, 20, "two scans")
        assert [message.late for message in told] == [True, False]


def test_a_row_that_cannot_be_read_is_set_aside_and_holds_nothing_up(
    zenoh_router: str, site: Site, spool: Spool
) -> None:
    spool.put([scan("d-1", 0)])
    with spool._engine.begin() as connection:
        connection.execute(update(SpoolRow).values(payload=b"of another version"))
        connection.execute(insert(SpoolRow), [{"device": "d-1", "kind": "of another version", "payload": b"{}"}])
    spool = Spool(spool._engine, 10_000)
    spool.put([scan("d-2", 1)])
    before = REGISTRY.get_sample_value("atrium_gateway_spool_unreadable_total") or 0.0
    with Bus([zenoh_router]) as bus:
        inbox = bus.inbox()
        inbox.subscribe(f"atrium/1/{site.site}/device/*/radio", RadioScan)
        with capture_logs() as logs, PhoneBook(site, bus, Limits(), 10.0, spool):
            wait_until(lambda: inbox.receive(0.05), 20, "the scan that can be read")
            wait_until(lambda: not spool, 20, "the spool to be empty")
    assert REGISTRY.get_sample_value("atrium_gateway_spool_unreadable_total") == before + 2
    assert len([entry for entry in logs if "cannot be read" in entry["event"]]) == 1


def test_a_spool_that_fails_does_not_keep_learned_strides_away(zenoh_router: str, site: Site, spool: Spool) -> None:
    spool.put([scan("d-1", 0)])
    with spool._engine.begin() as connection:
        connection.exec_driver_sql(f"DROP TABLE {SpoolRow.__tablename__}")
    with Bus([zenoh_router]) as bus, capture_logs() as logs, PhoneBook(site, bus, Limits(), 10.0, spool) as phones:
        model = StrideModel(t=time.time(), device="d-2", slope=0.3, offset=0.2, scale_variance=0.01, version=1)
        publisher = bus.publisher(Keys(site.site).stride_model("d-2"), StrideModel)

        def learned() -> bool:
            publisher.publish(model)
            return "d-2" in phones._models

        wait_until(learned, 10, "the model to be learned")
    assert len([entry for entry in logs if "could not be published" in entry["event"]]) == 1
