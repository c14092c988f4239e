"""Walls push once however they were drawn, and nobody walks through them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.fusion.forces import ForceSettings, Obstacles, displacement, stay_walkable, walkable_share
from services.fusion.forces.obstacles import straight_pieces
from shared.site import FloorPlan

Array = NDArray[np.float64]

ROOM = FloorPlan.build(
    outline=[(0, 0), (10, 0), (10, 8), (0, 8)],
    walls=[[(4, 0), (4, 5)]],
    obstacles=[[(6, 2), (8, 2), (8, 4), (6, 4)]],
)
IN_ROOM = Obstacles.of_plan(ROOM)


def push(obstacles: Obstacles, *places: tuple[float, float]) -> Array:
    """Return (n, 2) how far each of some lone people is pushed."""
    spots = np.array(places)[:, None]
    alone = np.ones((len(places), 1), np.bool_)
    shift, _ = displacement(spots, alone, np.full(alone.shape, np.nan), obstacles, ForceSettings(substeps=1))
    return shift[:, 0]


@pytest.mark.parametrize("pieces", [2, 7, 100])
def test_a_wall_pushes_the_same_in_how_many_pieces_it_was_drawn(pieces: int) -> None:
    whole = Obstacles.build(walls=shapely.LineString([(0, 0), (10, 0)]))
    cuts = np.linspace(0, 10, pieces + 1)
    apart = shapely.MultiLineString([[(a, 0), (b, 0)] for a, b in pairwise(cuts)])
    bent = shapely.LineString([(x, 1e-4 * (i % 2)) for i, x in enumerate(cuts)])
    places = (3.3, 0.1), (5.0, 0.5), (2.0, 1.5)
    expected = push(whole, *places)
    assert expected[0, 1] > 0.3
    np.testing.assert_allclose(push(Obstacles.build(walls=apart), *places), expected, atol=1e-12)
    np.testing.assert_allclose(push(Obstacles.build(walls=bent), *places), expected, atol=1e-3)


@pytest.mark.parametrize("cell", [1.0, 0.5, 0.25, 0.1])
def test_blocked_cells_push_like_the_wall_they_stand_for(cell: float) -> None:
    low = np.arange(0.0, 10.0, cell)
    blocked = shapely.union_all(shapely.box(low, -cell, low + cell, 0.0))
    cells = Obstacles.build(edges=shapely.boundary(blocked), inside=blocked)
    wall = Obstacles.build(walls=shapely.LineString([(0, 0), (10, 0)]))
    np.testing.assert_allclose(push(cells, (5.2, 0.4)), push(wall, (5.2, 0.4)), atol=1e-12)


def test_stairs_of_cells_push_about_like_the_slope_they_stand_for() -> None:
    for cell in (0.5, 0.1):
        low = np.arange(0.0, 10.0, cell)
        blocked = shapely.union_all([shapely.box(x, 0.0, x + cell, 10.0 - x) for x in low])
        stairs = Obstacles.build(edges=shapely.boundary(blocked), inside=blocked)
        slope = Obstacles.build(walls=shapely.LineString([(0, 10 + cell), (10 + cell, 0)]))
        place = (5.0 + cell + 0.3, 5.0 + 0.3)
        assert np.linalg.norm(push(stairs, place)) == pytest.approx(np.linalg.norm(push(slope, place)), rel=0.1)


def test_a_corner_pushes_from_both_its_walls() -> None:
    beside, corner = push(IN_ROOM, (0.5, 6.5), (0.5, 7.5))
    assert corner[0] == pytest.approx(beside[0], rel=0.01)
    assert -corner[1] == pytest.approx(corner[0])


def test_a_small_obstacle_pushes_once_from_its_corner() -> None:
    away = push(IN_ROOM, (5.7, 1.7))[0]
    disc = push(Obstacles.build(discs=np.array([[6.0, 2.0, 0.0]])), (5.7, 1.7))[0]
    np.testing.assert_allclose(away, disc + push(IN_ROOM, (5.7, 20.0))[0], atol=0.02)  # walls are far


def test_whoever_was_put_inside_an_obstacle_is_pushed_out_the_near_side() -> None:
    shift = push(IN_ROOM, (6.1, 3.0))[0]
    assert shift[0] < -0.4
    assert shift[1] == pytest.approx(0.0, abs=1e-12)


def test_whoever_was_put_beyond_the_outline_is_pushed_back() -> None:
    assert push(IN_ROOM, (5.0, 8.3))[0, 1] < -0.4


def test_far_from_everything_nothing_pushes() -> None:
    assert not push(IN_ROOM, (500.0, -300.0)).any()


def test_pieces_are_cut_where_lines_cross_and_joined_where_they_go_straight_on() -> None:
    lines = shapely.MultiLineString([[(0, 0), (1, 0), (2, 0)], [(2, 0), (3, 0)], [(1.5, -1), (1.5, 1)]])
    pieces = straight_pieces(lines)
    assert sorted(float(np.hypot(*(b - a))) for a, b in pieces) == pytest.approx([1.0, 1.0, 1.5, 1.5])


def test_how_far_a_way_is_free() -> None:
    start = np.array([[3.0, 1.0], [3.0, 6.0], [1.0, 1.0], [5.0, 3.0]])
    end = np.array([[5.0, 1.0], [5.0, 6.0], [2.0, 1.0], [9.0, 3.0]])
    np.testing.assert_allclose(walkable_share(start, end, IN_ROOM), [0.5, 1.0, 1.0, 0.25])


def test_a_long_way_is_stopped_by_the_first_of_many_walls() -> None:
    share = walkable_share(np.array([[1.0, 3.0]]), np.array([[9.0, 3.0]]), IN_ROOM)
    assert share[0] == pytest.approx(3.0 / 8.0)


def test_a_step_goes_on_along_the_wall_it_meets() -> None:
    stop = stay_walkable(np.array([[3.5, 1.0]]), np.array([[4.5, 2.0]]), IN_ROOM)[0]
    assert stop == pytest.approx([3.95, 2.0])


def test_a_step_into_a_corner_ends_there() -> None:
    stop = stay_walkable(np.array([[1.0, 1.0]]), np.array([[-1.0, -0.8]]), IN_ROOM)[0]
    assert 0.0 < stop[0] <= 0.06
    assert 0.0 < stop[1] <= 0.06


@pytest.mark.parametrize("start", [(3.0, 1.0), (1.0, 1.0)])
def test_a_step_that_ends_exactly_on_a_wall_does_not_pass_it_next_time(start: tuple[float, float]) -> None:
    """Near by, and from farther than the index of near pieces reaches."""
    first = stay_walkable(np.array([start]), np.array([[4.0, 1.0]]), IN_ROOM)
    assert first[0] == pytest.approx([3.95, 1.0])
    assert stay_walkable(first, first + np.array([[1.0, 0.0]]), IN_ROOM)[0, 0] < 4.0


def test_long_ways_build_no_index_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shapely, "STRtree", None)
    assert walkable_share(np.array([[1.0, 3.0]]), np.array([[9.0, 3.0]]), IN_ROOM)[0] == pytest.approx(3.0 / 8.0)


def test_an_estimate_inside_an_obstacle_may_walk_out_of_it() -> None:
    start, end = np.array([[7.0, 3.0]]), np.array([[9.0, 3.0]])
    np.testing.assert_array_equal(stay_walkable(start, end, IN_ROOM), end)


def test_an_estimate_behind_an_outer_wall_comes_back_in() -> None:
    walled = FloorPlan.build([(0, 0), (10, 0), (10, 8), (0, 8)], walls=[[(0, 0), (10, 0)]])
    start, end = np.array([[5.0, -0.2]]), np.array([[5.0, 0.4]])
    np.testing.assert_array_equal(stay_walkable(start, end, Obstacles.of_plan(walled)), end)


def test_places_that_are_not_known_stay_unknown() -> None:
    nowhere = np.full((1, 2), np.nan)
    assert walkable_share(nowhere, np.zeros((1, 2)), IN_ROOM)[0] == 1.0


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10_000), long=st.floats(0.0, 6.0))
def test_nobody_who_stands_on_the_floor_leaves_it_or_crosses_a_wall(seed: int, long: float) -> None:
    rng = np.random.default_rng(seed)
    start = rng.uniform((0.01, 0.01), (9.99, 7.99), (30, 2))
    start = start[ROOM.walkable(start)]
    angle = rng.uniform(-np.pi, np.pi, len(start))
    stop = stay_walkable(start, start + long * np.column_stack([np.cos(angle), np.sin(angle)]), IN_ROOM)
    assert ROOM.walkable(stop).all()
    assert (np.linalg.norm(stop - start, axis=1) <= long + 1e-9).all()
    direct = walkable_share(start, start + long * np.column_stack([np.cos(angle), np.sin(angle)]), IN_ROOM) == 1.0
    assert (ROOM.walls_crossed(start, stop)[direct] == 0).all()


def test_no_walker_jumps_a_thin_wall_within_a_prediction() -> None:
    """Two metres a second straight at a wall: the published forces alone would let him through."""
    start = np.array([[[3.6, 2.0]], [[3.0, 2.0]], [[2.2, 2.0]]])
    there, heading = np.ones((3, 1), np.bool_), np.zeros((3, 1))
    walk = np.broadcast_to([2.0, 0.0], start.shape)
    shift, _ = displacement(start, there, heading, IN_ROOM, ForceSettings(), np.array(walk))
    assert ((start + walk + shift)[..., 0] < 4.0).all()
