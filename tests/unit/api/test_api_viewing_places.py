"""Where people stand who look at an exhibit: before it, on its side of the wall, and at one exhibit only."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from api_app import api, hall
from hypothesis import given
from hypothesis import strategies as st

from services.api.admin.exhibits import ExhibitDefinition
from services.api.viewing_places import NEAR, SAME, viewing_places
from shared.site import FloorPlan

ROOM = [(0.0, 0.0), (20.0, 0.0), (20.0, 12.0), (0.0, 12.0)]
WALLED = FloorPlan.build(ROOM, walls=[[(10.0, 0.0), (10.0, 12.0)]])


def exhibit(x: float, y: float, name: str = "e", **more: float) -> ExhibitDefinition:
    return ExhibitDefinition(id=name, floor="ground", x=x, y=y, **more)  # type: ignore[arg-type]


def place(*exhibits: ExhibitDefinition, plan: FloorPlan = WALLED) -> dict[str, shapely.Polygon]:
    return {zone.id: shapely.Polygon(zone.points) for zone in viewing_places(exhibits, "ground", plan)}


def test_a_free_exhibit_is_looked_at_from_all_around_on_its_side_of_the_wall() -> None:
    assert place(exhibit(5.0, 6.0))["e"].area == pytest.approx(np.pi * NEAR**2, rel=0.01)
    near_wall = place(exhibit(9.0, 6.0))["e"]
    assert near_wall.bounds[2] < 10.0
    assert near_wall.contains(shapely.Point(8.0, 6.0))
    assert place(exhibit(5.0, 6.0, reach=1.0))["e"].area == pytest.approx(np.pi, rel=0.01)


@pytest.mark.parametrize(("facing", "side"), [(180.0, 9.0), (0.0, 11.0)])
def test_what_hangs_on_a_wall_is_looked_at_from_where_it_faces(facing: float, side: float) -> None:
    hung = place(exhibit(10.0, 6.0, facing=facing))["e"]
    assert hung.contains(shapely.Point(side, 6.0))
    assert not hung.intersects(shapely.Point(20.0 - side, 6.0))


def test_an_exhibit_of_another_floor_or_outside_has_no_place_here() -> None:
    assert place(ExhibitDefinition(id="up", floor="upper", x=5.0, y=5.0)) == {}
    assert place(exhibit(-0.9, 6.0, reach=0.5)) == {}


spots = st.lists(st.tuples(st.floats(0, 20), st.floats(0, 12)), min_size=1, max_size=8, unique=True)


@given(spots, st.integers(0, 2**31))
def test_nobody_is_counted_at_two_exhibits_and_always_at_the_nearest(
    places: list[tuple[float, float]], seed: int
) -> None:
    exhibits = [exhibit(x, y, f"e{n}") for n, (x, y) in enumerate(places)]
    areas = place(*exhibits, plan=FloorPlan.build(ROOM))
    pairs = min((float(np.hypot(a - c, b - d)) for n, (a, b) in enumerate(places) for c, d in places[:n]), default=1.0)
    people = np.random.default_rng(seed).uniform((0.0, 0.0), (20.0, 12.0), (50, 2))
    for x, y in people:
        inside = [name for name, area in areas.items() if area.contains(shapely.Point(x, y))]
        away = np.hypot(*(np.array(places) - (x, y)).T)
        first, *others = np.sort(away)
        margin = (others[0] - first) if others else 1.0
        if margin < 0.05 or abs(first - NEAR) < 0.05 or pairs < SAME:
            continue  # on an edge
        assert inside == ([f"e{np.argmin(away)}"] if first < NEAR else [])


def test_the_api_knows_where_its_exhibits_are_looked_at_from(tmp_path: Path) -> None:
    with api(tmp_path, hall(exhibits=[])) as here:
        assert here.admin.viewing_places() == []
        here.client.post("/v1/exhibits", json={"id": "vase", "floor": "ground", "x": 5.0, "y": 4.0})
        (zone,) = here.admin.viewing_places()
        assert zone.id == "vase"
        assert shapely.Polygon(zone.points).contains(shapely.Point(5.0, 5.0))
