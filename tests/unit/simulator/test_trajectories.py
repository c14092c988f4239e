"""Trajectory files: read honestly, interpolated, and refused with line and field when wrong."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.simulator.trajectories import LINGER, Trajectories, TrajectoryError


def straight(speed: float, direction: float, seconds: float = 20.0, person: int = 1) -> np.ndarray:
    t = np.arange(0.0, seconds, 0.4)
    return np.column_stack([t, np.full(len(t), person), speed * t * np.cos(direction), speed * t * np.sin(direction)])


@given(speed=st.floats(0.4, 2.0), direction=st.floats(-3.0, 3.0))
def test_a_straight_walk_has_its_speed_and_heading_from_the_first_row_to_the_last(
    speed: float, direction: float
) -> None:
    people = Trajectories(straight(speed, direction))
    motion = people.motion("1", np.linspace(0.0, people.end, 100))
    assert motion.present.all()
    np.testing.assert_allclose(motion.speed, speed, rtol=1e-3)
    np.testing.assert_allclose(np.cos(motion.heading - direction), 1.0, atol=1e-6)


def test_between_two_rows_a_person_is_in_between() -> None:
    people = Trajectories(np.array([[0.0, 3, 1.0, 2.0], [1.0, 3, 2.0, 4.0]]))
    np.testing.assert_allclose(people.snapshot(0.25).position, [[1.25, 2.5]])


def test_people_are_absent_before_after_and_in_long_gaps() -> None:
    rows = np.array([[1.0, 1, 0, 0], [2.0, 1, 1, 0], [12.0, 1, 5, 0], [13.0, 1, 6, 0]])
    people = Trajectories(rows)
    present = {t: len(people.snapshot(t).person) for t in (0.9, 1.0, 1.5, 2.0, 7.0, 12.0, 13.0, 13.1)}
    assert present == {0.9: 0, 1.0: 1, 1.5: 1, 2.0: 1, 7.0: 0, 12.0: 1, 13.0: 1, 13.1: 0}


def test_a_phone_is_followed_for_a_while_after_its_person_left_and_then_no_more() -> None:
    people = Trajectories(straight(1.0, 0.0))
    motion = people.motion("1", people.end + np.array([0.5 * LINGER, 1.1 * LINGER]))
    assert motion.known.tolist() == [True, False]
    assert not motion.present.any()
    assert motion.position[0, 0] == pytest.approx(people.end + 0.5 * LINGER, abs=0.1)


def test_a_person_who_stops_keeps_facing_the_same_way() -> None:
    walk = straight(1.0, 1.0, 10.0)
    stop = np.column_stack([np.arange(10.0, 20.0, 0.4), np.ones(25), np.repeat([walk[-1, 2:]], 25, axis=0)])
    stop[:, 2:] += np.random.default_rng(0).normal(0, 0.02, (25, 2))
    motion = Trajectories(np.vstack([walk, stop])).motion("1", np.arange(12.0, 19.0, 0.1))
    np.testing.assert_allclose(motion.heading, 1.0, atol=0.15)
    assert motion.speed.max() < 0.3


def test_longest_present_counts_time_in_view_not_time_between_first_and_last() -> None:
    there = straight(1.0, 0.0, 4.0, person=5)
    there_and_back = np.vstack([there, there + np.array([100, 0, 0, 0])])
    people = Trajectories(np.vstack([straight(1.0, 0.0, 9.0, person=7), there_and_back]))
    assert people.longest_present(2) == ["7", "5"]


def test_table_with_header_is_read(tmp_path: Path) -> None:
    file = tmp_path / "walk.csv"
    file.write_text("id,t,x,y,note\n2,0.0,1.0,2.0,a\n2,1.0,3.0,2.0,b\n")
    people = Trajectories.from_csv(file)
    assert people.persons == ("2",)
    np.testing.assert_allclose(people.snapshot(0.5).position, [[2.0, 2.0]])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "header"),
        ("t,id,x\n0,1,2\n", "y missing"),
        ("t,id,x,y\n0,1,2,abc\n", "line 2: y must be a finite number (found 'abc')"),
        ("t,id,x,y\n0,1,nan,3\n", "line 2: x must be a finite number"),
        ("t,id,x,y\n0,1,2\n", "line 2: y is missing"),
        ("t,id,x,y\n", "no rows"),
    ],
)
def test_a_bad_table_is_refused_with_line_and_field(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "walk.csv"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=r"walk\.csv") as caught:
        Trajectories.from_csv(file)
    assert told in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="nowhere"):
        Trajectories.from_mot(tmp_path / "nowhere.txt")


def test_pets_truth_is_read_with_its_true_rate(data_folder: Path) -> None:
    people = Trajectories.from_mot(data_folder / "pets09-s2l1" / "gt" / "gt.txt")
    assert len(people.persons) == 19
    assert people.end == pytest.approx(794 / 7)
    first = people.snapshot(0.0)
    np.testing.assert_allclose(first.position[list(first.person).index("9")], [-4.1554, -7.3591])
    assert len(people.instants(-1.0, people.end)) == 795
    speeds = np.concatenate([people.motion(p, people._paths[p].grid).speed for p in people.persons])
    assert 0.8 < np.median(speeds) < 1.8
    assert np.quantile(speeds, 0.999) < 4.0
