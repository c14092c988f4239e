"""Names on tracks with a known answer."""

import math

import numpy as np
from numpy.testing import assert_array_equal
from track_frames import frame

from benchmarks.identity_metrics import UNNAMED, bearers, score_identity
from benchmarks.people_followed import NOBODY
from benchmarks.world_record import Truth

# Ann stands at 0 with phone a, Bob at 0.8 with phone b, a stranger at 5; ten seconds, all in view.
TIMES = np.arange(10) * 1.0
PLACES = {1: (0.1, 0.0), 2: (0.7, 0.0), 3: (5.0, 0.0)}
RIGHT = {1: "a", 2: "b"}
SWAPPED = {1: "b", 2: "a"}


def people() -> Truth:
    position = np.broadcast_to(np.array([[0.0, 0.0], [0.8, 0.0], [5.0, 0.0]]), (10, 3, 2)).copy()
    return Truth(TIMES, ["ann", "bob", "eve"], ["a", "b", None], position, np.ones((10, 3), np.bool_))


def test_all_right_from_the_first_second() -> None:
    score = score_identity(people(), [frame(t, PLACES, RIGHT) for t in TIMES])
    assert score.figures("x_") == {
        "x_id_precision": 1.0,
        "x_id_recall": 1.0,
        "x_located_within_1m": 1.0,
        "x_id_switches": 0,
        "x_seconds_to_identify": 0.0,
        "x_seconds_to_identify_p90": 0.0,
        "x_seconds_to_settle": 0.0,
        "x_never_identified": 0.0,
    }


def test_a_name_on_the_neighbour_is_near_and_yet_wrong() -> None:
    score = score_identity(people(), [frame(t, PLACES, SWAPPED) for t in TIMES])
    assert_array_equal(score.precision, [0.0, 0.0])
    assert_array_equal(score.recall, [0.0, 0.0])
    assert_array_equal(score.located, [1.0, 1.0])
    assert score.figures()["never_identified"] == 1.0
    assert score.figures()["seconds_to_identify"] is None


def test_precision_is_of_the_names_given_and_recall_of_the_time_in_view() -> None:
    truth = people()
    truth.in_view[8:, 0] = False
    named = [{}, {}, RIGHT, RIGHT, SWAPPED, RIGHT, {}, {}, {}, {}]
    score = score_identity(truth, [frame(t, PLACES, names) for t, names in zip(TIMES, named, strict=True)])
    assert score.device == ["a", "b"]
    assert_array_equal(score.precision, [3 / 4, 3 / 4])
    assert_array_equal(score.recall, [3 / 8, 3 / 10])
    assert_array_equal(score.switches, [2, 2])  # there and back
    assert_array_equal(score.first, [2.0, 2.0])
    assert_array_equal(score.settled, [5.0, 5.0])  # the swap at 4 undid what came before; silence undoes nothing


def test_a_name_on_nobody_is_wrong_but_no_switch() -> None:
    ghost = {**PLACES, 4: (20.0, 0.0)}
    named = [RIGHT] * 4 + [{4: "a"}] * 2 + [RIGHT] * 4
    score = score_identity(people(), [frame(t, ghost, names) for t, names in zip(TIMES, named, strict=True)])
    assert score.precision[0] == 8 / 10
    assert score.switches[0] == 0
    assert score.settled[0] == 6.0


def test_every_return_to_the_view_is_a_stay_of_its_own_but_a_blink_is_not() -> None:
    truth = people()
    truth.in_view[2, 0] = False  # two seconds from seen to seen
    truth.in_view[5:8, 0] = False
    named = [{}] * 4 + [RIGHT] + [{}] * 4 + [RIGHT]
    score = score_identity(truth, [frame(t, PLACES, names) for t, names in zip(TIMES, named, strict=True)])
    assert_array_equal(score.stay, [0, 0, 1])
    assert_array_equal(score.first, [4.0, 1.0, 4.0])


def test_never_seen_and_never_named_are_not_defined_rather_than_zero() -> None:
    truth = people()
    truth.in_view[:] = False
    score = score_identity(truth, [])
    assert np.isnan(score.precision).all()
    assert np.isnan(score.recall).all()
    figures = score.figures()
    assert figures.pop("id_switches") == 0
    assert set(figures.values()) == {None}


def test_bearers_are_found_one_to_one_with_as_many_pairs_as_the_gate_allows() -> None:
    # Track 2 is nearest to Bob and to Ann; Ann's only other choice is none, Bob's is track 1.
    assert_array_equal(
        bearers(people(), [frame(0, {1: (1.7, 0.0), 2: (0.75, 0.0)}, {1: "b", 2: "a"})])[:4],
        [[0, 1], [0, 1], [0, 1], [UNNAMED, UNNAMED]],
    )
    assert_array_equal(bearers(people(), [frame(0, {1: (9.0, 0.0)}, {1: "b"})])[0], [UNNAMED, NOBODY])


def test_the_score_does_not_depend_on_who_comes_first() -> None:
    random = np.random.default_rng(5)
    frames = []
    for t in TIMES:
        places = {track: tuple(random.uniform(-1, 6, 2) * (1, 0.1)) for track in range(5)}
        names = dict(zip(random.permutation(5)[:2].tolist(), "ab", strict=True))
        frames.append(frame(t, places, names))
    truth = people()
    order = [2, 1, 0]
    other = Truth(
        truth.t,
        [truth.person[i] for i in order],
        [truth.device[i] for i in order],
        truth.position[:, order],
        truth.in_view[:, order],
    )
    assert score_identity(truth, frames).figures() == score_identity(other, frames).figures()
    assert math.isfinite(score_identity(truth, frames).figures()["id_precision"] or math.nan)
