"""Walkers look like people: they go round things, keep apart, turn smoothly, come and go; and the seed decides all."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from services.simulator.routes import BODY, Routes
from services.simulator.walkers import Walkers
from shared.site import FloorPlan, load_site


@pytest.fixture(scope="module")
def plan() -> FloorPlan:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml").floor("ground").plan()


@pytest.fixture(scope="module")
def walk(plan: FloorPlan) -> np.ndarray:
    """Six minutes of eight visitors: (steps, people, [x, y, heading, speed, present])."""
    people = Walkers(plan, 8, seed=4)
    rows = []
    for t in np.arange(0.0, 360.0, 0.1):
        motions = [people.motion(person, np.array([t])) for person in people.persons]
        rows.append([[*m.position[0], m.heading[0], m.speed[0], m.present[0]] for m in motions])
    return np.array(rows, float)


def test_nobody_walks_through_exhibits_or_walls(plan: FloorPlan, walk: np.ndarray) -> None:
    places = walk[..., :2].reshape(-1, 2)
    points = shapely.points(places)
    assert shapely.distance(plan.obstacles, points).min() > BODY - 0.05
    assert shapely.distance(plan.walls, points).min() > BODY - 0.05
    start, end = walk[:-1, :, :2].reshape(-1, 2), walk[1:, :, :2].reshape(-1, 2)
    assert not plan.walls_crossed(start, end).any()


def test_people_keep_apart(walk: np.ndarray) -> None:
    away = walk[:, :, None, :2] - walk[:, None, :, :2]
    distance = np.hypot(away[..., 0], away[..., 1]) + np.eye(walk.shape[1]) * 9
    assert distance.min() > 0.4


def test_people_walk_at_walking_speed_and_turn_smoothly(walk: np.ndarray) -> None:
    speed = walk[..., 3]
    walking = speed[speed > 0.3]
    assert 0.5 < np.median(walking) < 1.3
    assert np.quantile(speed, 0.999) < 1.6
    turning = np.abs(np.diff(walk[..., 2], axis=0)) / 0.1
    assert turning.max() < 4.0


def test_visitors_come_stay_at_several_exhibits_leave_and_come_back(walk: np.ndarray) -> None:
    present = walk[..., 4] > 0.5
    assert present[600:].sum(axis=1).mean() > 4
    arrivals = (np.diff(present.astype(int), axis=0) == 1).sum(axis=0)
    assert (arrivals >= 1).all()
    assert arrivals.sum() > len(arrivals)
    standing = (walk[..., 3] < 0.2) & present
    assert 0.15 < standing.sum() / present.sum() < 0.75


def test_same_seed_walks_the_same_way_however_time_is_asked_for(plan: FloorPlan) -> None:
    often, once = Walkers(plan, 4, seed=9), Walkers(plan, 4, seed=9)
    for t in np.arange(0.0, 30.0, 0.037):
        often.snapshot(float(t))
    first, second = often.snapshot(30.0), once.snapshot(30.0)
    assert first.position.tobytes() == second.position.tobytes()
    assert first.heading.tobytes() == second.heading.tobytes()
    assert Walkers(plan, 4, seed=10).snapshot(30.0).position.tobytes() != first.position.tobytes()


def test_a_path_leads_round_an_obstacle() -> None:
    plan = FloorPlan.build([(0, 0), (10, 0), (10, 10), (0, 10)], obstacles=[[(4, 2), (6, 2), (6, 8), (4, 8)]])
    path = Routes(plan).path(np.array([1.0, 5.0]), np.array([9.0, 5.0]))
    line = shapely.LineString([[1.0, 5.0], *path])
    assert len(path) > 1
    assert line.distance(plan.obstacles) > 0.3
    assert line.length < 13.0


def test_a_hall_without_a_door_is_refused() -> None:
    ring = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)]
    with pytest.raises(ValueError, match="walled all round"):
        Routes(FloorPlan.build(ring, walls=[[*ring, ring[0]]]))
