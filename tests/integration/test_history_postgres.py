"""What history does to its tables, on a real PostgreSQL server: the same as on SQLite."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from history_world import MINUTE, NOON, bring_in, frame, fresh, walker
from postgres_server import postgres
from sqlalchemy import Engine, func, select

from services.history.database import migrate, open_history
from services.history.entries import AlertTold, Counted, Entry, Forgotten
from services.history.reads import device_points, minutes_of, parts_of
from services.history.retention import Retention, Tidying
from services.history.sampling import Sampler
from services.history.store import Store
from services.history.tables import AlertRow, AppliedRow, BlockRow
from services.history.transfer import export_history, import_history
from shared.messages import Alert, Revision

DAY = 86400.0


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    with postgres() as server:
        migrate(server.url)
        migrate(server.url)
        opened = open_history(server.url)
        yield opened
        opened.dispose()


def told(minutes: int, device: str) -> list[Entry]:
    sampler = Sampler(1.0, {"hall": "ground"})
    entries: list[Entry] = []
    for second in range(int(minutes * MINUTE)):
        entries += sampler.tracks(frame(NOON + second, [(7, *walker(NOON + second), device)]))
    alert = Alert(
        t=NOON, id=f"a-{device}", zone="entrance", kind="proximity", area="hall", track=7, floor="ground",
        x=1.0, y=1.0, device=device, other_device=device,
    )  # fmt: skip
    counts = [Counted(kind="zone", t=NOON + t, place=["z"], people=[n], phones=[1]) for t, n in ((0, 7), (1, 2))]
    return [*entries, AlertTold(alert=alert), *counts]


def test_all_that_is_done_to_sqlite_is_done_to_postgresql(engine: Engine, tmp_path: Path) -> None:
    hour = NOON, NOON + 3600.0
    for half in (told(2, "d-1")[:200], told(2, "d-1")[200:]):
        bring_in(engine, half)
    bring_in(engine, told(1, "d-2"), "the-same")
    bring_in(engine, told(1, "d-2"), "the-same")
    assert len(device_points(engine, "d-1", *hour).t) == 120
    zone = minutes_of(engine, "zone", *hour)["z"]
    assert (zone.counts.tolist(), zone.people.tolist(), zone.most.tolist()) == ([4], [18], [7])

    revision = Revision(
        t=NOON + 70.0, area="hall", chunk=1, tracker="test", device=["d-1"], since=[NOON + 50.0],
        of=[0], at=[NOON + 50.0], track=[0], x=[1.0], y=[1.0], covariance=[(0.1, 0.0, 0.1)], probability=[0.6],
    )  # fmt: skip
    replaced = Sampler(1.0, {"hall": "ground"}).revision(revision)
    assert replaced is not None
    bring_in(engine, [replaced], "revision")
    assert len(device_points(engine, "d-1", *hour).t) == 120 - 21 + 1

    # A text with a zero byte is what PostgreSQL holds nowhere.
    odd = Counted(kind="zone", t=NOON, place=["z\0"], people=[1], phones=[0])
    done = Store(engine).apply("odd", [odd, *told(1, "d-3")], ["odd"])
    assert len(done.refused) == 1
    assert len(device_points(engine, "d-3", *hour).t) == 60

    export_history(engine, tmp_path / "all.gz")
    sqlite = fresh(tmp_path)
    import_history(sqlite, tmp_path / "all.gz")
    assert len(device_points(sqlite, "d-1", *hour).t) == 100
    export_history(sqlite, tmp_path / "back.gz")

    assert Store(engine).apply("gone", [Forgotten(device="d-1", t=NOON)], ["gone"]).forgotten == ["d-1"]
    import_history(engine, tmp_path / "back.gz")
    assert len(device_points(engine, "d-1", *hour).t) == 0
    with engine.connect() as connection:
        rows = connection.execute(select(AlertRow.device, AlertRow.other_device).order_by(AlertRow.id)).all()
        assert [tuple(row) for row in rows] == [(None, None), ("d-2", "d-2"), ("d-3", "d-3")]
        assert connection.scalars(select(AppliedRow.name)).all() == ["gone"]

    keep = Retention(phones=1 * DAY, people=9 * DAY, detail=0.5 * DAY, coarse=10.0, alerts=DAY, counts=DAY)
    tidying = Tidying(engine, keep)
    while tidying.work(NOON + 2 * DAY):
        pass
    with engine.connect() as connection:
        assert set(connection.scalars(select(BlockRow.kind))) == {"track"}
        assert connection.scalar(select(func.count()).select_from(AlertRow)) == 0
    (part,) = parts_of(engine, "track", *hour)
    assert part.seconds.tolist() == [10.0] * 12
