"""The parts of the radio world, each by itself: shadowing, walls in between, fading, scan schedules."""

import itertools
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from services.simulator.radio.radio_fading import Fading, rice_mean
from services.simulator.radio.scan_schedule import (
    AdvertScans,
    RegularScans,
    ScanSchedule,
    ScanTimes,
    ThrottledScans,
    reports,
)
from services.simulator.radio.shadowing import Lattice, ShadowingField, TabulatedFields
from services.simulator.radio.wall_loss import Barriers, LinkLoss, crossings
from shared.site import FloorPlan


def test_shadowing_has_the_stated_spread_and_correlation_length() -> None:
    rng = np.random.default_rng(1)
    start = rng.uniform(-200, 200, (1500, 2))
    angle = rng.uniform(0, 2 * np.pi, 1500)
    fields = [ShadowingField(np.random.default_rng(index), 4.0, 3.0) for index in range(20)]
    here = np.concatenate([field.at(start) for field in fields])
    assert here.std() == pytest.approx(4.0, abs=0.25)
    for distance in (1.0, 3.0, 6.0):
        shifted = start + distance * np.column_stack([np.cos(angle), np.sin(angle)])
        there = np.concatenate([field.at(shifted) for field in fields])
        assert np.corrcoef(here, there)[0, 1] == pytest.approx(np.exp(-distance / 3.0), abs=0.06)


def test_the_tabulated_field_is_the_field() -> None:
    field = ShadowingField(np.random.default_rng(1), 4.0, 3.0)
    lattice = Lattice(np.array([-3.0, 2.0]), np.array([9.0, 7.0]), 0.1)
    points = np.array([(x, y) for x in lattice.x for y in lattice.y])
    np.testing.assert_allclose(field.over(lattice).ravel(), field.at(points), atol=1e-3)
    np.testing.assert_allclose(TabulatedFields([field], lattice).at(points)[:, 0], field.at(points), atol=0.02)
    between = np.random.default_rng(2).uniform([-3, 2], [9, 7], (2000, 2))
    difference = TabulatedFields([field], lattice).at(between)[:, 0] - field.at(between)
    assert difference.std() < 0.2 * 4.0


def test_a_huge_floor_gets_a_coarser_lattice_and_who_is_outside_hears_the_edge() -> None:
    lattice = Lattice(np.zeros(2), np.array([3000.0, 2000.0]), 0.1)
    assert len(lattice.x) * len(lattice.y) < 130_000
    cell, part = lattice.cells(np.array([[-50.0, 5000.0]]))
    assert cell[0, 0] == 0
    assert cell[0, 1] == len(lattice.y) - 2
    assert part.tolist() == [[0.0, 1.0]]


@given(
    st.lists(st.tuples(*[st.floats(0, 20)] * 4), min_size=1, max_size=6),
    st.lists(st.tuples(st.floats(0, 20), st.floats(0, 20)), min_size=1, max_size=8),
    st.tuples(st.floats(0, 20), st.floats(0, 20)),
)
@settings(max_examples=200, deadline=None)
def test_crossings_agree_with_shapely(walls: list[Any], places: list[Any], source: Any) -> None:
    segments = np.array(walls).reshape(-1, 2, 2)
    points = np.array(places)
    found = crossings(points, np.array(source), segments)
    for i, place in enumerate(places):
        link = shapely.LineString([place, source])
        for j, segment in enumerate(segments):
            wall = shapely.LineString(segment)
            ends = [shapely.Point(end) for end in (place, source, *map(tuple, segment))]
            if (
                min(ends[0].distance(wall), ends[1].distance(wall), ends[2].distance(link), ends[3].distance(link))
                < 1e-6
            ):
                continue  # touching is a matter of taste
            assert found[i, j] == link.crosses(wall)


def test_a_line_through_a_corner_of_a_wall_crosses_it_once() -> None:
    wall = Barriers([([[5.0, 0.0], [5.0, 5.0], [5.0, 10.0]], 3.0)])
    assert wall.between(np.array([[8.0, 5.0]]), np.array([2.0, 5.0])).tolist() == [3.0]


def test_a_room_costs_two_walls_to_look_through_and_an_obstacle_its_loss() -> None:
    room = [(4.0, 4.0), (6.0, 4.0), (6.0, 6.0), (4.0, 6.0), (4.0, 4.0)]
    outline = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
    through = np.array([[9.0, 5.1]]), np.array([1.0, 5.0])
    assert Barriers.of(FloorPlan.build(outline, [room]), 3.0, 1.0).between(*through).tolist() == [6.0]
    assert Barriers.of(FloorPlan.build(outline, [], [room[:4]]), 3.0, 1.0).between(*through).tolist() == [1.0]
    assert Barriers.of(FloorPlan.build(outline), 3.0, 1.0).between(*through).tolist() == [0.0]


def test_loss_by_cells_is_the_loss_of_the_line_but_for_the_edges_of_shadows() -> None:
    barriers = Barriers([([[5.0, 0.0], [5.0, 6.0]], 3.0), ([[8.0, 2.0], [12.0, 9.0]], 5.0)])
    source = np.array([1.0, 1.0])
    points = np.random.default_rng(1).uniform(0, 15, (4000, 2))
    loss = LinkLoss(barriers, source[None], Lattice(np.zeros(2), np.full(2, 15.0), 0.2))
    same = loss.at(points)[:, 0] == barriers.between(points, source)
    assert same.mean() > 0.97
    np.testing.assert_array_equal(loss.at(points), loss.at(points))


def fading(factor: float, hops: bool, links: int = 40, **more: float) -> Fading:
    chosen = {"length": 0.2, "time": 60.0, "flicker_sigma": 0.0, "flicker_time": 5.0, **more}
    return Fading(np.random.default_rng(3), np.full(links, factor), np.full(links, hops), **chosen)


@pytest.mark.parametrize("factor", [0.0, 1.2, 2.5, 20.0])
def test_fading_has_mean_zero_and_deep_fades(factor: float) -> None:
    there = np.zeros((500, 2))
    there[:, 0] = np.arange(500)
    faded = fading(factor, False).along(np.arange(500.0), there, np.zeros(500, np.int64))
    assert faded.mean() == pytest.approx(0.0, abs=0.12)
    skew = ((faded - faded.mean()) ** 3).mean() / faded.std() ** 3
    assert skew < -0.2
    assert rice_mean(factor) <= 0.0


def test_fading_stays_while_the_phone_stands_and_goes_within_decimetres() -> None:
    t = np.arange(0.0, 100.0, 0.5)
    still = np.zeros((200, 2))
    moving = np.column_stack([0.1 * np.arange(200), np.zeros(200)])
    floor = np.zeros(200, np.int64)

    def kept(points: np.ndarray, lag: int) -> float:
        faded = fading(2.5, False, 400).along(t, points, floor)
        return float(np.corrcoef(faded[lag:].ravel(), faded[:-lag].ravel())[0, 1])

    assert kept(still, 2) > 0.9
    assert 0.3 < kept(moving, 1) < 0.7
    assert abs(kept(moving, 8)) < 0.06


def test_a_beacon_hops_between_three_channels_where_an_access_point_stays_on_one() -> None:
    t, here, floor = np.arange(0.0, 20.0, 0.1), np.zeros((200, 2)), np.zeros(200, np.int64)
    hopping, steady = (fading(1.2, hops, 200, time=1e6).along(t, here, floor) for hops in (True, False))
    assert np.sqrt(steady.var(axis=0).mean()) < 0.3
    assert np.sqrt(hopping.var(axis=0).mean()) > 2.5


def test_flicker_has_the_stated_spread_and_time() -> None:
    t, here, floor = np.arange(0.0, 2000.0, 1.0), np.zeros((2000, 2)), np.zeros(2000, np.int64)
    air = fading(1e9, False, 40, flicker_sigma=0.8, flicker_time=4.0, time=1e9).along(t, here, floor)
    assert air.std() == pytest.approx(0.8, rel=0.05)
    assert np.corrcoef(air[4:].ravel(), air[:-4].ravel())[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


SCHEDULES: list[Any] = [
    RegularScans(every=1.0),
    RegularScans(every=0.1, jitter=0.45),
    ThrottledScans(kind="throttled"),
    AdvertScans(kind="adverts", rate=7.0, window=1.0),
]


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda schedule: schedule.kind)
@given(cuts=st.lists(st.floats(0.0, 600.0), max_size=8), seed=st.integers(0, 50))
@settings(max_examples=30, deadline=None)
def test_scan_times_do_not_depend_on_how_time_is_cut(schedule: Any, cuts: list[float], seed: int) -> None:
    borders = [0.0, *sorted(cuts), 600.0]
    scans = ScanTimes(schedule, np.random.default_rng(seed))
    whole = scans.times(0.0, 600.0)
    parts = np.concatenate([scans.times(a, b) for a, b in itertools.pairwise(borders)])
    np.testing.assert_array_equal(whole, parts)
    assert (np.diff(whole) > 0).all()


@pytest.mark.parametrize(("schedule", "a_second"), [*zip(SCHEDULES, (1.0, 10.0, 4 / 120, 7.0), strict=True)])
def test_schedules_scan_as_often_as_they_say(schedule: Any, a_second: float) -> None:
    assert len(ScanTimes(schedule, np.random.default_rng(1)).times(0.0, 6000.0)) == pytest.approx(
        6000.0 * a_second, rel=0.01
    )


def test_android_scans_four_times_in_any_two_minutes_and_then_waits() -> None:
    times = ScanTimes(ThrottledScans(kind="throttled", jitter=0.0), np.random.default_rng(1)).times(0.0, 3000.0)
    for start in np.arange(0.0, 2880.0, 7.3):
        assert ((times >= start) & (times < start + 120.0 - 1e-6)).sum() <= 4
    assert np.diff(times).max() > 100.0


def test_two_phones_do_not_scan_in_step() -> None:
    first, second = (ScanTimes(RegularScans(), np.random.default_rng(seed)).times(0.0, 10.0) for seed in (1, 2))
    assert abs((first[0] - second[0]) % 1.0) > 0.01


def test_adverts_are_reported_by_windows_and_other_scans_as_they_are() -> None:
    t = np.array([0.1, 0.5, 0.9, 1.2, 1.8])
    readings = np.array([[-60.0, np.nan], [-70.0, np.nan], [-65.0, -80.0], [-50.0, np.nan], [np.nan, np.nan]])
    when, told = reports(AdvertScans(kind="adverts", rate=5.0, window=1.0), t, readings)
    assert when.tolist() == [0.9, 1.8]
    np.testing.assert_array_equal(told, [[-65.0, -80.0], [-50.0, np.nan]])
    same_t, same = reports(RegularScans(), t, readings)
    assert same is readings
    assert same_t is t


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        ({"kind": "regular", "every": 0.0}, "every"),
        ({"kind": "regular", "every": -1.0}, "every"),
        ({"kind": "throttled", "burst": 40}, "40 scans of 4 s take longer"),
        ({"kind": "adverts", "rate": 0.5, "window": 1.0}, "holds no advert"),
        ({"kind": "sometimes"}, "kind"),
    ],
)
def test_schedules_that_cannot_be_kept_are_refused(mistake: dict[str, Any], words: str) -> None:
    adapter: TypeAdapter[Any] = TypeAdapter(ScanSchedule)
    with pytest.raises(ValidationError, match=words):
        adapter.validate_python(mistake)
