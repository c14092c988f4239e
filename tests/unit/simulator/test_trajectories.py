"""Trajectory files: read honestly, interpolated, and refused with line and field when wrong."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.simulator.crowd.trajectories import LINGER, Trajectories, TrajectoryError
from services.simulator.people import Movement, snapshot


def motion_of(people: Trajectories, person: str, times: np.ndarray) -> Movement:
    return people.movement(np.asarray(times, float), [people.persons.index(person)])


def straight(speed: float, direction: float, seconds: float = 20.0, person: int = 1) -> np.ndarray:
    t = np.arange(0.0, seconds, 0.4)
    return np.column_stack([t, np.full(len(t), person), speed * t * np.cos(direction), speed * t * np.sin(direction)])


@given(speed=st.floats(0.4, 2.0), direction=st.floats(-3.0, 3.0))
def test_a_straight_walk_has_its_speed_and_heading_from_the_first_row_to_the_last(
    speed: float, direction: float
) -> None:
    people = Trajectories(straight(speed, direction), "f")
    motion = motion_of(people, "1", np.linspace(0.0, people.end, 100))
    assert motion.present.all()
    np.testing.assert_allclose(motion.speed, speed, rtol=1e-3)
    np.testing.assert_allclose(np.cos(motion.heading - direction), 1.0, atol=1e-6)


def test_between_two_rows_a_person_is_in_between() -> None:
    people = Trajectories(np.array([[0.0, 3, 1.0, 2.0], [1.0, 3, 2.0, 4.0]]), "f")
    np.testing.assert_allclose(snapshot(people, 0.25, "f").position, [[1.25, 2.5]])


def test_people_are_absent_before_after_and_in_long_gaps() -> None:
    rows = np.array([[1.0, 1, 0, 0], [2.0, 1, 1, 0], [12.0, 1, 5, 0], [13.0, 1, 6, 0]])
    people = Trajectories(rows, "f")
    present = {t: len(snapshot(people, t, "f").person) for t in (0.9, 1.0, 1.5, 2.0, 7.0, 12.0, 13.0, 13.1)}
    assert present == {0.9: 0, 1.0: 1, 1.5: 1, 2.0: 1, 7.0: 0, 12.0: 1, 13.0: 1, 13.1: 0}


def test_a_phone_is_followed_for_a_while_after_its_person_left_and_then_no_more() -> None:
    people = Trajectories(straight(1.0, 0.0), "f")
    motion = motion_of(people, "1", people.end + np.array([0.5 * LINGER, 1.1 * LINGER]))
    assert motion.known[:, 0].tolist() == [True, False]
    assert not motion.present.any()
    assert motion.position[0, 0, 0] == pytest.approx(people.end + 0.5 * LINGER, abs=0.1)


def test_a_person_who_stops_keeps_facing_the_same_way() -> None:
    walk = straight(1.0, 1.0, 10.0)
    stop = np.column_stack([np.arange(10.0, 20.0, 0.4), np.ones(25), np.repeat([walk[-1, 2:]], 25, axis=0)])
    stop[:, 2:] += np.random.default_rng(0).normal(0, 0.02, (25, 2))
    motion = motion_of(Trajectories(np.vstack([walk, stop]), "f"), "1", np.arange(12.0, 19.0, 0.1))
    np.testing.assert_allclose(motion.heading, 1.0, atol=0.15)
    assert motion.speed.max() < 0.3


def test_longest_present_counts_time_in_view_not_time_between_first_and_last() -> None:
    there = straight(1.0, 0.0, 4.0, person=5)
    there_and_back = np.vstack([there, there + np.array([100, 0, 0, 0])])
    people = Trajectories(np.vstack([straight(1.0, 0.0, 9.0, person=7), there_and_back]), "f")
    assert people.longest_present(2) == ["7", "5"]


def test_table_with_header_is_read(tmp_path: Path) -> None:
    file = tmp_path / "walk.csv"
    file.write_text("id,t,x,y,note\n2,0.0,1.0,2.0,a\n2,1.0,3.0,2.0,b\n")
    people = Trajectories.from_csv(file, "f")
    assert people.persons == ("2",)
    np.testing.assert_allclose(snapshot(people, 0.5, "f").position, [[2.0, 2.0]])


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
        Trajectories.from_csv(file, "f")
    assert told in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="nowhere"):
        Trajectories.from_mot(tmp_path / "nowhere.txt", "f")


def test_pets_truth_is_read_with_its_true_rate(data_folder: Path) -> None:
    people = Trajectories.from_mot(data_folder / "pets09-s2l1" / "gt" / "gt.txt", "f")
    assert len(people.persons) == 19
    assert people.end == pytest.approx(794 / 7)
    first = snapshot(people, 0.0, "f")
    np.testing.assert_allclose(first.position[list(first.person).index("9")], [-4.1554, -7.3591])
    assert len(people.instants(-1.0, people.end)) == 795
    speeds = np.concatenate([motion_of(people, p, people._paths[p].grid).speed[:, 0] for p in people.persons])
    assert 0.8 < np.median(speeds) < 1.8
    assert np.quantile(speeds, 0.999) < 4.0


def test_in_a_long_gap_a_phone_is_soon_unknown_and_known_again_shortly_before_its_person_returns() -> None:
    there = straight(1.0, 0.0, 4.0)
    people = Trajectories(np.vstack([there, there + np.array([60, 0, 0, 0])]), "f")
    motion = motion_of(people, "1", np.array([3.0, 5.5, 3.6 + LINGER, 30.0, 59.0, 61.0]))
    assert motion.present[:, 0].tolist() == [True, False, False, False, False, True]
    assert motion.known[:, 0].tolist() == [True, True, True, False, True, True]
    assert np.isnan(motion.position[3]).all()
    assert (motion.floor[:, 0] == np.where(motion.known[:, 0], 0, -1)).all()


def test_chosen_people_move_as_among_all() -> None:
    rows = np.vstack([straight(0.5 + 0.1 * person, 0.3 * person, 12.0, person=person) for person in range(1, 7)])
    people = Trajectories(np.random.default_rng(0).permutation(rows), "f")
    times = np.linspace(-12.0, 25.0, 200)
    everybody, some = people.movement(times), people.movement(times, [4, 1])
    np.testing.assert_array_equal(some.position, everybody.position[:, [4, 1]])
    np.testing.assert_array_equal(some.walked, everybody.walked[:, [4, 1]])
    assert people.movement(np.array([])).position.shape == (0, 6, 2)


def test_annotations_of_eth_are_read_with_their_own_columns_and_rate(tmp_path: Path) -> None:
    file = tmp_path / "obsmat.txt"
    file.write_text("  780.0 1.0 8.0 0.0 3.0 1.6 0.0 0.1\n786.0 1.0 9.0 0.0 3.5 1.6 0.0 0.1\n")
    people = Trajectories.from_eth(file, "f")
    assert people.end == pytest.approx(0.4)
    np.testing.assert_allclose(snapshot(people, 0.2, "f").position, [[8.5, 3.25]])
    file.write_text("780 1 8 0\n")
    with pytest.raises(TrajectoryError, match="line 1: y is missing"):
        Trajectories.from_eth(file, "f")


def test_eth_walkers_are_all_read(data_folder: Path) -> None:
    people = Trajectories.from_eth(data_folder / "eth-walking" / "seq_eth" / "obsmat.txt", "f")
    assert len(people.persons) == 360
    assert people.end == pytest.approx((12381 - 780) / 15)
    moved = people.movement(np.arange(0.0, people.end, 0.4))
    assert 0.8 < np.median(moved.speed[moved.present]) < 1.8
