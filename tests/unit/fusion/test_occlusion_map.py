"""Obstacles learned from where people walk: blocked is where nobody goes though many pass."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from services.fusion.forces import Obstacles
from shared.occlusion_map import OcclusionMap, OcclusionSettings
from shared.site import FloorPlan

PILLAR = shapely.box(4.0, 3.0, 6.0, 5.0)


def walked(people: int, settings: OcclusionSettings | None = None, east: float = 7.0) -> OcclusionMap:
    """Return a map of a 10 m x 8 m hall after some straight walks across its part west of ``east``, round a pillar."""
    rng = np.random.default_rng(0)
    hall = OcclusionMap(np.zeros(2), np.array([10.0, 8.0]), settings)
    for number in range(people):
        a, b = rng.uniform((0, 0), (east, 8), (2, 2))
        way = np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / 0.2))
        way = way[~shapely.contains_xy(PILLAR, way[:, 0], way[:, 1])]
        for step, place in enumerate(way):
            hall.add(10.0 * number + 0.2 * step, place[None])
    return hall


@pytest.fixture(scope="module")
def hall() -> OcclusionMap:
    return walked(900, OcclusionSettings(half_life=1e6))


def cell_of(x: float, y: float) -> tuple[int, int]:
    return int(y / 0.5), int(x / 0.5)


def test_the_pillar_is_found_and_nothing_else(hall: OcclusionMap) -> None:
    found = hall.blocked()
    assert PILLAR.intersection(found).area > 0.9 * PILLAR.area
    assert found.difference(PILLAR.buffer(0.01)).area == pytest.approx(0.0)


def test_the_middle_of_a_large_obstacle_is_blocked_too() -> None:
    """Nobody passes close to it, so there is no traffic to compare with: it is blocked by what surrounds it."""
    block = shapely.box(3.0, 3.0, 9.0, 9.0)
    hall = OcclusionMap(np.zeros(2), np.array([12.0, 12.0]), OcclusionSettings(half_life=1e6))
    x, y = np.meshgrid(np.arange(0.25, 12.0, 0.5), np.arange(0.25, 12.0, 0.5))
    places = np.column_stack([x.ravel(), y.ravel()])
    places = places[~shapely.contains_xy(block, places[:, 0], places[:, 1])]
    for number in range(60):
        hall.add(10.0 * number, places)
    assert hall.blocked_cells()[cell_of(6.0, 6.0)]
    assert hall.blocked().symmetric_difference(block).area == pytest.approx(0.0, abs=1e-9)


def test_where_nobody_ever_was_is_not_blocked(hall: OcclusionMap) -> None:
    assert not hall.blocked_cells()[cell_of(9.0, 4.0)]


def test_few_visits_prove_nothing() -> None:
    assert walked(20, OcclusionSettings(half_life=1e6)).blocked().is_empty


def test_what_no_camera_sees_is_not_blocked(hall: OcclusionMap) -> None:
    nowhere: NDArray[np.bool_] = np.zeros(hall.centres().shape[:2], np.bool_)
    assert hall.blocked(nowhere).is_empty


def test_who_stands_still_visits_once() -> None:
    hall = OcclusionMap(np.zeros(2), np.array([5.0, 5.0]))
    for second in range(600):
        hall.add(0.2 * second, np.array([[2.6, 2.6]]))
    assert np.sum(hall.state()["visits"]) == pytest.approx(1.0, abs=0.2)


def test_old_visits_fade() -> None:
    hall = OcclusionMap(np.zeros(2), np.array([5.0, 5.0]), OcclusionSettings(half_life=10.0))
    hall.add(0.0, np.array([[2.6, 2.6]]))
    hall.add(20.0, np.array([[1.0, 1.0]]))
    visits = np.array(hall.state()["visits"])
    assert visits[cell_of(2.6, 2.6)] == pytest.approx(0.25)
    assert visits[cell_of(1.0, 1.0)] == pytest.approx(1.0)


def test_places_off_the_map_and_unknown_ones_are_left_out() -> None:
    hall = OcclusionMap(np.zeros(2), np.array([5.0, 5.0]))
    hall.add(0.0, np.array([[-1.0, 2.0], [2.0, 50.0], [np.nan, 1.0]]))
    assert not np.any(hall.state()["visits"])


def test_a_restored_map_goes_on_as_the_one_it_was_taken_from(hall: OcclusionMap) -> None:
    copies = [OcclusionMap(np.zeros(2), np.array([10.0, 8.0]), hall.settings) for _ in range(2)]
    copies[0].restore(hall.state())
    copies[1].restore(json.loads(json.dumps(hall.state())))
    assert copies[1].blocked().equals(hall.blocked())
    for copy in copies:
        copy.add(1e6, np.array([[5.0, 4.0]]))
    assert copies[0].state() == copies[1].state() != hall.state()


def test_a_state_of_another_floor_is_refused(hall: OcclusionMap) -> None:
    with pytest.raises(ValueError, match="map of"):
        OcclusionMap(np.zeros(2), np.array([3.0, 3.0])).restore(hall.state())


def test_learned_obstacles_push_like_drawn_ones(hall: OcclusionMap) -> None:
    floor = [(0.0, 0.0), (10.0, 0.0), (10.0, 8.0), (0.0, 8.0)]
    drawn = Obstacles.of_plan(FloorPlan.build(floor, obstacles=[[(4.0, 3.0), (6.0, 3.0), (6.0, 5.0), (4.0, 5.0)]]))
    learned = Obstacles.of_plan(FloorPlan.build(floor), hall.blocked())
    places = np.array([[3.6, 4.2], [6.3, 3.6], [5.0, 5.4]])
    one, other = drawn.near(places), learned.near(places)
    np.testing.assert_allclose(np.sort(one.distance), np.sort(other.distance))
