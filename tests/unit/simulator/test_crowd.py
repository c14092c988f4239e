"""Crowds look like people: they go round things, keep apart, come and go, walk in groups; and the seed decides all."""

import hashlib
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import shapely
from pydantic import ValidationError

from services.simulator.crowd.crowd import STEP, Crowd, Door, WalkerParameters
from services.simulator.crowd.trajectories import Trajectories
from services.simulator.crowd.walking_speeds import walking_speeds
from services.simulator.people import Movement
from shared.site import FloorPlan, load_site

ROOT = Path(__file__).resolve().parents[3]


def box(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    return [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]


EXHIBITS = [
    box(2.5, 3, 1.2, 1.2),
    box(7, 4.5, 1.6, 1),
    box(11.5, 3, 1.2, 1.2),
    box(3, 8, 1, 2),
    box(10.5, 8.5, 1.5, 1.5),
    box(6, 12.5, 2.5, 1),
]
WALLS = [[(0.0, 0.0), (6.0, 0.0)], [(9.0, 0.0), (15.0, 0.0), (15.0, 16.0), (0.0, 16.0), (0.0, 0.0)]]
MUSEUM = FloorPlan.build(box(0, 0, 15, 16), WALLS, EXHIBITS)
VISITORS = WalkerParameters(pool=40, present=(8, 20), carriers=4, speed=(0.5, 1.2), dwell=(2.0, 45.0))
SITE = FloorPlan.build(box(0, 0, 18, 14), [], [box(3, 3, 2, 1), box(9, 6, 1.5, 3), box(14, 10, 2, 1.5)])
WORKERS = WalkerParameters(
    behaviour="workers", pool=15, present=(5, 12), carriers=5, speed=(0.5, 1.1), dwell=(15.0, 240.0), visit=(300, 1800)
)


@dataclass(frozen=True)
class Walk:
    plan: FloorPlan
    parameters: WalkerParameters
    moved: Movement


def walked(people: Crowd, end: float, step: float = STEP) -> Movement:
    """Ask block after block, as the world does, and join what was answered."""
    starts = np.arange(0.0, end, 5.0)
    blocks = [people.movement(start + step * np.arange(round(5.0 / step))) for start in starts]
    return Movement(
        *(
            np.concatenate([getattr(block, name) for block in blocks])
            for name in ("position", "heading", "speed", "walked", "floor", "present")
        )
    )


def hall() -> FloorPlan:
    return load_site(ROOT / "deploy/sites/hall/site.yaml").floor("ground").plan()


@pytest.fixture(scope="module", params=["museum", "works", "hall"])
def walk(request: pytest.FixtureRequest) -> Walk:
    """Seven minutes of three places."""
    plan, parameters = {
        "museum": (MUSEUM, VISITORS),
        "works": (SITE, WORKERS),
        "hall": (hall(), WalkerParameters(pool=10, present=(5, 8), carriers=3)),
    }[request.param]
    return Walk(plan, parameters, walked(Crowd({"f": plan}, parameters, seed=4), 420.0))


def velocities(moved: Movement, step: float = STEP) -> np.ndarray:
    both = moved.known[1:] & moved.known[:-1] & (moved.floor[1:] == moved.floor[:-1])
    return np.where(both[..., None], np.diff(moved.position, axis=0) / step, np.nan)


def test_whoever_is_present_is_inside_and_out_of_obstacles_and_walls(walk: Walk) -> None:
    places = walk.moved.position[walk.moved.present]
    assert walk.plan.contains(places).all()
    points = shapely.points(places)
    assert shapely.distance(walk.plan.obstacles, points).min() > 0.1
    if not walk.plan.walls.is_empty:
        assert shapely.distance(walk.plan.walls, points).min() > 0.1


def test_nobody_jumps(walk: Walk) -> None:
    velocity = velocities(walk.moved)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    assert np.nanmax(speed) < 3.0
    acceleration = np.diff(velocity, axis=0) / STEP
    assert np.nanquantile(np.hypot(acceleration[..., 0], acceleration[..., 1]), 0.999) < 6.0
    turning = np.abs(np.diff(walk.moved.heading, axis=0)) / STEP
    assert np.nanmax(turning) < 4.0


def test_people_keep_apart(walk: Walk) -> None:
    position = np.where(walk.moved.present[..., None], walk.moved.position, np.nan)
    away = position[:, :, None] - position[:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    distance[:, np.eye(distance.shape[1], dtype=bool)] = np.nan
    assert (distance < 0.3).sum() <= 1e-4 * np.isfinite(distance).sum()
    assert np.nanmin(distance) > 0.2


def test_the_number_of_people_stays_in_its_range_from_the_first_moment(walk: Walk) -> None:
    present = walk.moved.present.sum(axis=1)
    low, high = walk.parameters.present
    assert low <= present.min()
    assert present.max() <= high
    assert present.max() > present.min()


def test_carriers_are_inside_most_of_the_time_and_others_come_and_go(walk: Walk) -> None:
    carriers = walk.parameters.carriers
    about = walk.moved.present.mean(axis=0)
    assert about[:carriers].mean() > 0.75
    ever = walk.moved.present.any(axis=0)
    assert ever.sum() > walk.moved.present[0].sum()


def test_nobody_walks_at_constant_velocity(walk: Walk) -> None:
    """A tracker that predicts one second ahead by velocity alone errs by tens of centimetres."""
    position, ahead = walk.moved.position, 10
    predicted = position[ahead:-ahead] + (position[ahead:-ahead] - position[: -2 * ahead])
    error = np.hypot(*np.moveaxis(position[2 * ahead :] - predicted, -1, 0))
    moving = walk.moved.speed[ahead:-ahead] > 0.4
    wrong = np.sqrt(np.nanmean(error[moving] ** 2))
    assert 0.15 < wrong < 0.7


def test_standing_people_shift_their_weight_and_look_round(walk: Walk) -> None:
    still = (walk.moved.speed < 0.05) & walk.moved.present
    run = still[:-50] & still[50:] & still[25:-25]
    drift = np.hypot(*np.moveaxis(walk.moved.position[50:] - walk.moved.position[:-50], -1, 0))[run]
    assert 0.01 < np.median(drift) < 0.12
    turned = np.abs(walk.moved.heading[50:] - walk.moved.heading[:-50])[run]
    assert np.median(turned) > 0.02


def test_nobody_gets_stuck(walk: Walk) -> None:
    """Whoever is inside for seven minutes has walked; nobody stands before one place longer than a long dwell."""
    moved, present = walk.moved, walk.moved.present
    for person in np.flatnonzero(present.mean(axis=0) > 0.9):
        length = np.nanmax(moved.walked[:, person]) - np.nanmin(moved.walked[:, person])
        assert length > (15.0 if walk.parameters.behaviour == "workers" else 60.0)


@pytest.fixture(scope="module")
def museum() -> Walk:
    return Walk(MUSEUM, VISITORS, walked(Crowd({"f": MUSEUM}, VISITORS, seed=11), 400.0))


def test_visitors_look_at_every_exhibit_and_cross_the_middle(museum: Walk) -> None:
    still = museum.moved.present & (museum.moved.speed < 0.1)
    places = shapely.points(museum.moved.position[still])
    for exhibit in museum.plan.obstacles.geoms:
        share = (shapely.distance(exhibit, places) < 1.2).mean()
        assert 0.03 < share < 0.4
    crossing = museum.moved.position[museum.moved.present & (museum.moved.speed > 0.4)]
    assert (np.hypot(*(crossing - [7.5, 8.0]).T) < 1.5).sum() > 200


def test_visitors_face_the_exhibit_they_stand_at(museum: Walk) -> None:
    moved = museum.moved
    settled = moved.present & (moved.speed < 0.05)
    settled[30:] &= settled[:-30]
    settled[:30] = False
    where, facing = moved.position[settled], moved.heading[settled]
    lines = shapely.shortest_line(shapely.points(where), museum.plan.obstacles)
    ends = shapely.get_coordinates(lines).reshape(-1, 2, 2)[:, 1]
    near = np.hypot(*(ends - where).T) < 1.1
    towards = np.arctan2(*(ends - where)[near].T[::-1])
    off = np.abs(np.angle(np.exp(1j * (facing[near] - towards))))
    assert np.median(off) < 0.5
    assert (off > 0.15).mean() > 0.2  # and not like soldiers


def test_workers_stand_long_and_take_unequal_steps() -> None:
    moved = walked(Crowd({"f": SITE}, WORKERS, seed=5), 400.0)
    still = (moved.speed < 0.1)[moved.present].mean()
    assert still > 0.6
    walking = moved.present & (moved.speed > 0.35)
    both = walking[6:] & walking[:-6]
    change = (moved.speed[6:] - moved.speed[:-6])[both]
    even = walked(Crowd({"f": SITE}, workers_as("visitors"), seed=5), 200.0)
    walking = even.present & (even.speed > 0.35)
    both = walking[6:] & walking[:-6]
    assert change.std() > 1.15 * (even.speed[6:] - even.speed[:-6])[both].std()


def workers_as(behaviour: str) -> WalkerParameters:
    return WalkerParameters.model_validate({**WORKERS.model_dump(), "behaviour": behaviour})


def test_groups_come_together_stay_together_and_part() -> None:
    parameters = WalkerParameters(
        pool=30, present=(2, 12), groups=1.0, group_size=(3, 3), split=0.15, visit=(60.0, 200.0), away=(10.0, 30.0)
    )
    people = Crowd({"f": MUSEUM}, parameters, seed=3)
    together: list[float] = []
    strangers: list[float] = []
    formed: dict[tuple[int, int], float] = {}
    parted = []
    for t in np.arange(0.0, 400.0, 0.5):
        now, groups = people.movement(np.array([t])), people.groups()
        companions = {(a, b) for group in groups for a in group for b in group if a < b}
        inside = np.flatnonzero(now.present[0]).tolist()
        for a in inside:
            for b in inside:
                if a < b:
                    away = float(np.hypot(*(now.position[0, a] - now.position[0, b])))
                    (together if (a, b) in companions else strangers).append(away)
        for pair in companions:
            formed.setdefault(pair, t)
        parted += [pair for pair in formed if pair not in companions and set(pair) <= set(inside)]
    assert any(start > 60.0 for start in formed.values())  # new ones come
    assert np.median(together) < 1.5
    assert np.quantile(together, 0.95) < 3.5
    assert np.median(strangers) > 4.0
    assert len(set(parted)) >= 3  # and some part while both go on


STAIRS = [
    Door(id="street", floor="low", position=(0, 5), width=2.0),
    Door(id="up", floor="low", position=(9, 9), leads_to="head", seconds=12.0),
    Door(id="head", floor="high", position=(2, 2), leads_to="up", seconds=12.0),
]
TWO_FLOORS = {
    "low": FloorPlan.build(box(0, 0, 12, 10), [[*box(0, 0, 12, 10), (0.0, 0.0)]], [box(5, 4, 1, 1)]),
    "high": FloorPlan.build(box(0, 0, 12, 10), [], [box(8, 4, 1, 1)]),
}


@pytest.mark.parametrize("behaviour", ["visitors", "passers"])
def test_people_change_floors_by_stairs_only_and_take_their_time(behaviour: str) -> None:
    parameters = WalkerParameters.model_validate(
        {"behaviour": behaviour, "pool": 20, "present": (6, 14), "doors": STAIRS, "away": (5, 20)}
    )
    people = Crowd(TWO_FLOORS, parameters, seed=2)
    assert people.floors == ("low", "high")
    moved = walked(people, 450.0)
    changes = np.argwhere((moved.floor[1:] != moved.floor[:-1]) & (moved.floor[1:] >= 0) & (moved.floor[:-1] >= 0))
    assert len(changes) >= 4
    for k, person in changes:
        assert not moved.present[k : k + 2, person].any()
        below, above = (k, k + 1) if moved.floor[k, person] == 0 else (k + 1, k)
        assert np.hypot(*(moved.position[below, person] - [9, 9])) < 1.5
        assert np.hypot(*(moved.position[above, person] - [2, 2])) < 1.5
        gone = ~moved.present[:, person]
        assert gone[max(0, k - 40) : k + 40].all()  # half of at least 0.8 · 12 s on either side
    present = moved.present.sum(axis=1)
    assert present.min() >= 6
    assert present.max() <= 14
    assert {0, 1} <= set(moved.floor[moved.present].tolist())


def test_a_declared_door_opens_the_wall_and_nobody_comes_by_any_other_way() -> None:
    parameters = WalkerParameters(pool=16, present=(4, 8), doors=[STAIRS[0]], visit=(30, 120), away=(5, 20))
    moved = walked(Crowd({"low": TWO_FLOORS["low"]}, parameters, seed=1), 300.0)
    crossing = (moved.present[1:] != moved.present[:-1]) & moved.known[1:] & moved.known[:-1]
    where = moved.position[1:][crossing]
    assert len(where) > 6
    assert np.abs(where - [0.0, 5.0]).max() < 1.0


_DIGEST = """
import hashlib, sys, numpy as np
sys.path.insert(0, {tests!r})
from test_crowd import MUSEUM, SITE, VISITORS, WORKERS, TWO_FLOORS, STAIRS
from services.simulator.crowd.crowd import Crowd, WalkerParameters
if {before}:
    Crowd({{"f": SITE}}, WORKERS, 99).movement(np.array([40.0]))
people = Crowd({plans}, {parameters}, seed=8)
moved = people.movement(np.arange(0.0, {seconds}, 0.05))
parts = (moved.position, moved.heading, moved.speed, moved.walked, moved.floor, moved.present)
print(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
"""


@pytest.mark.parametrize(
    ("plans", "parameters", "seconds"),
    [
        ('{"f": MUSEUM}', "VISITORS", 60.0),
        ("TWO_FLOORS", 'WalkerParameters(behaviour="passers", pool=150, present=(90, 110), doors=STAIRS)', 10.0),
    ],
)
def test_the_same_seed_is_the_same_to_the_bit_in_every_process(plans: str, parameters: str, seconds: float) -> None:
    digests = set()
    for hash_seed, before in (("1", False), ("2", True)):
        tests = str(Path(__file__).parent)
        code = _DIGEST.format(tests=tests, plans=plans, parameters=parameters, before=before, seconds=seconds)
        answer = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env={"PYTHONHASHSEED": hash_seed, "PYTHONPATH": str(ROOT), "PATH": ""},
            capture_output=True,
            text=True,
            check=True,
        )
        digests.add(answer.stdout.strip())
    assert len(digests) == 1


def test_the_walk_does_not_depend_on_how_it_is_asked_for() -> None:
    often, once = Crowd({"f": MUSEUM}, VISITORS, seed=9), Crowd({"f": MUSEUM}, VISITORS, seed=9)
    for t in np.arange(0.0, 40.0, 0.37):
        often.movement(np.array([t]), [2])
    times = np.arange(5.0, 40.0, 0.013)
    first, second = often.movement(times), once.movement(times)
    assert digest(first) == digest(second)
    some = once.movement(times, [7, 0])
    np.testing.assert_array_equal(some.position, second.position[:, [7, 0]])
    assert digest(Crowd({"f": MUSEUM}, VISITORS, seed=10).movement(times)) != digest(second)


def digest(moved: Movement) -> str:
    return hashlib.sha256(moved.position.tobytes() + moved.heading.tobytes() + moved.present.tobytes()).hexdigest()


def test_threads_may_ask_at_once() -> None:
    people, alone = Crowd({"f": MUSEUM}, VISITORS, seed=6), Crowd({"f": MUSEUM}, VISITORS, seed=6)
    answers: dict[int, str] = {}

    def ask(number: int) -> None:
        for t in np.arange(0.0, 30.0, 0.4 + 0.1 * number):
            people.movement(np.array([t]))
        answers[number] = digest(people.movement(np.arange(0.0, 30.0, 0.1)))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(answers.values()) == {digest(alone.movement(np.arange(0.0, 30.0, 0.1)))}


def test_the_last_minute_is_remembered_and_memory_does_not_grow() -> None:
    people = Crowd({"f": SITE}, WORKERS, seed=1)
    early = people.movement(np.arange(0.0, 5.0, 0.1))
    assert early.present.any()
    people.movement(np.array([300.0]))
    assert people.movement(np.array([241.0])).known.any()
    assert not people.movement(np.arange(0.0, 5.0, 0.1)).known.any()
    assert np.isnan(people.movement(np.array([100.0])).position).all()


def test_a_phone_s_rate_shows_no_steps_of_the_simulation() -> None:
    """At 100 Hz the accelerations are a body's, not those of a line drawn from step to step."""
    moved = walked(Crowd({"f": MUSEUM}, VISITORS, seed=12), 40.0, step=0.01)
    acceleration = np.diff(velocities(moved, 0.01), axis=0) / 0.01
    strength = np.hypot(acceleration[..., 0], acceleration[..., 1])
    assert np.nanquantile(strength, 0.999) < 8.0
    assert (np.diff(moved.walked, axis=0)[moved.known[1:] & moved.known[:-1]] >= 0.0).all()


def test_passers_walk_as_fast_as_real_pedestrians(data_folder: Path) -> None:
    recorded = Trajectories.from_eth(data_folder / "eth-walking" / "seq_eth" / "obsmat.txt", "f")
    real = walking_speeds(recorded, 0.0, recorded.end)
    parameters = WalkerParameters(behaviour="passers", pool=60, present=(4, 14), speed=(1.05, 2.25))
    square = FloorPlan.build(box(-7.5, -3.3, 21.5, 16.5))
    simulated = walking_speeds(Crowd({"f": square}, parameters, seed=7), 0.0, 300.0)
    assert simulated.people > 40
    assert simulated.mean == pytest.approx(real.mean, abs=0.15)
    assert simulated.sd == pytest.approx(real.sd, abs=0.1)
    np.testing.assert_allclose(simulated.quantiles, real.quantiles, atol=0.25)
    assert simulated.changes > 0.5 * real.changes


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"behaviour": "runners"}, "behaviour"),
        ({"present": [9, 3]}, r"\[low, high\]"),
        ({"pool": 4, "present": [2, 8]}, "pool: 4 people cannot make 8"),
        ({"carriers": 30, "pool": 40, "present": [5, 10]}, "carriers: 30"),
        ({"speed": [0.0, 1.0]}, r"speed: must lie within \[0.2, 2.5\]"),
        ({"speed": [float("nan"), 1.0]}, "finite"),
        ({"dwell": [0.0, 3.0]}, "dwell"),
        ({"present": [0, 0]}, "present"),
        ({"groups": 1.5}, "groups"),
        ({"walkers": 3}, "walkers"),
        ({"doors": [{"id": "a", "floor": "f", "position": [0, 0], "leads_to": "b"}]}, "leads_to: 'b'"),
        ({"doors": [{"id": "a", "floor": "f", "position": [0, 0]}] * 2}, "two are called 'a'"),
        ({"doors": [{"id": "a", "floor": "f", "position": [0, 0], "width": 0.3}]}, "width"),
    ],
)
def test_bad_parameters_are_refused_by_name(wrong: dict[str, object], told: str) -> None:
    with pytest.raises(ValidationError, match=told):
        WalkerParameters.model_validate(wrong)


def test_plans_nobody_could_walk_on_are_refused() -> None:
    ring = box(0, 0, 6, 6)
    few = WalkerParameters(pool=5, present=(1, 3))
    with pytest.raises(ValueError, match="floor f: the outline is walled all round"):
        Crowd({"f": FloorPlan.build(ring, [[*ring, ring[0]]])}, few, 1)
    with pytest.raises(ValueError, match="floor f: there is no room to walk"):
        Crowd({"f": FloorPlan.build(box(0, 0, 6, 6), [], [box(0.2, 0.2, 5.6, 5.6)])}, few, 1)
    elsewhere = few.model_copy(update={"doors": [Door(id="a", floor="attic", position=(0, 3))]})
    with pytest.raises(ValueError, match="doors: a: there is no floor 'attic'"):
        Crowd({"f": FloorPlan.build(ring)}, elsewhere, 1)
    outside = few.model_copy(update={"doors": [Door(id="a", floor="f", position=(9, 3))]})
    with pytest.raises(ValueError, match=r"doors: a: position \[9.0, 3.0\] is 3.0 m outside"):
        Crowd({"f": FloorPlan.build(ring)}, outside, 1)
    blocked = few.model_copy(update={"doors": [Door(id="a", floor="f", position=(0, 3))]})
    with pytest.raises(ValueError, match="door a at"):
        Crowd({"f": FloorPlan.build(ring, [], [box(0.0, 1.5, 2.5, 3.0)])}, blocked, 1)


@pytest.mark.parametrize(
    ("position", "leads_to", "told"),
    [
        ((3.0, 3.6), None, r"\[3.0, 3.6\] lies in an obstacle of floor f; allowed: within 0.6 m of the outline, or"),
        ((3.0, 3.6), "b", r"\[3.0, 3.6\] lies in an obstacle of floor f; allowed: "),
        ((0.3, 9.0), None, r"\[0.3, 9.0\] lies in an obstacle of floor f; allowed: "),
        ((7.5, 2.0), None, r"\[7.5, 2.0\] is 2.0 m inside the outline of floor f; allowed: .* with leads_to"),
    ],
)
def test_nobody_appears_in_an_exhibit_or_in_the_middle_of_the_hall(
    position: tuple[float, float], leads_to: str | None, told: str
) -> None:
    plan = FloorPlan.build(box(0, 0, 15, 16), [], [*EXHIBITS, box(-1, 8, 2, 2)])
    gate, other = (
        Door(id="b", floor="f", position=(15, 8)),
        Door(id="a", floor="f", position=position, leads_to=leads_to),
    )
    with pytest.raises(ValueError, match=f"doors: a: position {told}"):
        Crowd({"f": plan}, WalkerParameters(pool=5, present=(1, 3), doors=[gate, other]), 1)


def test_a_full_house_that_nobody_may_leave_still_walks() -> None:
    parameters = WalkerParameters(pool=6, present=(6, 6), visit=(5.0, 20.0))
    moved = walked(Crowd({"f": MUSEUM}, parameters, seed=1), 200.0)
    assert (moved.present.sum(axis=1) == 6).all()
    assert (moved.walked[-1] - moved.walked[0] > 10.0).all()


def test_rooms_behind_narrow_doors_are_visited() -> None:
    """Doors of 0.9 m in inner walls: plans keep a smaller distance there."""
    walls = [[(6.0, 0.0), (6.0, 1.5)], [(6.0, 2.4), (6.0, 7.0)], [(6.0, 7.9), (6.0, 10.0)]]
    plan = FloorPlan.build(box(0, 0, 12, 10), walls, [box(2, 4, 1, 1), box(9, 4, 1, 1)])
    parameters = WalkerParameters(pool=10, present=(5, 8), dwell=(2.0, 10.0))
    moved = walked(Crowd({"f": plan}, parameters, seed=3), 300.0)
    here, there = moved.position[:-1], moved.position[1:]
    inside = moved.present[1:] & moved.present[:-1]
    crossed = plan.walls_crossed(here[inside], there[inside])
    assert not crossed.any()
    assert ((np.diff(moved.position[..., 0] > 6.0, axis=0) != 0) & inside).sum() > 10
