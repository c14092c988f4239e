"""What is in front of a visitor: field of view, walls, fronts and distance; and which way somebody looks who stands."""

import math
from pathlib import Path

import numpy as np
import pytest
from api_app import api
from hypothesis import given
from hypothesis import strategies as st

from services.api.in_front import in_front
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
) -> list[int]:
    n = len(exhibits)
    fronts = np.full(n, np.nan if facing is None else math.radians(facing))
    places = np.array(exhibits, dtype=float).reshape(-1, 2)
    found = in_front((0.0, 0.0), sigma, heading, math.radians(view), places, np.full(n, 8.0), fronts, plan)
    return found.exhibit.tolist()


def test_only_what_is_ahead_and_within_reach_nearest_first() -> None:
    assert seen([(6.0, 0.0), (2.0, 1.0), (-2.0, 0.0), (0.0, 3.0), (8.5, 0.0)]) == [1, 0]
    assert seen([(-2.0, 0.1), (0.0, 3.0)], heading=math.pi) == [0]
    assert seen([(-2.0, 0.0), (0.0, 3.0)], heading=None) == [0, 1]
    assert seen([(-2.0, 0.0), (0.0, 3.0)], view=360.0) == [0, 1]
    assert seen([]) == []


def test_a_wall_blocks_the_view_but_not_of_what_hangs_on_it() -> None:
    assert seen([(5.0, 0.0), (3.0, 0.0), (3.1, 1.0), (2.0, 0.0)], plan=WALLED) == [3, 1, 2]
    assert seen([(5.0, 0.0)], plan=OPEN) == [0]


def test_an_exhibit_shows_its_back_to_nobody() -> None:
    assert seen([(4.0, 0.0)], facing=180.0) == [0]
    assert seen([(4.0, 0.0)], facing=90.0) == [0]
    assert seen([(4.0, 0.0)], facing=0.0) == []


def test_who_is_only_roughly_known_is_not_denied_what_is_beside_them() -> None:
    beside = [(0.0, 0.4), (0.0, 6.0)]
    assert seen(beside, view=90.0) == []
    assert seen(beside, view=90.0, sigma=0.5) == [0]


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
    distances = [math.hypot(*exhibits[n]) for n in found]
    assert distances == sorted(distances)
    sin, cos = math.sin(1.0), math.cos(1.0)
    turned = [(x * cos - y * sin, x * sin + y * cos) for x, y in exhibits]
    assert sorted(seen(turned, heading + 1.0, view)) == wanted


def test_a_guide_app_is_told_and_the_last_heading_counts_when_the_visitor_stands(tmp_path: Path) -> None:
    with api(tmp_path) as here:
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
        assert told["exhibits"] == [{"id": "east", "name": "", "distance": 3.0, "bearing": pytest.approx(0.0)}]
        wide = here.client.get("/v1/positions/phone-1/exhibits?field_of_view=360&limit=1").json()
        assert len(wide["exhibits"]) == 1
        assert here.client.get("/v1/positions/phone-1/exhibits?field_of_view=5").status_code == 422
