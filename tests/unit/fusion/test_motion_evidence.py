"""What a phone's walk says about which track carries it."""

import math

import numpy as np
import pytest

from services.fusion.evidence.motion_evidence import LIMIT, Walk, WalkFilters, walks_of

ROWS = np.array([0, 1])


def total(walks: list[Walk], first: np.ndarray, second: np.ndarray) -> np.ndarray:
    filters = WalkFilters.new(1, 2)
    return sum(
        (
            filters.walk(0, ROWS, walk, np.array([one, other]))
            for walk, one, other in zip(walks, first, second, strict=True)
        ),
        np.zeros(2),
    )


def straight(headings: list[float], bias: float = 0.0, speed: float = 1.2) -> list[Walk]:
    return [Walk(float(n), n + 1.0, speed, heading + bias, 0.03) for n, heading in enumerate(headings)]


def moves(headings: list[float], speed: float = 1.2) -> np.ndarray:
    return speed * np.column_stack([np.cos(headings), np.sin(headings)])


TURNS = [0.0, 0.0, 1.5, 1.5, 3.0, 3.0, -1.7, -1.7]


def test_turning_together_speaks_for_a_track_whatever_the_phones_bias() -> None:
    for bias in (0.0, 0.3, -0.4):
        evidence = total(straight(TURNS, bias), moves(TURNS), moves(TURNS[::-1]))
        assert evidence[0] > 3.0
        assert evidence[1] < -5.0


def test_two_who_walk_alike_are_not_told_apart() -> None:
    evidence = total(straight(TURNS), moves(TURNS), moves(TURNS))
    assert evidence[0] == evidence[1]


def test_walking_straight_on_says_little() -> None:
    """Less in twenty seconds than two turns do."""
    evidence = total(straight([0.5] * 20), moves([0.5] * 20), moves([0.5] * 20))
    assert abs(evidence[0]) < 12.0


def test_who_stands_does_not_carry_a_phone_that_walks() -> None:
    evidence = total(straight([0.0] * 6), moves([0.0] * 6), np.zeros((6, 2)))
    assert evidence[0] - evidence[1] > 5.0


def test_no_second_says_more_than_the_limit() -> None:
    filters = WalkFilters.new(1, 2)
    wild = filters.walk(0, ROWS, Walk(0.0, 1.0, 2.9, 0.0, 0.001), np.array([[-50.0, 0.0], [2.9, 0.0]]))
    assert (np.abs(wild) <= LIMIT).all()


def test_a_batch_is_cut_into_seconds_and_steps_are_summed() -> None:
    walks = walks_of(10.0, 12.0, [10.4, 11.0, 11.6], [0.7, 0.6, 0.7], [0.1, 0.1, 0.2], [0.03, 0.03, 0.03])
    assert [(walk.t_start, walk.t) for walk in walks] == [(10.0, 11.0), (11.0, 12.0)]
    assert walks[0].length == pytest.approx(1.3)
    assert walks[1].heading == pytest.approx(0.2)


def test_no_steps_means_standing_and_unknown_headings_are_none() -> None:
    (still,) = walks_of(10.0, 11.0, [], [], [], [])
    assert still.length == 0.0
    assert math.isnan(still.heading)
    (unknown,) = walks_of(10.0, 11.0, [10.5], [0.7], [0.1], [9.9])
    assert math.isnan(unknown.heading)
    assert walks_of(10.0, 10.1, [], [], [], []) == []
    assert walks_of(10.0, 99.0, [], [], [], []) == []
