"""What waits on disk: nothing told is lost, whatever ends the process, and it never grows without bound."""

from pathlib import Path

import pytest

from services.history.entries import Counted, Entry
from services.history.spool import Spool, SpoolFullError


def counted(number: int, places: int = 1) -> Entry:
    return Counted(kind="zone", t=float(number), place=["z"] * places, people=[1] * places, phones=[0] * places)


def all_of(spool: Spool) -> list[float]:
    found: list[float] = []
    for name in spool.files():
        entries, trouble = spool.read(name)
        assert trouble == ""
        found += [entry.t for entry in entries if isinstance(entry, Counted)]
    return found


def test_what_was_appended_comes_back_in_order_also_to_the_next_process(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 10**6)
    spool.append([counted(1), counted(2)])
    spool.append([counted(3)])
    assert all_of(spool) == [1.0, 2.0, 3.0]
    spool.append([counted(4)])
    # No close: the process was killed.
    after = Spool(tmp_path, 10**6)
    after.append([counted(5)])
    assert all_of(after) == [1.0, 2.0, 3.0, 4.0, 5.0]
    for name in after.files():
        after.remove(name)
    assert after.waiting == 0
    assert list(tmp_path.iterdir()) == []


def test_a_long_outage_makes_many_files_and_no_large_one(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 10**9)
    for number in range(6):
        spool.append([counted(number, 400_000)])
    assert len(spool.files()) > 1
    assert all_of(spool) == [float(number) for number in range(6)]


def test_when_too_much_waits_that_is_an_error_and_what_waits_stays(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 1000)
    spool.append([counted(1)])
    with pytest.raises(SpoolFullError, match="may"):
        spool.append([counted(2, 1000)])
    spool.append([counted(3)])
    assert all_of(spool) == [1.0, 3.0]


@pytest.mark.parametrize("cut", [1, 5, 9, 20])
def test_a_file_whose_end_was_not_written_gives_what_stands_before(tmp_path: Path, cut: int) -> None:
    spool = Spool(tmp_path, 10**6)
    spool.append([counted(1), counted(2)])
    (name,) = spool.files()
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:-cut])
    entries, trouble = spool.read(name)
    assert [entry.t for entry in entries if isinstance(entry, Counted)] == [1.0]
    assert "cut off" in trouble


def test_a_damaged_byte_is_seen(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 10**6)
    spool.append([counted(1)])
    (name,) = spool.files()
    content = bytearray((tmp_path / name).read_bytes())
    content[-2] ^= 1
    (tmp_path / name).write_bytes(bytes(content))
    assert spool.read(name) == ([], "cut off or damaged")


def test_names_do_not_come_again_in_an_emptied_folder(tmp_path: Path) -> None:
    names = set()
    for _ in range(3):
        spool = Spool(tmp_path, 10**6)
        spool.append([counted(1)])
        names.update(spool.files())
        for name in spool.files():
            spool.remove(name)
    assert len(names) == 3
