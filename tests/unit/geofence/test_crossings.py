"""Crossings: none missed, none twice, none made of jitter."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from services.geofence.borders import Borders
from services.geofence.crossings import Crossing, Crossings
from services.geofence.zone_index import ZoneIndex

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
GATE = [(10.0, -5.0), (10.05, -5.0), (10.05, 5.0), (10.0, 5.0)]
ELL = [(-6.0, -6.0), (-2.0, -6.0), (-2.0, -5.0), (-5.0, -5.0), (-5.0, -2.0), (-6.0, -2.0)]
MARGIN, MIN_SECONDS, GRACE, REACH = 0.3, 0.5, 2.0, 1.0


def make(margin: float = MARGIN, min_seconds: float = MIN_SECONDS, grace: float = GRACE) -> Crossings:
    index = ZoneIndex([SQUARE, GATE, ELL, SQUARE], ["ground", "ground", "ground", "upper"], REACH)
    return Crossings(Borders(index, margin, min_seconds), grace)


def walk(
    crossings: Crossings,
    path: np.ndarray,
    dt: float = 1 / 15,
    track: int = 1,
    start: float = 0.0,
    floor: int = 0,
    former: tuple[int, ...] = (),
    sigma: float = 0.0,
) -> list[Crossing]:
    happened, covariance = [], np.array([[sigma**2, 0.0, sigma**2]])
    for number, (x, y) in enumerate(path):
        happened += crossings.step(
            start + number * dt,
            np.array([track]),
            np.array([floor]),
            np.array([x]),
            np.array([y]),
            [list(former)],
            covariance=covariance,
        )
    return happened


def nobody(crossings: Crossings, t: float) -> list[Crossing]:
    none = np.empty(0)
    return crossings.step(t, none.astype(np.int64), none.astype(np.int64), none, none)


def line(start: tuple[float, float], end: tuple[float, float], steps: int) -> np.ndarray:
    return np.linspace(start, end, steps)


def kinds(happened: list[Crossing], border: int) -> list[str]:
    return [crossing.kind for crossing in happened if crossing.border == border]


def test_a_walk_through_a_zone_is_one_enter_and_one_exit_near_its_borders() -> None:
    crossings = make()
    happened = walk(crossings, line((-3, 2), (7, 2), 150))
    assert kinds(happened, 0) == ["enter", "exit"]
    assert kinds(happened, 3) == [], "the zone above is on another floor"
    assert -0.1 <= happened[0].x <= 0.4
    assert 4.2 <= happened[1].x <= 4.5
    assert crossings.occupancy.tolist() == [0, 0, 0, 0]


@given(
    angle=st.floats(-1.2, 1.2),
    speed=st.floats(0.3, 60.0),
    height=st.floats(-3.0, 3.0),
    phase=st.floats(0.0, 1.0),
    margin=st.sampled_from([0.0, 0.1, 0.3, 1.0]),
)
@settings(max_examples=40, deadline=None)
def test_no_thin_zone_is_stepped_over(angle: float, speed: float, height: float, phase: float, margin: float) -> None:
    """A gate of 5 cm is passed at any speed, angle and frame phase, however far one step goes."""
    dt = 1 / 15
    direction = np.array([np.cos(angle), np.sin(angle)])
    steps = int(np.ceil(3.0 / (speed * dt * direction[0]))) + 2
    offsets = (np.arange(-steps, steps + 1) + phase) * speed * dt
    path = np.array([10.02, height]) + offsets[:, None] * direction
    way = shapely.LineString(path[[0, -1]])
    gate = shapely.Polygon(GATE)
    crossings = make(margin=margin, min_seconds=0.5)
    happened = walk(crossings, path, dt) + crossings.close(1000.0)
    if way.intersects(gate):
        assert kinds(happened, 1) == ["enter", "exit"]
        enter, leave = (crossing for crossing in happened if crossing.border == 1)
        assert enter.t <= leave.t
    if way.distance(gate) > margin + 1e-6:
        assert kinds(happened, 1) == []


@given(seed=st.integers(0, 2**32 - 1), sigma=st.floats(0.0, 3.0), margin=st.sampled_from([0.0, 0.2, 0.5]))
@settings(max_examples=30, deadline=None)
def test_enter_and_exit_take_turns_for_every_track_and_zone(seed: int, sigma: float, margin: float) -> None:
    """Whatever ten people do, on two floors, vanishing and coming back: the turns hold and occupancy is their sum."""
    generator = np.random.default_rng(seed)
    crossings = make(margin=margin, min_seconds=0.2, grace=0.5)
    position = generator.uniform(-8, 12, (10, 2))
    floor = generator.integers(-1, 2, 10)
    happened: list[Crossing] = []
    for number in range(60):
        position = position + generator.normal(0.0, sigma, (10, 2))
        floor = np.where(generator.random(10) < 0.02, generator.integers(-1, 2, 10), floor)
        there = np.flatnonzero(generator.random(10) < 0.8)
        happened += crossings.step(number / 10, there, floor[there], position[there, 0], position[there, 1])
    happened += crossings.close(100.0)
    for track in range(10):
        for zone in range(4):
            mine = [c for c in happened if (c.track, c.border) == (track, zone)]
            expected = ["enter", "exit"] * (len(mine) // 2)
            assert [c.kind for c in mine] == expected
            assert [c.t for c in mine] == sorted(c.t for c in mine)
    assert crossings.occupancy.tolist() == [0, 0, 0, 0]
    assert len(crossings.tracks) == 0


@given(seed=st.integers(0, 2**32 - 1), depth=st.floats(-0.2, 0.2), sigma=st.floats(0.02, 0.3))
@settings(max_examples=12, deadline=None)
def test_jitter_on_the_edge_does_not_flap(seed: int, depth: float, sigma: float) -> None:
    generator = np.random.default_rng(seed)
    noise = generator.normal(0.0, sigma, (600, 2))
    happened = walk(make(), np.array([depth, 2.0]) + noise, sigma=sigma)
    assert kinds(happened, 0) in ([], ["enter"])


@pytest.mark.parametrize("is_line", [False, True])
def test_nobody_who_stands_beside_a_border_crosses_it_in_the_end(is_line: bool) -> None:
    """300 people 12 to 18 cm beside a border for half a minute, positions wrong by 0.3 m."""
    generator = np.random.default_rng(3)
    people, floor = np.arange(300), np.zeros(300, np.int64)
    course = [(0.0, -2.0), (0.0, 2.0)] if is_line else [(0.0, -3.0), (6.0, -3.0), (6.0, 3.0), (0.0, 3.0)]
    crossings = Crossings(Borders(ZoneIndex([course], ["floor"], 1.25, [is_line]), 0.25, 0.2), 2.0)
    standing = np.column_stack([-generator.uniform(0.12, 0.18, 300), generator.uniform(-1.0, 1.0, 300)])
    covariance, told = np.tile([0.09, 0.0, 0.09], (300, 1)), 0
    for number in range(450):
        x, y = (standing + generator.normal(0.0, 0.3, standing.shape)).T
        told += len(crossings.step(number / 15, people, floor, x.copy(), y.copy(), covariance=covariance))
    assert told == 0


def test_who_walks_through_a_narrow_gate_aslant_is_told_and_who_walks_round_it_is_not() -> None:
    """A gate of 20 cm by 4 m, 100 people each, at 20 degrees to it and round its end, wrong by 0.3 m."""
    generator = np.random.default_rng(5)
    count, floor = 100, np.zeros(200, np.int64)
    gate = [(-2.0, -0.1), (2.0, -0.1), (2.0, 0.1), (-2.0, 0.1)]
    crossings = Crossings(Borders(ZoneIndex([gate], ["floor"], 1.25), 0.25, 0.2), 2.0)
    covariance, told = np.tile([0.09, 0.0, 0.09], (2 * count, 1)), []
    offset = np.repeat([generator.uniform(-0.9, 0.9), 4.0], count)
    for number in range(120):
        gone = (number - 60) / 15 * 1.3
        place = np.column_stack([offset + gone * np.cos(0.35), np.full(2 * count, gone * np.sin(0.35))])
        x, y = (place + generator.normal(0.0, 0.3, place.shape)).T
        told += crossings.step(number / 15, np.arange(2 * count), floor, x.copy(), y.copy(), covariance=covariance)
    entered = [one.track for one in told if one.kind == "enter"]
    assert sorted(entered) == list(range(count))


def test_a_touch_from_outside_is_no_visit() -> None:
    out_and_back = np.concatenate([line((-2, 2), (0.02, 2), 30), line((0.02, 2), (-2, 2), 30)])
    assert walk(make(), out_and_back) == []


@given(
    x0=st.floats(-9, 9),
    y0=st.floats(-9, 9),
    x1=st.floats(-9, 9),
    y1=st.floats(-9, 9),
    steps=st.integers(2, 200),
)
@settings(max_examples=40, deadline=None)
def test_straight_walks_agree_with_the_geometry(x0: float, y0: float, x1: float, y1: float, steps: int) -> None:
    """With no margin and no waiting, the last state of a straight walk is what the polygon says of its end."""
    crossings = make(margin=0.0, min_seconds=0.0)
    happened = walk(crossings, line((x0, y0), (x1, y1), steps))
    way = shapely.LineString([(x0, y0), (x1, y1)])
    for zone, ring in enumerate([SQUARE, GATE, ELL]):
        polygon = shapely.Polygon(ring)
        if way.length == 0.0 or min(shapely.distance(polygon.exterior, shapely.points([x0, x1], [y0, y1]))) < 1e-6:
            continue
        assert bool(crossings.occupancy[zone]) == polygon.contains(shapely.Point(x1, y1))
        if shapely.length(way.intersection(polygon)) > 1e-6:
            assert kinds(happened, zone)
        elif not way.intersects(polygon):
            assert not kinds(happened, zone)


def test_a_track_that_vanishes_inside_leaves_after_the_grace_time() -> None:
    crossings = make()
    walk(crossings, line((2, 2), (2, 2), 2), dt=0.1)
    assert nobody(crossings, 0.1 + GRACE - 0.01) == []
    assert crossings.occupancy[0] == 1
    gone = nobody(crossings, 0.1 + GRACE + 0.01)
    assert [(c.kind, c.border, c.track, c.x) for c in gone] == [("exit", 0, 1, 2.0)]
    assert crossings.occupancy[0] == 0


def test_a_track_born_anew_with_a_former_id_does_not_enter_again() -> None:
    crossings = make()
    assert kinds(walk(crossings, line((-3, 2), (2, 2), 60)), 0) == ["enter"]
    assert walk(crossings, line((2.2, 2), (3, 2), 10), track=9, start=5.0, former=(1,)) == []
    left = walk(crossings, line((3, 2), (8, 2), 60), track=9, start=6.0, former=(1,))
    assert [(c.kind, c.track) for c in left if c.border == 0] == [("exit", 9)]


def test_a_gate_between_the_old_track_and_the_new_one_is_not_missed() -> None:
    crossings = make()
    walk(crossings, line((8, 0), (9, 0), 15))
    happened = walk(crossings, line((11, 0), (12, 0), 15), track=2, start=1.5, former=(1,))
    assert [(c.kind, c.track) for c in happened] == [("enter", 2), ("exit", 2)]


@pytest.mark.parametrize("first", [9.9, 9.0])
@pytest.mark.parametrize("last", [10.15, 11.0])
def test_a_gate_is_not_missed_by_a_track_born_or_lost_beside_it(first: float, last: float) -> None:
    crossings = make()
    happened = walk(crossings, line((first, 0), (last, 0), 12)) + crossings.close(100.0)
    assert kinds(happened, 1) == ["enter", "exit"]


def test_a_former_id_still_reported_keeps_its_own_state() -> None:
    crossings = make()
    step = crossings.step
    two = np.array([2.0, 2.0])
    step(0.0, np.array([1]), np.array([0]), two[:1], two[:1])
    happened = step(0.1, np.array([1, 2]), np.array([0, 0]), two, two, [[], [1]])
    assert [(c.kind, c.track) for c in happened] == [("enter", 2)]
    assert crossings.occupancy[0] == 2


def test_a_change_of_floor_is_an_exit_here_and_an_enter_there() -> None:
    crossings = make()
    walk(crossings, line((2, 2), (2, 2), 5))
    happened = walk(crossings, line((2, 2), (2, 2), 15), start=1.0, floor=1)
    assert [(c.kind, c.border) for c in happened] == [("enter", 3), ("exit", 0)]


def test_more_tracks_than_the_first_room_holds() -> None:
    crossings = make()
    count = 300
    ids = np.arange(count) * 7
    x = np.full(count, 2.0)
    happened = crossings.step(0.0, ids, np.zeros(count, np.int64), x, x)
    assert len(happened) == count
    assert crossings.occupancy[0] == count
    assert len(crossings.close(1.0)) == count


@given(x=st.lists(st.floats(-9, 12), min_size=1, max_size=40), seed=st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_the_grid_says_what_the_polygons_say(x: list[float], seed: int) -> None:
    rings, reach = [SQUARE, GATE, ELL, SQUARE], 0.7
    index = ZoneIndex(rings, ["ground", "ground", "ground", "upper"], reach)
    px = np.array(x)
    py = np.random.default_rng(seed).uniform(-9, 9, len(x))
    floor = np.random.default_rng(seed).integers(-1, 2, len(x))
    row, zone, depth, _ = index.nearby(px, py, floor)
    told = {(r, z): d for r, z, d in zip(row.tolist(), zone.tolist(), depth.tolist(), strict=True)}
    assert len(told) == len(row)
    for r in range(len(x)):
        for z, ring in enumerate(rings):
            polygon, point = shapely.Polygon(ring), shapely.Point(px[r], py[r])
            exact = polygon.exterior.distance(point) * (1 if polygon.intersects(point) else -1)
            if index.floor[z] != floor[r] or exact < -reach - 1.0:
                assert (r, z) not in told
            elif (r, z) not in told:
                assert exact < -reach
            elif told[r, z] == reach:
                assert exact >= reach - 1e-9
            else:
                assert told[r, z] == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("frames_per_s", [2, 7, 15, 30])
def test_a_person_is_told_within_a_second_at_any_frame_rate(frames_per_s: int) -> None:
    dt = 1 / frames_per_s
    path = line((-3, 2), (2, 2), int(5 / 1.3 * frames_per_s))
    crossings = make()
    for number, (x, y) in enumerate(path):
        if crossings.step(number * dt, np.array([1]), np.array([0]), np.array([x]), np.array([y])):
            assert x <= 1.3, "told later than a second after the border"
            return
    raise AssertionError("never told")


def held(crossings: Crossings, t: float, track: int, former: tuple[int, ...] = ()) -> list[Crossing]:
    crossings.hold(t, np.array([track]), [list(former)], np.empty(0, np.int64))
    return nobody(crossings, t)


def test_whose_place_is_not_known_stays_where_they_were_under_whatever_number() -> None:
    crossings = make()
    assert kinds(walk(crossings, line((-3, 2), (2, 2), 75)), 0) == ["enter"]
    for number in range(100):  # ten seconds, far longer than the grace
        assert held(crossings, 5.0 + number / 10, 7, former=(1,)) == []
    assert crossings.occupancy.tolist() == [1, 0, 0, 0]
    assert crossings.tracks.tolist() == [7]
    # Seen again on the far side of the gate: outside now, and nobody knows which way they went.
    happened = walk(crossings, line((12, 2), (12, 2), 20), track=7, start=15.0)
    assert [(one.kind, one.border) for one in happened] == [("exit", 0)]


def test_whose_place_was_never_known_is_nowhere() -> None:
    crossings = make()
    assert held(crossings, 0.0, 5) == []
    assert crossings.tracks.tolist() == []


def test_a_disc_is_clear_of_borders_or_not() -> None:
    index = ZoneIndex([SQUARE, ELL], ["ground", "ground"], MARGIN)
    x, y = np.array([2.0, 2.0, 3.0, 9.0, 2.0]), np.full(5, 2.0)
    floor, radius = np.array([0, 0, 0, 0, -1]), np.array([1.0, 2.0, 1.0, 4.0, 99.0])
    # In the middle, the middle of a wide disc, near an edge, well outside, on a floor without zones.
    assert index.clear_of_borders(x, y, floor, radius).tolist() == [True, False, False, True, True]


def test_somebody_found_to_be_two_numbers_leaves_once() -> None:
    crossings = make()
    walk(crossings, line((-3, 2), (2, 2), 75))
    # Out of view as 1, and a moment later somebody is born beside that place: 2. Is it the same person?
    assert [c.kind for c in walk(crossings, line((2, 3), (2, 3), 15), track=2, start=5.0)] == ["enter"]
    assert crossings.occupancy.tolist() == [2, 0, 0, 0]
    happened = walk(crossings, line((2, 3), (2, 3), 60), track=2, start=6.0, former=(1,))
    assert [(c.kind, c.track) for c in happened] == [("absorbed", 1)]
    assert crossings.occupancy.tolist() == [1, 0, 0, 0]
    assert crossings.tracks.tolist() == [2]
    assert [c.kind for c in walk(crossings, line((2, 3), (9, 3), 150), track=2, start=10.0, former=(1,))] == ["exit"]
    assert crossings.occupancy.tolist() == [0, 0, 0, 0]


def test_a_phone_nobody_sees_takes_nothing_from_whom_it_was_taken_for() -> None:
    crossings = make()
    assert kinds(walk(crossings, line((-3, 2), (2, 2), 75)), 0) == ["enter"]
    one, here = np.array([1]), np.array([2.0])
    for number in range(60):  # the person stands still; a phone that was thought theirs flickers under new numbers
        phone = np.array([10 + number // 10])
        crossings.hold(5.0 + number / 10, phone, [[1]], one)
        assert crossings.step(5.0 + number / 10, one, np.zeros(1, np.int64), here, here, [[]], phone) == []
    assert crossings.tracks.tolist() == [1]
    assert crossings.occupancy.tolist() == [1, 0, 0, 0]


def test_nobody_seen_takes_the_state_of_a_number_that_is_held() -> None:
    crossings = make()
    assert kinds(walk(crossings, line((-3, 2), (2, 2), 75)), 0) == ["enter"]
    held, new, far = np.array([1]), np.array([2]), np.array([30.0])
    for number in range(60):  # 1 is out of view in the zone; 2, once taken for 1, is seen far away
        t = 5.0 + number / 10
        crossings.hold(t, held, [[]], new)
        assert crossings.step(t, new, np.zeros(1, np.int64), far, far, [[1]], held) == []
    assert crossings.tracks.tolist() == [1, 2]
    assert crossings.occupancy.tolist() == [1, 0, 0, 0]
