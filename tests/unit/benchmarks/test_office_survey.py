"""The office's survey: where it stands, which ways it faces, and that the figures made of it can tell good from bad."""

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.baselines.survey import Survey
from benchmarks.office import static_rmse, walking_errors
from benchmarks.office_survey import CORRIDORS, SPACING, Surveyor, reference_points
from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import load
from services.simulator.radio.radio_world import RadioWorld
from shared.messages import RadioScan


@pytest.fixture(scope="module")
def office():
    return load("office")


@pytest.fixture(scope="module")
def radio(office):
    scenario, site = office
    few = site.model_copy(update={"access_points": site.access_points[:6]})
    return RadioWorld(few, 3, scenario.radio), few


def test_points_stand_on_the_office_s_floor_at_their_spacing_and_leave_no_part_of_it_far_from_one(office):
    _, site = office
    plan = site.floors[0].plan()
    points = reference_points()
    assert plan.walkable(points.position).all()
    tree = cKDTree(points.position)
    nearest = tree.query(points.position, k=2)[0][:, 1]
    assert (nearest > 0.8 * SPACING).all()
    west, south, east, north = plan.outline.bounds
    grid = np.array(list(itertools.product(np.arange(west, east, 0.25), np.arange(south, north, 0.25))))
    grid = grid[plan.walkable(grid)]
    assert tree.query(grid)[0].max() < 2.2


def test_corridor_points_face_both_ways_along_and_open_space_points_four(office):
    points = reference_points()
    ways = [len(ways) for ways in points.facing]
    assert ways == sorted(ways)
    assert set(ways) == {2, 4}
    first = np.array(CORRIDORS[0][1]) - np.array(CORRIDORS[0][0])
    along = first / np.hypot(*first)
    np.testing.assert_allclose([np.cos(way) * along[0] + np.sin(way) * along[1] for way in points.facing[0]], [1, -1])


def test_every_scan_of_a_survey_is_taken_and_each_way_is_a_round_of_its_own(radio):
    world, site = radio
    asked = []

    class Listening(RadioWorld):
        def __init__(self):
            self.access_points = world.access_points

        def phone(self, device):
            return self

        def scan(self, t, points, floor, heading):
            asked.append((t[0], len(t), tuple(points[0]), heading[0]))
            return np.full((len(t), len(self.access_points)), -float(len(asked)))

    points = reference_points()
    survey = Surveyor(Listening(), site, points).survey(10)
    assert np.isfinite(survey.readings).all()
    assert (np.diff([t for t, *_ in asked]) > 0).all()
    open_space = points.position[-1]
    assert [count for _, count, place, _ in asked if place == tuple(open_space)] == [3, 3, 2, 2]
    corridor = [(t, count, way) for t, count, place, way in asked if place == tuple(points.position[0])]
    assert [count for _, count, _ in corridor] == [5, 5]
    assert corridor[1][0] - corridor[0][0] > 60.0 * 5
    assert np.cos(corridor[1][2] - corridor[0][2]) == pytest.approx(-1.0)


def test_a_larger_survey_is_less_error_and_a_test_visit_that_heard_something_else_is_more():
    rng = np.random.default_rng(5)
    place = reference_points().position
    level = rng.normal(-70.0, 4.0, (len(place), 1, 30))
    names = [f"ap-{n}" for n in range(30)]
    pool, tested, later = (
        Survey(names, place, np.round(level + shift + rng.normal(0.0, 4.0, (len(place), samples, 30))))
        for samples, shift in ((50, 0.0), (20, 0.0), (20, rng.normal(0.0, 6.0, 30)))
    )

    def rmse(visit, samples):
        return static_rmse(pool, visit, samples, np.random.default_rng(0), draws=3)

    assert rmse(tested, 50) < 0.8 * rmse(tested, 10)
    assert rmse(tested, 50) < 0.8 * rmse(later, 50)


def test_walking_errors_are_taken_at_the_time_of_the_scan_and_only_of_who_walks(radio):
    _, site = radio
    t = np.arange(0.0, 20.0, 0.2)
    walker = np.column_stack([np.minimum(t, 10.0), np.zeros(len(t))])  # ten metres, then stands
    position = np.stack([walker, np.full((len(t), 2), 50.0)], axis=1)
    truth = Truth(t, ["a", "b"], ["phone", None], position, np.ones((len(t), 2), bool))
    # Two points ten metres apart whose readings leave no doubt.
    names = [f"ap-{n}" for n in range(40)]
    readings = np.stack([np.full((10, 40), -90.0), np.full((10, 40), -50.0)])
    survey = Survey(names, np.array([[0.0, 0.0], [10.0, 0.0]]), readings)
    scans = [RadioScan(t=at, device="phone", seq=0, access_point=names, rssi=[-50.0] * 40) for at in (4.1, 7.1, 15.0)]
    record = WorldRecord(site, "floor", [], [], {"phone": scans}, {}, truth, np.zeros((4, 2)))
    np.testing.assert_allclose(walking_errors(record, survey, 4), [5.9, 2.9], atol=1e-6)
