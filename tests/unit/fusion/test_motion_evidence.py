"""What a phone's walk says about which track carries it."""

import numpy as np
import pytest

from services.fusion.walks.motion_evidence import LIMIT, WalkFilters
from services.fusion.walks.stretches import Walk

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


def test_to_go_on_standing_says_nothing_for_anybody() -> None:
    still = [Walk(float(n), n + 1.0, 0.0, float("nan"), 0.0) for n in range(20)]
    evidence = total(still, np.zeros((20, 2)), np.full((20, 2), 0.7))
    assert -1.0 < evidence[0] < 2.0
    assert evidence[1] < -20.0


def test_a_stride_that_is_told_too_long_is_found_out() -> None:
    filters = WalkFilters.new(1, 2)
    columns = np.array([0, 1])
    for n, heading in enumerate(TURNS * 3):
        moved = np.array([np.cos(heading), np.sin(heading)])
        filters.walk(0, columns, Walk(float(n), n + 1.0, 1.25, heading, 0.03), np.array([moved, 1.25 * moved]))
    assert filters.scale[0] == pytest.approx([1.25, 1.0], abs=0.06)


def test_either_side_of_a_doubtful_heading_is_believed() -> None:
    """Front or back of a pocket: the walk is told turned about, with the right way as the other one."""
    doubtful = [
        Walk(float(n), n + 1.0, 1.2, heading + np.pi, 0.03, other=heading, other_probability=0.4)
        for n, heading in enumerate(TURNS)
    ]
    evidence = total(doubtful, moves(TURNS), moves(TURNS[::-1]))
    assert evidence[0] > evidence[1] + 5.0


def test_a_new_walk_forgets_bias_and_scale() -> None:
    filters = WalkFilters.new(1, 2)
    first = Walk(0.0, 1.0, 1.2, 0.4, 0.03, number=1)
    filters.begin(0, first)
    filters.walk(0, ROWS, first, moves([0.0, 0.0]))
    assert filters.bias[0, 0] > 0.05
    filters.begin(0, Walk(1.0, 2.0, 1.2, 0.4, 0.03, number=2))
    assert (filters.bias[0] == 0.0).all()
