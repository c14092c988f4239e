"""Consent is on record, tokens are not, and a database that is not ready says so in one line."""

import sqlite3
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text

from services.gateway.devices.storage import VERSION_TABLE, Base, DeviceStore, migrate, open_engine, schema_problem
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


def test_a_device_is_known_by_its_token_until_consent_is_withdrawn(url: str) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    device, token = store.enrol(100.0, "1", "guide", "android", "hand")
    other, other_token = store.enrol(101.0, "1", "", "", "pocket")
    assert store.by_token(token) == device
    assert store.by_token("x") is None
    store.withdraw(device.id, 200.0)
    assert store.by_token(token) is None
    assert not store.exists(device.id)
    assert store.by_token(other_token) == other


def test_the_database_holds_consent_and_no_token(url: str, tmp_path: Path) -> None:
    migrate(url)
    store = DeviceStore(open_engine(url))
    device, token = store.enrol(100.0, "2", "guide", "android", "hand")
    store.withdraw(device.id, 200.0)
    with sqlite3.connect(tmp_path / "gateway.db") as plain:
        assert plain.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        consents = plain.execute("SELECT device, version, given, withdrawn FROM gateway_consents").fetchall()
        devices = plain.execute("SELECT id, token_sha256, name, platform, revoked FROM gateway_devices").fetchall()
    assert consents == [(device.id, "2", 100.0, 200.0)]
    assert devices == [(device.id, None, "", "", 200.0)]
    assert not any(token.encode() in path.read_bytes() for path in tmp_path.iterdir())


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
