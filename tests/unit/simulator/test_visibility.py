"""Who hides whom: the fast code against rays walked centimetre by centimetre, and noise that lasts across blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from services.simulator.cameras.merging import leaders, near_pairs
from services.simulator.cameras.visibility import BODY_RADIUS, StaticView, hidden_by_others, project_bodies
from services.simulator.cameras.wandering import Episodes, Wander
from shared.site import CameraGeometry, Floor
from shared.site.site_file import Obstacle

CAMERA = CameraGeometry.from_pose((960, 720), (5.0, -1.0, 4.0), (5.0, 5.0, 0.0), math.radians(80))
PLACE = st.tuples(st.floats(3.0, 7.0), st.floats(2.0, 8.0))


@given(PLACE, PLACE, st.floats(1.5, 1.9))
@settings(max_examples=60, deadline=None)
def test_a_body_hides_what_a_walked_ray_meets(
    first: tuple[float, float], second: tuple[float, float], tall: float
) -> None:
    assume(math.dist(first, second) > 0.5)
    places = np.array([[first, second]])
    talls = np.array([tall, 1.7])
    bodies = project_bodies(CAMERA, places, np.broadcast_to(talls, (1, 2)))
    pair = (np.array([0]), np.array([0]), np.array([1]))
    hidden = hidden_by_others(CAMERA.position, bodies, places, talls, *pair)
    reach = np.linalg.norm(places[0] - CAMERA.position[:2], axis=1)
    assume(abs(reach[0] - reach[1]) > 1e-6)  # of two equally near neither is before the other
    near, far = int(np.argmin(reach)), int(np.argmax(reach))
    assert not hidden[0, near].any()
    for share, by in zip(bodies.points[0, far], hidden[0, far], strict=True):
        ray = CAMERA.position + np.linspace(0.0, 1.0, 4000)[:, None] * (share - CAMERA.position)
        off = np.linalg.norm(ray[:, :2] - places[0, near], axis=1)
        # Rays that graze the body may go either way.
        wide, narrow = ((off < BODY_RADIUS + d) & (ray[:, 2] < talls[near] + d) for d in (0.02, -0.02))
        if not wide.any():
            assert not by
        elif narrow[:-200].any():
            assert by


def test_an_obstacle_hides_what_the_ray_meets_below_its_top() -> None:
    block = shapely.box(4.0, 3.0, 6.0, 4.0)
    floor = Floor(
        id="f",
        outline=[(0, 0), (10, 0), (10, 10), (0, 10)],
        obstacles=[Obstacle(id="b", polygon=[(4, 3), (6, 3), (6, 4), (4, 4)])],
    )
    view = StaticView(CAMERA, floor, 1.2, 3.0)
    rng = np.random.default_rng(1)
    places = rng.uniform([1.0, 1.0], [9.0, 9.0], (200, 2))
    places = places[~shapely.contains_xy(block.buffer(0.4), places[:, 0], places[:, 1])]
    bodies = project_bodies(CAMERA, places, np.full(len(places), 1.7))
    hidden = view.hidden(places)
    agree = []
    for body, found, inside in zip(bodies.points, hidden, bodies.inside, strict=True):
        for point, by in zip(body[inside], found[inside], strict=True):
            ray = CAMERA.position + np.linspace(0.0, 1.0, 500)[:, None] * (point - CAMERA.position)
            low = ray[:, 2] < 1.2
            agree.append(bool(shapely.contains_xy(block, ray[low, 0], ray[low, 1]).any()) == by)
    assert np.mean(agree) > 0.97
    assert hidden.any()


def test_pairs_are_those_whose_boxes_touch() -> None:
    rng = np.random.default_rng(2)
    low = rng.uniform(0, 10, (5, 7, 2))
    box = np.concatenate([low, low + rng.uniform(0.5, 3, (5, 7, 2))], axis=2)
    active = rng.random((5, 7)) < 0.8
    expected = {
        (f, i, j)
        for f in range(5)
        for i in range(7)
        for j in range(i + 1, 7)
        if active[f, i] and active[f, j] and shapely.box(*box[f, i]).intersects(shapely.box(*box[f, j]))
    }
    assert set(zip(*(part.tolist() for part in near_pairs(box, active)), strict=True)) == expected


def test_who_is_lost_in_somebody_absorbs_nobody() -> None:
    frame, one, other = np.array([0, 0, 0]), np.array([0, 1, 2]), np.array([1, 2, 3])
    distance = np.array([[1.0, 2.0, 3.0, 4.0]])
    _, lost, kept = leaders((1, 4), frame, one, other, np.array([0.1, 0.3, 0.2]), distance)
    assert list(zip(lost.tolist(), kept.tolist(), strict=True)) == [(1, 0), (3, 2)]


@pytest.mark.parametrize("interval", [1 / 30, 0.5])
def test_wandering_noise_has_unit_variance_and_its_time_constant_across_blocks(interval: float) -> None:
    wander = Wander(2.0, interval, 0.8, np.random.default_rng(3))
    keys = list(range(400))
    path = np.concatenate([wander.next(keys, 7) for _ in range(20)])
    assert path.std() == pytest.approx(1.0, abs=0.05)
    for lag in (1, 6, 7, 12):
        together = float(np.mean(path[lag:] * path[:-lag]))
        assert together == pytest.approx(0.8 * math.exp(-lag * interval / 2.0), abs=0.06)


def test_episodes_begin_and_last_as_asked_across_blocks() -> None:
    episodes = Episodes(0.5, 2.0, 0.1, np.random.default_rng(4))
    state = np.concatenate([episodes.next(list(range(50)), 13) for _ in range(100)])
    assert state.mean() == pytest.approx(0.5 * 2.0 / (1.0 + 0.5 * 2.0), abs=0.04)
    ends = np.count_nonzero(state[:-1] & ~state[1:])
    assert state.sum() * 0.1 / ends == pytest.approx(2.0, rel=0.1)
