"""Whoever vanishes where no camera can see has not left: nothing is said of it, and they go on when they are found."""

import numpy as np
import pytest
import shapely
from geofence_scene import Scene, a_room, a_site, a_watch, kinds

from services.geofence.crossings import RETURN
from services.geofence.sight import AreaSight, Sight
from shared.zones import ZoneRule

WEST, EAST = (2.0, 5.0), (8.0, 5.0)
OUTSIDE = (-4.0, 5.0)
BOTH = ["west", "east"]


@pytest.fixture
def scene() -> Scene:
    """A room whose western half one camera watches, and another the eastern; somebody is in each."""
    sight = AreaSight({"west": shapely.box(-5, 0, 5, 10), "east": shapely.box(5, 0, 15, 10)})
    rules = [ZoneRule(id=kind, kind=kind) for kind in ("enter", "exit")]
    rules.append(ZoneRule(id="crowd", kind="crowd", limit=2))
    scene = Scene(a_watch(a_room(*rules), sight={"hall": sight}))
    scene.cameras = BOTH
    assert sorted(kinds(scene.stand(3.0, {1: WEST, 2: EAST}, devices={1: "phone-1"}))) == ["enter", "enter"]
    return scene


def test_only_whom_a_camera_could_see_leave_has_left(scene: Scene) -> None:
    scene.cameras = ["east"]
    told = scene.stand(20.0, {})
    assert [(one.rule.rule.kind, one.track) for one in told] == [("exit", 2)]
    assert scene.watch.counts()["room"] == (0, 0)
    scene.cameras = BOTH
    assert scene.stand(RETURN + 5.0, {}) == []
    assert not scene.watch.areas["hall"].crossings.lost
    assert scene.watch.areas["hall"].crossings.occupancy.sum() == 0


def test_whom_the_phone_finds_again_goes_on_and_leaves(scene: Scene) -> None:
    scene.watch.lose_sight("hall")
    scene.t += 60.0
    told = scene.stand(2.0, {7: WEST}, devices={7: "phone-1"})
    assert told == []
    assert scene.watch.counts()["room"] == (1, 1)
    told = scene.walk(7, [WEST, OUTSIDE], devices={7: "phone-1"})
    assert [(one.rule.rule.kind, one.device) for one in told] == [("exit", "phone-1")]


def test_whom_nobody_found_is_no_crowd_with_those_who_are_seen(scene: Scene) -> None:
    scene.t += 60.0
    assert kinds(scene.stand(5.0, {11: WEST, 12: EAST})) == ["enter", "enter"]


def test_who_comes_back_under_the_same_number_has_neither_left_nor_entered(scene: Scene) -> None:
    scene.t += 60.0
    assert scene.stand(RETURN + 5.0, {1: WEST, 2: EAST}, devices={1: "phone-1"}) == []


def test_zones_are_blind_while_an_area_of_their_floor_is_silent() -> None:
    sight, room = Sight(a_site()), a_room()
    assert sight.blind_zones([room]) == {"room"}, "nothing was heard yet"
    sight.areas["hall"].look(1.0, None)
    assert sight.blind_zones([room]) == set()
    sight.areas["hall"].lose()
    assert sight.blind_zones([room, a_room(zone="far", points=[(90, 90), (95, 90), (95, 95)])]) == {"room"}


def test_a_camera_that_watches_another_part_hides_what_it_watches_no_more() -> None:
    sight = AreaSight({"west": shapely.box(-5, 0, 5, 10), "east": shapely.box(5, 0, 15, 10)})
    for t in (0.0, 0.1):
        sight.look(t, BOTH)
    x, y = np.array([WEST[0], EAST[0]]), np.array([WEST[1], EAST[1]])
    assert sight.hidden(x, y).tolist() == [False, False]
    sight.follow({"west": shapely.box(3, 0, 5, 10), "east": shapely.box(5, 0, 15, 10)})
    assert sight.blind == frozenset()
    for t in (3.0, 3.1):
        sight.look(t, ["west"])
    assert sight.blind == {"east"}
    assert sight.hidden(x, y).tolist() == [True, True]
