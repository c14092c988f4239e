"""For how long what is kept, what stays of it when it is old, and how it leaves and comes back as a file."""

import gzip
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from history_world import MINUTE, NOON, bring_in, frame, fresh, walker
from sqlalchemy import Engine, func, select
from typer.testing import CliRunner

from services.cli.main import app
from services.history import transfer
from services.history.entries import AlertTold, Counted, Entry, Forgotten
from services.history.reads import device_points, minutes_of, parts_of
from services.history.retention import Retention, Tidying
from services.history.sampling import Sampler
from services.history.tables import AlertRow, BlockRow, ErasedRow
from services.history.transfer import TransferError, export_history, import_history
from shared.messages import Alert

DAY = 86400.0
KEEP = Retention(phones=3 * DAY, people=10 * DAY, detail=1 * DAY, coarse=10.0, alerts=5 * DAY, counts=20 * DAY)


def day_of(start: float, minutes: int = 5, device: str = "d-1") -> list[Entry]:
    sampler = Sampler(1.0, {"hall": "ground"})
    entries: list[Entry] = []
    for t in np.arange(start, start + minutes * MINUTE, 1.0).tolist():
        entries += sampler.tracks(frame(t, [(7, *walker(t), device)]))
    alert = Alert(
        t=start, id=f"a-{start}-{device}", zone="entrance", kind="enter", area="hall", track=7, floor="ground",
        x=1.0, y=1.0, device=device,
    )  # fmt: skip
    return [*entries, AlertTold(alert=alert), Counted(kind="zone", t=start, place=["z"], people=[3], phones=[1])]


def count(engine: Engine, table: type) -> int:
    with engine.connect() as connection:
        return connection.scalar(select(func.count()).select_from(table)) or 0


def tidy(engine: Engine, now: float, keep: Retention = KEEP) -> None:
    tidying = Tidying(engine, keep)
    while tidying.work(now):
        pass


def test_what_is_too_old_goes_each_after_its_time(tmp_path: Path) -> None:
    engine = fresh(tmp_path)
    bring_in(engine, day_of(NOON))
    for days, phones, people, alerts, counts in (
        (2, True, True, 1, True),
        (4, False, True, 1, True),
        (6, False, True, 0, True),
        (11, False, False, 0, True),
        (21, False, False, 0, False),
    ):
        tidy(engine, NOON + days * DAY)
        assert bool(len(device_points(engine, "d-1", NOON, NOON + DAY).t)) == phones
        assert bool(list(parts_of(engine, "track", NOON, NOON + DAY))) == people
        with engine.connect() as connection:
            told = connection.scalars(select(AlertRow.device)).all()
        assert told == (["d-1"] if phones else [None]) * alerts, "an old alert tells no name"
        assert bool(minutes_of(engine, "zone", NOON, NOON + DAY)) == counts


def test_what_is_old_gets_thinner_once_and_stands_for_the_same_time(tmp_path: Path) -> None:
    engine = fresh(tmp_path)
    bring_in(engine, [*day_of(NOON), *day_of(NOON + 2 * DAY)])
    tidy(engine, NOON + 2 * DAY)
    old = device_points(engine, "d-1", NOON, NOON + DAY).t
    assert old.tolist() == [NOON + second for second in range(0, 300, 10)]
    (part,) = parts_of(engine, "track", NOON, NOON + DAY)
    assert part.seconds.sum() == 300.0
    assert len(device_points(engine, "d-1", NOON + 2 * DAY, NOON + 3 * DAY).t) == 300


def test_a_large_backlog_is_tidied_in_portions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.history.retention.AT_ONCE", 2)
    engine = fresh(tmp_path)
    bring_in(engine, day_of(NOON))
    tidying = Tidying(engine, KEEP)
    before = count(engine, BlockRow)
    first = tidying.work(NOON + 30 * DAY)
    assert 0 < before - count(engine, BlockRow) <= 4
    assert first
    while tidying.work(NOON + 30 * DAY):
        pass
    assert count(engine, BlockRow) == 0
    assert tidying.work(NOON + 30 * DAY + 1.0) == 0, "not again at once"


def stored(engine: Engine) -> dict[str, object]:
    t = device_points(engine, "d-1", NOON, NOON + 2 * DAY)
    return {
        "points": sorted(zip(t.t.tolist(), t.values.T.tolist(), strict=True)),
        "people": {k: v.people.tolist() for k, v in minutes_of(engine, "zone", NOON, NOON + 2 * DAY).items()},
        "alerts": count(engine, AlertRow),
        "blocks": count(engine, BlockRow),
    }


def test_a_file_holds_all_and_twice_brought_in_is_once(tmp_path: Path) -> None:
    one, other = fresh(tmp_path, "one.db"), fresh(tmp_path, "other.db")
    bring_in(one, [*day_of(NOON), *day_of(NOON, device="d-2"), Forgotten(device="d-3", t=NOON)])
    file = tmp_path / "all.gz"
    rows = export_history(one, file)
    assert import_history(other, file) == import_history(other, file) == rows
    assert stored(other) == stored(one)
    assert count(other, ErasedRow) == 1
    assert export_history(one, tmp_path / "none.gz", since=NOON + DAY) == 1
    assert export_history(one, tmp_path / "some.gz", since=NOON + 60.0, until=NOON + 120.0) == 5


def test_one_device_s_file_tells_of_nobody_else(tmp_path: Path) -> None:
    engine = fresh(tmp_path)
    bring_in(engine, [*day_of(NOON), *day_of(NOON, device="d-2"), Forgotten(device="d-3", t=NOON)])
    file = tmp_path / "own.gz"
    assert export_history(engine, file, device="d-2") == 5 + 1
    text = gzip.decompress(file.read_bytes()).decode()
    assert "d-1" not in text
    assert "d-3" not in text
    assert '"kind":"track"' not in text


def test_who_is_erased_does_not_come_back_from_a_backup(tmp_path: Path) -> None:
    engine = fresh(tmp_path)
    bring_in(engine, day_of(NOON))
    export_history(engine, tmp_path / "backup.gz")
    bring_in(engine, [Forgotten(device="d-1", t=NOON)], "later")
    import_history(engine, tmp_path / "backup.gz")
    assert len(device_points(engine, "d-1", NOON, NOON + DAY).t) == 0
    with engine.connect() as connection:
        assert connection.scalars(select(AlertRow.device)).all() == [None]


def test_who_withdraws_during_an_export_is_erased_where_it_is_brought_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, other = fresh(tmp_path, "one.db"), fresh(tmp_path, "other.db")
    bring_in(one, day_of(NOON))
    real = transfer._pages

    def pages(*arguments: Any) -> Iterator[Any]:
        for row in real(*arguments):
            bring_in(one, [Forgotten(device="d-1", t=NOON)], "meanwhile")
            yield row

    monkeypatch.setattr(transfer, "_pages", pages)
    export_history(one, tmp_path / "all.gz")
    import_history(other, tmp_path / "all.gz")
    assert count(other, BlockRow) > 0
    assert len(device_points(other, "d-1", NOON, NOON + DAY).t) == 0


def spoiled(change: Callable[[dict[str, object]], object]) -> Callable[[list[str]], list[str]]:
    """Change the first block of a file."""

    def spoil(lines: list[str]) -> list[str]:
        place = next(number for number, line in enumerate(lines) if '"block"' in line)
        row = json.loads(lines[place])
        change(row)
        return [*lines[:place], json.dumps(row), *lines[place + 1 :]]

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda lines: lines[:-1], "is cut off after"),
        (lambda lines: lines[1:], "is no file of `atrium history export`"),
        (lambda lines: [*lines[:-2], lines[-1]], "should hold"),
        (lambda lines: [*lines, lines[1]], "after the end"),
        (lambda lines: [lines[0], "{", *lines[1:]], "line 2"),
        (spoiled(lambda row: row.update(points="AAAA")), "points"),
        (spoiled(lambda row: row.update(subject="no id")), "identifiers"),
        (spoiled(lambda row: row.update(minute=10**17)), "minutes"),
        (spoiled(lambda row: row.update(kind="everybody")), "kind"),
    ],
)
def test_a_file_that_holds_what_cannot_be_changes_nothing(
    tmp_path: Path, spoil: Callable[[list[str]], list[str]], words: str
) -> None:
    one, other = fresh(tmp_path, "one.db"), fresh(tmp_path, "other.db")
    bring_in(one, day_of(NOON))
    export_history(one, tmp_path / "all.gz")
    lines = gzip.decompress((tmp_path / "all.gz").read_bytes()).decode().splitlines()
    (tmp_path / "bad.gz").write_bytes(gzip.compress("\n".join(spoil(lines)).encode()))
    with pytest.raises(TransferError, match=words):
        import_history(other, tmp_path / "bad.gz")
    assert count(other, BlockRow) == 0


def test_a_file_that_is_none_is_said_to_be_none(tmp_path: Path) -> None:
    engine = fresh(tmp_path)
    for content in (b"", b"no gzip", os.urandom(3000), gzip.compress(b"x" * 1000)[:-20]):
        (tmp_path / "bad.gz").write_bytes(content)
        with pytest.raises(TransferError):
            import_history(engine, tmp_path / "bad.gz")


def test_the_command_takes_out_and_brings_in_and_says_what_is_wrong(tmp_path: Path) -> None:
    bring_in(fresh(tmp_path, "one.db"), day_of(NOON))
    other = fresh(tmp_path, "other.db")
    one_url, other_url = f"sqlite:///{tmp_path / 'one.db'}", f"sqlite:///{tmp_path / 'other.db'}"
    file = str(tmp_path / "all.gz")
    run = CliRunner()
    done = run.invoke(app, ["history", "export", file, "--database", one_url, "--since", "2026-01-01"])
    assert (done.exit_code, "rows written" in done.output) == (0, True), done.output
    done = run.invoke(app, ["history", "import", file, "--database", other_url])
    assert (done.exit_code, "brought in" in done.output) == (0, True), done.output
    assert len(device_points(other, "d-1", NOON, NOON + DAY).t) == 300
    for arguments, words in (
        (["export", file, "--database", one_url, "--since", "yesterday"], "--since"),
        (["export", file, "--database", one_url, "--device", "no id"], "--device"),
        (["export", file, "--database", f"sqlite:///{tmp_path / 'new.db'}"], "atrium migrate"),
        (["import", str(tmp_path / "one.db"), "--database", other_url], "not packed"),
        (["import", str(tmp_path / "nothing"), "--database", other_url], "No such file"),
    ):
        done = run.invoke(app, ["history", *arguments])
        assert done.exit_code == 1
        assert words in done.output.replace("\n", " "), done.output
