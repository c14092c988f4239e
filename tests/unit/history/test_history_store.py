"""Positions go in as blocks and come out as they were; revisions, erasures and replays change what they should."""

import zlib
from pathlib import Path

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from history_world import MINUTE, NOON, bring_in, frame, fresh, walker
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Engine, func, select

from services.history.blocks import COLUMNS, BlockError, check, decode, encode, merge
from services.history.database import VERSION_TABLE
from services.history.device_alerts import device_alerts
from services.history.entries import AlertTold, Counted, Entry, Forgotten, Points
from services.history.persons import Persons
from services.history.reads import device_points, minutes_of, parts_of
from services.history.sampling import Sampler
from services.history.store import Store
from services.history.tables import AlertRow, Base, BlockRow
from shared.messages import Alert, Revision

FLOORS = {"hall": "ground"}


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    return fresh(tmp_path)


def minutes(count: int, device: str | None = "d-1") -> list[Entry]:
    sampler = Sampler(1.0, FLOORS)
    times = np.arange(NOON, NOON + count * MINUTE, 0.2)
    return [entry for t in times for entry in sampler.tracks(frame(float(t), [(7, *walker(float(t)), device)]))]


def test_the_migrations_make_exactly_the_tables_the_program_uses(engine: Engine) -> None:
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE})
        theirs = [d for d in compare_metadata(context, Base.metadata) if "history" in str(d)]
        assert theirs == []


whole = st.integers(-(2**31), 2**31 - 1)


@given(st.lists(st.lists(st.tuples(*[whole] * 7), max_size=70), max_size=5))
def test_any_block_comes_back_as_it_was_alone_and_among_others(told: list[list[tuple[int, ...]]]) -> None:
    blocks = [np.array(rows, np.int32).reshape(-1, 7).T for rows in told]
    counts, values = decode([encode(block) for block in blocks])
    assert counts.tolist() == [len(rows) for rows in told]
    assert np.array_equal(values, np.concatenate([np.empty((7, 0), np.int32), *blocks], axis=1))
    _, some = decode([encode(block) for block in blocks], ("track", "x"))
    assert np.array_equal(some, values[[COLUMNS.index("track"), 1]])


@pytest.mark.parametrize("broken", [b"", b"\x02abc", b"\x01abc", encode(np.zeros((7, 9), np.int32))[:-3]])
def test_bytes_that_are_no_block_are_refused(broken: bytes) -> None:
    with pytest.raises(BlockError):
        decode([broken])
    with pytest.raises(BlockError):
        check(broken)


def test_a_block_that_would_fill_the_memory_is_none() -> None:
    bomb = b"\x01" + zlib.compress(bytes(10**8))
    with pytest.raises(BlockError, match="more than"):
        check(bomb)
    good = np.arange(70, dtype=np.int32).reshape(7, 10)
    assert np.array_equal(check(encode(good)), good)


def test_of_two_points_of_one_moment_the_later_told_counts() -> None:
    old, new = np.zeros((7, 2), np.int32), np.ones((7, 2), np.int32)
    old[0], new[0] = [1000, 2000], [2000, 500]
    assert merge(old, new)[:2].tolist() == [[500, 1000, 2000], [1, 0, 1]]


def test_one_position_a_second_is_kept_in_a_block_per_minute(engine: Engine) -> None:
    bring_in(engine, minutes(3))
    found = device_points(engine, "d-1", NOON, NOON + 3 * MINUTE)
    assert len(found.t) == 180
    where = np.array([walker(t) for t in found.t])
    assert np.abs(found.values[1:3] / 100.0 - where.T).max() <= 0.0051
    assert set(found.values[COLUMNS.index("accuracy")].tolist()) == {20}
    assert set(found.values[COLUMNS.index("probability")].tolist()) == {900}
    with engine.connect() as connection:
        of = connection.execute(select(BlockRow.kind, func.count()).group_by(BlockRow.kind)).all()
        assert dict(tuple(row) for row in of) == {"device": 3, "track": 3}
    assert len(device_points(engine, "d-1", NOON + 30, NOON + 90).t) == 60
    areas = minutes_of(engine, "area", NOON, NOON + 3 * MINUTE)["hall"]
    assert (areas.people.tolist(), areas.most.tolist(), areas.phones.tolist()) == ([60] * 3, [1] * 3, [60] * 3)


def test_tracks_that_carried_the_same_phone_are_one_person_and_all_others_are_not(engine: Engine) -> None:
    """7 carries the phone, is lost, and found as 9; 8 is somebody else, though 9 was taken for it once; 0 is unseen."""
    sampler = Sampler(1.0, FLOORS)
    told = [
        frame(NOON, [(7, 1.0, 1.0, "d-1"), (8, 2.0, 1.0, None)]),
        frame(NOON + 60, [(8, 2.0, 1.0, None), (9, 1.0, 1.0, None)], former={9: [7, 8]}),
        frame(NOON + 120, [(8, 2.0, 1.0, None), (9, 1.0, 1.0, "d-1"), (0, 5.0, 5.0, "d-2")], ["d-2"], {9: [7, 8]}),
    ]
    bring_in(engine, [entry for one in told for entry in sampler.tracks(one)])

    def who() -> dict[float, set[int]]:
        (part,) = parts_of(engine, "track", NOON, NOON + 200)
        assert part.t.size == 6, "nobody is lost because a name moved on"
        return {x: set(part.person[part.x == x].tolist()) for x in (1.0, 2.0)}

    assert [len(who()[x]) for x in (1.0, 2.0)] == [1, 1]
    assert not who()[1.0] & who()[2.0]
    bring_in(engine, [Forgotten(device="d-1", t=NOON)], "forgotten")
    assert [len(who()[x]) for x in (1.0, 2.0)] == [2, 1], "the phone alone knew"
    (part,) = parts_of(engine, "device", NOON, NOON + 200)
    assert part.x.tolist() == [5.0]


def test_a_track_is_the_carrier_s_of_the_phone_it_had_longest_and_nobody_is_in_two_places() -> None:
    carried = [("a", "hall", "1:60"), ("b", "hall", "1:20 3:60"), ("a", "hall", "2:40"), ("a", "hall", "4:9 5:8")]
    lives = [("hall", "1", 10, 20), ("hall", "2", 15, 30), ("hall", "3", 0, 90), ("hall", "4", 20, 21)]
    persons = Persons([*carried, ("a", "west", "1:3")], [*lives, ("hall", "5", 19, 22), ("west", "1", 40, 41)])
    told = [persons.device("hall", track) for track in "123456"]
    assert told == ["a", None, "b", "a", None, None], "2 was there together with 1, and 5 with 4"
    assert persons.device("west", "1") == "a"


def test_a_revision_takes_the_place_of_what_was_said_since(engine: Engine) -> None:
    bring_in(engine, minutes(2))
    since, until = NOON + 50.0, NOON + 70.0
    told = Revision(
        t=until, area="hall", chunk=1, tracker="test", device=["d-1", "d-9"], since=[since, since],
        of=[0, 0, 0], at=[since, since + 0.2, since + 5.0], track=[3, 3, 0], x=[1.0, 1.1, 2.0], y=[1.0] * 3,
        covariance=[(0.01, 0.0, 0.01)] * 3, probability=[0.8] * 3,
    )  # fmt: skip
    replaced = Sampler(1.0, FLOORS).revision(told)
    assert replaced is not None
    bring_in(engine, [replaced], "second")
    found = device_points(engine, "d-1", NOON, NOON + 2 * MINUTE)
    order = np.argsort(found.t)
    during = [
        (t, x) for t, x in zip(found.t[order], found.values[1][order] / 100.0, strict=True) if since <= t <= until
    ]
    assert during == [(since, 1.0), (since + 5.0, 2.0)]
    assert len(found.t) == 120 - 21 + 2
    (part,) = parts_of(engine, "track", NOON, NOON + 2 * MINUTE)
    assert len(part.t) == 120, "whom cameras saw, they saw"


def test_a_file_of_the_spool_counts_once_however_often_it_comes(engine: Engine) -> None:
    entries = minutes(1)
    for _ in range(3):
        bring_in(engine, entries, "the-same")
    assert minutes_of(engine, "area", NOON, NOON + MINUTE)["hall"].counts.tolist() == [60]


def alert(number: int, **changes: object) -> AlertTold:
    fields = {"t": NOON, "id": f"a-{number}", "zone": "entrance", "kind": "enter", "area": "hall", "track": 1}
    return AlertTold(alert=Alert(**{**fields, "floor": "ground", "x": 1.0, "y": 1.0, **changes}))  # type: ignore[arg-type]


def test_nothing_is_left_of_who_withdraws_and_nothing_comes_back(engine: Engine, tmp_path: Path) -> None:
    device = "d-that-was-here-once"
    entries = [*minutes(2, device), alert(1, device=device), alert(2, device="d-2", other_device=device)]
    bring_in(engine, entries, "first")
    about = device_alerts(engine, device, NOON, NOON + 1.0)
    assert [(told.id, told.device, told.other_device) for told in about] == [("a-1", None, None), ("a-2", None, None)]
    assert Store(engine).apply("second", [Forgotten(device=device, t=NOON)], ["second"]).forgotten == [device]
    bring_in(engine, entries, "late")
    assert len(device_points(engine, device, NOON, NOON + 2 * MINUTE).t) == 0
    assert device_alerts(engine, device, NOON, NOON + 1.0) == []
    with engine.connect() as connection:
        rows = connection.execute(select(AlertRow.device, AlertRow.other_device, AlertRow.told)).all()
    assert sorted((row[0] or "", row[1] or "") for row in rows) == [("", ""), ("d-2", "")]
    assert not any(device in row[2] for row in rows)
    assert Store(engine).erased() == [device]
    (part,) = parts_of(engine, "track", NOON, NOON + 2 * MINUTE)
    assert len(part.t) == 120, "whom a camera saw stays, without a name"


def test_what_a_database_cannot_hold_stops_nothing_else(engine: Engine) -> None:
    entries: list[Entry] = [Counted(kind="zone", t=NOON, place=["z"], people=[2**70], phones=[0]), *minutes(1)]
    done = Store(engine).apply("odd", entries, ["odd"])
    assert len(done.refused) == 1
    assert len(device_points(engine, "d-1", NOON, NOON + MINUTE).t) == 60


def test_what_cannot_be_is_not_kept() -> None:
    sampler = Sampler(1.0, FLOORS)
    assert sampler.tracks(frame(1e300, [(1, 0.0, 0.0, None)])) == []
    assert sampler.tracks(frame(NOON, [(1, 0.0, 0.0, None)], area="elsewhere")) == []
    kept = sampler.tracks(frame(NOON, [(1, 1e300, 0.0, None), (2, 1.0, 1.0, "no id / at all"), (3, 1.0, 1.0, None)]))
    (points,) = [entry for entry in kept if isinstance(entry, Points)]
    assert points.subject == ["2", "3"]
