"""No lesson may become worse than stored: a short museum world, taught by the shipped tracker's own tracks."""

import pytest
from learning_gate import ROOM, measure, read, worse


def test_lessons_are_no_worse_than_stored() -> None:
    assert not worse(measure(), read())


def test_what_is_stored_is_what_is_measured() -> None:
    assert sorted(read()) == sorted(ROOM)


@pytest.mark.parametrize("name", sorted(ROOM))
def test_the_gate_closes_beyond_the_room_of_each_figure(name: str) -> None:
    stored = read()
    assert worse({**stored, name: stored[name] + 0.9 * ROOM[name]}, stored) == []
    assert len(worse({**stored, name: stored[name] + 1.1 * ROOM[name]}, stored)) == 1
    assert worse({**stored, name: stored[name] - 2.0 * ROOM[name]}, stored) == []
