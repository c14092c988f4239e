"""What is in front of a visitor: field of view, walls, fronts and distance; and which way somebody looks who stands."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
from api_app import api, hall, people
from hypothesis import given
from hypothesis import strategies as st

from services.api.in_front import Visitor, in_front
from shared.site import FloorPlan

ROOM = [(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)]
OPEN = FloorPlan.build(ROOM)
WALLED = FloorPlan.build(ROOM, walls=[[(3.0, -5.0), (3.0, 5.0)]])


def seen(
    exhibits: list[tuple[float, float]],
    heading: float | None = 0.0,
    view: float = 120.0,
    plan: FloorPlan = OPEN,
    sigma: float = 0.0,
    facing: float | None = None,
    stood: float = 0.0,
) -> dict[int, float]:
    """What is seen from (0, 0) and its probability, the most probable first."""
    n = len(exhibits)
    fronts = np.full(n, np.nan if facing is None else math.radians(facing))
    places = np.array(exhibits, dtype=float).reshape(-1, 2)
    visitor = Visitor((0.0, 0.0), sigma, heading, stood)
    found = in_front(visitor, math.radians(view), places, np.full(n, 8.0), fronts, plan)
    assert sorted(found.probability.tolist(), reverse=True) == found.probability.tolist()
    assert found.probability.sum() < 1.0
    return dict(zip(found.exhibit.tolist(), found.probability.tolist(), strict=True))


def test_who_walks_sees_what_is_ahead_and_within_reach() -> None:
    assert list(seen([(6.0, 0.0), (2.0, 1.0), (-2.0, 0.0), (0.0, 3.0), (8.5, 0.0)])) == [1, 0]
    assert list(seen([(-2.0, 0.1), (0.0, 3.0)], heading=math.pi)) == [0]
    assert list(seen([(-2.0, 0.0), (0.0, 3.0)], heading=None)) == [0, 1]
    assert set(seen([(-2.0, 0.0), (0.0, 3.0)], view=360.0)) == {0, 1}
    assert seen([]) == {}


def test_who_stands_has_turned_to_what_is_near() -> None:
    before_and_behind = [(2.5, 0.0), (-1.0, 0.0)]
    assert list(seen(before_and_behind)) == [0]
    standing = seen(before_and_behind, stood=5.0)
    assert list(standing) == [1, 0]
    assert standing[1] > 0.85
    shares = [seen([(0.8, 1.2), (-0.8, 1.2)], view=360.0, stood=stood)[0] for stood in (0.0, 0.3, 1.0, 5.0)]
    assert shares == sorted(shares, reverse=True), "what the walk says fades"
    assert shares[-1] == pytest.approx(seen([(0.8, 1.2), (-0.8, 1.2)], heading=None)[0], abs=0.01)


def test_probability_falls_with_distance_doubt_and_what_stands_beside() -> None:
    alone = seen([(1.0, 0.0)], heading=None)[0]
    assert alone > seen([(2.0, 0.0)], heading=None)[0] > seen([(5.0, 0.0)], heading=None)[0]
    assert alone > seen([(1.0, 0.0)], heading=None, sigma=2.0)[0]
    assert alone > seen([(1.0, 0.0), (0.0, 1.0)], heading=None)[0] == seen([(1.0, 0.0), (0.0, 1.0)], heading=None)[1]
    two = [(1.5, 0.0), (0.0, 1.5)]
    assert seen(two, heading=None, facing=180.0)[0] > seen(two, heading=None, facing=180.0)[1]


def test_a_wall_blocks_the_view_but_not_of_what_hangs_on_it() -> None:
    assert list(seen([(5.0, 0.0), (3.0, 0.0), (3.1, 1.0), (2.0, 0.0)], plan=WALLED)) == [3, 1, 2]
    assert list(seen([(5.0, 0.0)], plan=OPEN)) == [0]


def test_an_exhibit_shows_its_back_to_nobody() -> None:
    assert list(seen([(4.0, 0.0)], facing=180.0)) == [0]
    assert list(seen([(4.0, 0.0)], facing=90.0)) == [0]
    assert seen([(4.0, 0.0)], facing=0.0) == {}


def test_who_is_only_roughly_known_is_not_denied_what_is_beside_them() -> None:
    beside = [(0.0, 0.4), (0.0, 6.0)]
    assert seen(beside, view=90.0) == {}
    assert list(seen(beside, view=90.0, sigma=0.5)) == [0]


places = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), max_size=12)


@given(places, st.floats(-10, 10), st.floats(10, 350))
def test_as_one_by_one_and_the_same_however_the_plan_is_turned(
    exhibits: list[tuple[float, float]], heading: float, view: float
) -> None:
    def looked_at(x: float, y: float) -> bool:
        off = abs(math.remainder(math.atan2(y, x) - heading, 2.0 * math.pi))
        if math.hypot(x, y) < 0.3:
            return True
        return math.hypot(x, y) <= 8.0 and off <= math.radians(view) / 2.0

    margins = [
        abs(abs(math.remainder(math.atan2(y, x) - heading, 2.0 * math.pi)) - math.radians(view) / 2.0)
        for x, y in exhibits
    ]
    edges = [abs(math.hypot(x, y) - edge) for x, y in exhibits for edge in (0.3, 8.0)]
    if min([*margins, *edges, 1.0]) < 1e-9:
        return
    wanted = [n for n, (x, y) in enumerate(exhibits) if looked_at(x, y)]
    found = seen(exhibits, heading, view)
    assert sorted(found) == wanted
    sin, cos = math.sin(1.0), math.cos(1.0)
    turned = [(x * cos - y * sin, x * sin + y * cos) for x, y in exhibits]
    assert sorted(seen(turned, heading + 1.0, view)) == wanted


def test_a_guide_app_is_told_and_the_last_heading_counts_when_the_visitor_stands(tmp_path: Path) -> None:
    with api(tmp_path, hall(exhibits=[])) as here:
        for name, x, y in (("west", 3.0, 6.0), ("east", 9.0, 6.0)):
            assert here.client.post("/v1/exhibits", json={"id": name, "floor": "ground", "x": x, "y": y}).is_success
        assert here.client.get("/v1/positions/phone-1/exhibits").status_code == 404
        here.people(("phone-1", 6.0, 6.0))
        unknown = here.client.get("/v1/positions/phone-1/exhibits").json()
        assert (unknown["heading"], {e["id"] for e in unknown["exhibits"]}) == (None, {"west", "east"})
        here.people(("phone-1", 6.0, 6.0), vx=[1.2], vy=[0.0])
        here.people(("phone-1", 6.0, 6.0), vx=[-0.05], vy=[0.1])
        told = here.client.get("/v1/positions/phone-1/exhibits").json()
        assert told["heading"] == 0.0
        (east,) = told["exhibits"]
        assert (east["id"], east["distance"], east["bearing"]) == ("east", 3.0, pytest.approx(0.0))
        wide = here.client.get("/v1/positions/phone-1/exhibits?field_of_view=360&limit=1").json()
        assert len(wide["exhibits"]) == 1
        assert here.client.get("/v1/positions/phone-1/exhibits?field_of_view=5").status_code == 422


def test_what_was_known_of_a_visitor_grows_old_while_they_stand_and_when_they_are_lost(tmp_path: Path) -> None:
    with api(tmp_path, hall(exhibits=[])) as here:
        for name, x, y in (("west", 3.0, 6.0), ("east", 9.0, 6.0)):
            assert here.client.post("/v1/exhibits", json={"id": name, "floor": "ground", "x": x, "y": y}).is_success
        now = time.time()
        walked, stands = people(now - 30.0, ("phone-1", 6.0, 6.0), vx=[1.2]), people(now - 20.0, ("phone-1", 6.0, 6.0))
        assert here.live.take_tracks(walked, now - 30.0)
        assert here.live.take_tracks(stands, now - 20.0)
        told = here.client.get("/v1/positions/phone-1/exhibits").json()
        assert {one["id"] for one in told["exhibits"]} == {"west", "east"}
        assert (told["state"], told["heading"]) == ("confirmed", 0.0)
        assert told["heading_age"] == pytest.approx(told["age"] + 10.0, abs=0.01)
        here.people()
        lost = here.client.get("/v1/positions/phone-1/exhibits").json()
        assert lost["state"] == "lost"
        assert lost["heading_age"] >= told["heading_age"] >= 30.0
