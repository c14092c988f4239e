"""The floor plan's fast answers against slow and obvious ones."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.site import FloorPlan

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
coordinate = st.integers(-20, 120).map(lambda tenth: tenth / 10)
point = st.tuples(coordinate, coordinate)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float(np.sign((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])))


def _within(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> bool:
    return bool((np.minimum(a, b) <= p).all() and (p <= np.maximum(a, b)).all())


def _segments_meet(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Textbook orientation test, on integers: exact."""
    turns = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
    if turns[0] != turns[1] and turns[2] != turns[3]:
        return True
    on_line = [(turns[0], a, b, c), (turns[1], a, b, d), (turns[2], c, d, a), (turns[3], c, d, b)]
    return any(turn == 0 and _within(p, q, r) for turn, p, q, r in on_line)


wall = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), min_size=2, max_size=4, unique=True)
ends = st.tuples(st.integers(0, 12), st.integers(0, 12))


@settings(max_examples=200)
@given(st.lists(wall, max_size=5), st.lists(st.tuples(ends, ends), max_size=5))
def test_walls_crossed_agrees_with_testing_every_pair_of_segments(walls: list, paths: list) -> None:
    plan = FloorPlan.build(SQUARE, walls)
    start = np.array([a for a, _ in paths], float).reshape(-1, 2)
    end = np.array([b for _, b in paths], float).reshape(-1, 2)
    expected = [
        sum(
            a != b  # who does not move crosses nothing
            and any(_segments_meet(np.array(a), np.array(b), np.array(c), np.array(d)) for c, d in pairwise(line))
            for line in walls
        )
        for a, b in paths
    ]
    assert plan.walls_crossed(start, end).tolist() == expected


@given(st.lists(point, min_size=1, max_size=20))
def test_a_place_is_walkable_on_the_floor_and_in_no_obstacle(points: list[tuple[float, float]]) -> None:
    boxes = [(2.0, 2.0, 5.0, 5.0), (4.0, 4.0, 7.0, 7.0), (8.0, 1.0, 9.0, 9.0)]  # the first two overlap
    plan = FloorPlan.build(SQUARE, obstacles=[[(a, b), (c, b), (c, d), (a, d)] for a, b, c, d in boxes])
    walkable = plan.walkable(np.array(points))
    for (x, y), answer in zip(points, walkable, strict=True):
        on_floor = 0 <= x <= 10 and 0 <= y <= 10
        blocked = any(a < x < c and b < y < d for a, b, c, d in boxes)
        on_an_edge = any((x in (a, c) and b <= y <= d) or (y in (b, d) and a <= x <= c) for a, b, c, d in boxes)
        if not on_an_edge:  # whether the rim of an exhibit blocks is nobody's business
            assert answer == (on_floor and not blocked), (x, y)


def test_a_place_in_the_overlap_of_two_obstacles_is_blocked() -> None:
    first = [(2.0, 2.0), (5.0, 2.0), (5.0, 5.0), (2.0, 5.0)]
    second = [(4.0, 4.0), (7.0, 4.0), (7.0, 7.0), (4.0, 7.0)]
    plan = FloorPlan.build(SQUARE, obstacles=[first, second])
    assert plan.obstacles.is_valid
    assert not plan.walkable(np.array([[4.5, 4.5]]))[0]


def test_the_edge_of_the_floor_belongs_to_it() -> None:
    plan = FloorPlan.build(SQUARE)
    assert plan.contains(np.array([[0.0, 0.0], [10.0, 5.0], [5.0, 0.0]])).all()
    assert not plan.contains(np.array([[10.01, 5.0], [-0.01, 0.0]])).any()


@pytest.mark.parametrize("walls", [[], [[(1.0, 1.0), (2.0, 2.0)]]])
def test_no_paths_cross_nothing(walls: list) -> None:
    nothing = np.empty((0, 2))
    assert FloorPlan.build(SQUARE, walls).walls_crossed(nothing, nothing).shape == (0,)
    assert FloorPlan.build(SQUARE, walls).walkable(nothing).shape == (0,)


def test_obstacles_without_any_are_an_empty_shape() -> None:
    plan = FloorPlan.build(SQUARE)
    assert isinstance(plan.obstacles, shapely.MultiPolygon)
    assert plan.obstacles.is_empty
