"""Consent is on record, tokens are not, and a database that is not ready says so in one line."""

import sqlite3
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text

from services.gateway.devices.database import VERSION_TABLE, migrate, open_engine, schema_problem
from services.gateway.devices.storage import DeviceStore, Newcomer, Registered, TransmitterTakenError, Walker
from services.gateway.devices.tables import Base
from services.gateway.devices.tokens import WITHDRAWABLE
from services.gateway.devices.transmitters import can_be_enrolled, digest_of
from shared.runner import ServiceError


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'gateway.db'}"


def test_the_migrations_make_exactly_the_tables_the_program_uses(url: str) -> None:
    migrate(url)
    migrate(url)  # again does no harm
    with open_engine(url).connect() as connection:
        context = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE})
        assert compare_metadata(context, Base.metadata) == []
    assert schema_problem(open_engine(url)) is None


def test_a_missing_or_old_schema_is_named_with_the_way_out(url: str) -> None:
    engine = open_engine(url)
    assert "has no gateway tables: run `atrium migrate`" in (schema_problem(engine) or "")
    migrate(url)
    with engine.begin() as connection:
        connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '0000'"))
    assert "is at version 0000" in (schema_problem(engine) or "")


GUIDE = Newcomer("1", "guide", "android", "hand")
KEY = "a key for addresses"


def test_a_device_is_known_by_its_tokens_until_they_are_revoked_or_consent_is_withdrawn(url: str) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    device, token = store.enrol(100.0, GUIDE, ("post", "read"), 200.0, KEY)
    other, other_token = store.enrol(101.0, Newcomer("1", carrying="pocket"), ("post",), 200.0, KEY)
    second = store.add_token(device.id, 102.0, ("post",), 150.0)
    assert store.by_token(token.id) == store.by_token(second.id) == device
    assert store.by_token("x") is None
    assert store.tokens(device.id, 149.0) == [token, second]
    assert store.tokens(device.id, 150.0) == [token]
    assert not store.revoke_token(other.id, second.id, 103.0)
    assert store.revoke_token(device.id, second.id, 103.0)
    assert not store.revoke_token(device.id, second.id, 104.0)
    assert store.by_token(second.id) is None
    store.withdraw(device.id, 200.0)
    assert store.by_token(token.id) is None
    assert not store.exists(device.id)
    assert store.by_token(other_token.id) == other


def test_how_a_phone_is_carried_and_how_its_carrier_walks_come_with_its_token(url: str) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    device, token = store.enrol(100.0, GUIDE, ("post",), 200.0, KEY)
    store.carry(device.id, "bag")
    assert store.by_token(token.id) == Registered(device.id, "bag")
    store.keep_walker(device.id, Walker(peak=1.5, mean=0.8), 101.0)
    store.keep_walker(device.id, Walker(peak=12.9, mean=12.5, slope=0.4, offset=0.1, scale_variance=0.01), 102.0)
    found = DeviceStore(open_engine(url)).by_token(token.id)  # after a restart
    assert found == Registered(device.id, "bag", Walker(12.9, 12.5, 0.4, 0.1, 0.01))


def test_the_database_holds_consent_and_no_token(url: str, tmp_path: Path) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    newcomer = Newcomer("2", "guide", "android", "hand", ("02:B7:00:00:00:01",))
    device, _ = store.enrol(100.0, newcomer, ("post",), 200.0, KEY)
    store.keep_walker(device.id, Walker(peak=1.5), 101.0)
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        plain.execute("INSERT INTO gateway_spool (device, kind, payload) VALUES (?, 'motion', x'00')", (device.id,))
    assert not any(b"02:b7:00:00:00:01" in path.read_bytes().lower() for path in tmp_path.iterdir())
    store.withdraw(device.id, 200.0)
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        assert plain.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        consents = plain.execute("SELECT device, version, given, withdrawn FROM gateway_consents").fetchall()
        devices = plain.execute("SELECT id, token_sha256, name, platform, revoked FROM gateway_devices").fetchall()
        for table in ("tokens", "transmitters", "walkers", "spool"):
            assert plain.execute(f"SELECT count(*) FROM gateway_{table}").fetchone() == (0,), table
    assert consents == [(device.id, "2", 100.0, 200.0)]
    assert devices == [(device.id, None, "", "", 200.0)]


def test_a_transmitter_belongs_to_one_device_and_comes_free_with_its_withdrawal(url: str) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    tag, band = "02:B7:00:00:00:01", "02-b7-00-00-00-02"
    first, _ = store.enrol(100.0, Newcomer("1", transmitters=(tag,)), ("post",), 200.0, KEY)
    with pytest.raises(TransmitterTakenError) as caught:
        store.enrol(101.0, Newcomer("1", transmitters=(band, tag.lower())), ("post",), 200.0, KEY)
    assert caught.value.index == 1
    assert {device.id for device in store.devices_by_digest(101.0).values()} == {
        first.id
    }  # nothing of the second is stored
    assert store.devices_by_digest(101.0) == {digest_of(tag, KEY): first}
    store.withdraw(first.id, 102.0)
    second, _ = store.enrol(103.0, Newcomer("1", transmitters=(tag,)), ("post",), 200.0, KEY)
    assert store.devices_by_digest(103.0) == {digest_of(tag, KEY): second}


def test_a_transmitter_comes_free_when_no_token_of_its_device_is_valid_and_dead_tokens_are_deleted(
    url: str, tmp_path: Path
) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    tag = "02:B7:00:00:00:01"
    first, token = store.enrol(100.0, Newcomer("1", transmitters=(tag,)), ("post",), 200.0, KEY)
    longer = store.add_token(first.id, 100.0, ("manage",), 300.0)
    store.purge(250.0)
    assert store.devices_by_digest(250.0) == {digest_of(tag, KEY): first}
    store.revoke_token(first.id, longer.id, 260.0)
    assert store.devices_by_digest(260.0) == {}
    second, _ = store.enrol(261.0, Newcomer("1", transmitters=(tag,)), ("post",), 400.0, KEY)
    assert store.devices_by_digest(261.0) == {digest_of(tag, KEY): second}
    store.purge(270.0)
    assert store.by_token(token.id) == first  # may still withdraw
    store.purge(200.0 + WITHDRAWABLE)
    assert store.by_token(token.id) is None
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        for table in ("tokens", "transmitters"):
            left = plain.execute(f"SELECT count(*) FROM gateway_{table} WHERE device = ?", (first.id,)).fetchone()
            assert left == (0,), table


def test_names_of_transmitters_are_told_apart_and_only_those_of_one_alone_are_taken() -> None:
    uuid = "426c7565-0000-4000-8000-000000000001"
    assert digest_of(f"iBeacon:{uuid}-1-23", KEY) != digest_of(f"iBeacon:{uuid}-12-3", KEY)
    assert digest_of(f"iBeacon:{uuid}-1-23", KEY) == digest_of(f"ibeacon:{uuid.replace('-', '').upper()}-1-23", KEY)
    assert digest_of("02-B7-00-00-00-01", KEY) == digest_of(" 02:b7:00:00:00:01", KEY) == digest_of("02b700000001", KEY)
    for name in ("02-B7-00-00-00-01", "02b700000001", f"iBeacon:{uuid}-1-23", "irk:" + "0a" * 16):
        assert can_be_enrolled(name), name
    for name in (
        "apple:1005:9-24",
        "msft:cdp",
        "x",
        "02:b7:00-00:00:01",
        "02:b7:00:00:00",
        "irk:0a",
        f"iBeacon:{uuid}",
    ):
        assert not can_be_enrolled(name), name


def test_tokens_from_before_they_were_signed_are_gone_after_the_migration(url: str, tmp_path: Path) -> None:
    migrate(url, "0001")
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        plain.execute("INSERT INTO gateway_devices VALUES ('d-1', 'digest', '', '', 'hand', 1.0, NULL)")
    migrate(url)
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        assert plain.execute("SELECT id, token_sha256 FROM gateway_devices").fetchall() == [("d-1", None)]


@pytest.mark.parametrize("url", ["nonsense", "nosuch://x/y"])
def test_a_malformed_url_is_one_line_that_tells_what_is_allowed(url: str) -> None:
    with pytest.raises(ServiceError, match="allowed: sqlite"):
        open_engine(url)


def test_a_database_that_cannot_be_opened_is_named_without_its_password(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match="unable to open"):
        migrate(f"sqlite:///{tmp_path}/no/such/folder/a.db")
    with pytest.raises(ServiceError) as caught:
        migrate("postgresql://atrium:hidden-word@127.0.0.1:9/none?connect_timeout=2")
    assert "hidden-word" not in str(caught.value)
