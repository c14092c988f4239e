"""Every rule of a zone tells what it asks for, once per person, of whom and when it should."""

from datetime import UTC, datetime
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from geofence_scene import ROOM, Scene, a_line, a_plan, a_room, a_site, a_watch, kinds

from services.geofence.schedule import holds
from services.geofence.zone_plan import ZonePlan
from shared.messages import Revision
from shared.zones import Schedule, ZoneDefinition, ZoneRule

OUT, IN, DEEP = (-4.0, 5.0), (3.0, 5.0), (6.0, 5.0)


def rule(kind: Any, name: str = "", **more: Any) -> ZoneRule:
    return ZoneRule(id=name or kind, kind=kind, **more)


def test_enter_and_exit_are_told_once_with_the_time_of_the_border() -> None:
    scene = Scene(a_watch(a_room(rule("enter"), rule("exit"))))
    told = scene.walk(1, [OUT, IN, OUT])
    assert kinds(told) == ["enter", "exit"]
    assert abs(told[0].x) < 0.4
    assert told[0].t < told[1].t


def test_a_long_stay_is_told_once_per_visit_at_the_time_it_is_long() -> None:
    scene = Scene(a_watch(a_room(rule("dwell", limit=5.0))))
    scene.walk(1, [OUT, IN])
    entered = scene.t
    told = scene.stand(20.0, {1: IN})
    assert kinds(told) == ["dwell"]
    assert told[0].t == pytest.approx(entered - 3.0 / 1.3 + 5.0, abs=0.5)
    assert told[0].value == pytest.approx(5.0, abs=0.2)
    scene.walk(1, [IN, OUT, IN])
    assert kinds(scene.stand(10.0, {1: IN})) == ["dwell"]


@pytest.mark.parametrize(("direction", "expected"), [("forward", 1), ("backward", 1), ("both", 2)])
def test_a_line_is_crossed_in_its_direction(direction: Any, expected: int) -> None:
    scene = Scene(a_watch(a_line(rule("cross", direction=direction))))
    told = scene.walk(1, [(-3.0, 0.0), (3.0, 0.0), (-3.0, 0.5)])
    assert len(told) == expected
    assert all(abs(one.x) < 0.05 for one in told)
    if direction != "both":
        assert [one.direction for one in told] == [direction]


def test_a_line_is_not_crossed_round_its_end_nor_by_a_step_over_it_and_back() -> None:
    scene = Scene(a_watch(a_line(rule("cross"))))
    assert scene.walk(1, [(-3.0, 0.0), (0.05, 0.0), (-3.0, 0.0)]) == []
    assert scene.walk(1, [(-3.0, 0.0), (-3.0, 6.0), (3.0, 6.0), (3.0, 0.0)]) == []
    told = scene.walk(1, [(3.0, 0.0), (-3.0, 0.0)])
    assert [one.direction for one in told] == ["backward"]


def test_a_line_is_crossed_by_one_long_step() -> None:
    scene = Scene(a_watch(a_line(rule("cross"))))
    assert scene.stand(0.5, {1: (-8.0, 0.0)}) == []
    assert [one.direction for one in scene.stand(0.3, {1: (8.0, 1.0)})] == ["forward"]


def test_a_crowd_is_told_once_until_it_has_dispersed() -> None:
    scene = Scene(a_watch(a_room(rule("crowd", limit=2.0))))
    three = {1: (3.0, 3.0), 2: (5.0, 5.0), 3: (7.0, 7.0)}
    scene.stand(2.0, dict(list(three.items())[:2]))
    told = scene.stand(10.0, three)
    assert kinds(told) == ["crowd"]
    assert (told[0].track, told[0].value, told[0].device) == (0, 3.0, None)
    scene.stand(10.0, {1: three[1]})
    assert kinds(scene.stand(5.0, three)) == ["crowd"]


def test_two_people_too_near_are_told_once_and_name_each_other() -> None:
    scene = Scene(a_watch(a_room(rule("proximity", limit=1.5))))
    assert scene.stand(3.0, {1: (3.0, 3.0), 2: (6.0, 3.0)}) == []
    told = scene.stand(8.0, {1: (3.0, 3.0), 2: (4.0, 3.0)}, devices={2: "phone-2"})
    assert kinds(told) == ["proximity"]
    assert {told[0].track, told[0].other_track} == {1, 2}
    assert {told[0].device, told[0].other_device} == {None, "phone-2"}
    assert told[0].value == pytest.approx(1.0)


def test_a_hazard_is_too_near_a_person_and_not_two_people_each_other() -> None:
    scene = Scene(a_watch(a_room(rule("proximity", limit=2.0, target="forklift"))))
    people = {1: (3.0, 3.0), 2: (3.5, 3.0)}
    assert scene.stand(3.0, people) == []
    # The forklift stands outside of the zone; who is in it is in danger all the same.
    told = scene.stand(3.0, {**people, 9: (3.0, -0.8)}, devices={9: "forklift"})
    assert told == []
    told = scene.stand(3.0, {1: (3.0, 0.8), 2: (9.0, 9.0), 9: (3.0, -0.8)}, devices={9: "forklift"})
    assert [(one.track, one.other_track, one.other_device) for one in told] == [(1, 9, "forklift")]


def test_the_confidence_of_proximity_counts_how_well_places_are_known() -> None:
    near = {1: (3.0, 3.0), 2: (4.2, 3.0)}
    sure = Scene(a_watch(a_room(rule("proximity", limit=1.5, confidence=0.95))))
    assert sure.stand(5.0, near, sigma=0.4) == []
    assert kinds(sure.stand(5.0, near, sigma=0.05)) == ["proximity"]


def test_a_phone_of_which_nobody_knows_where_it_is_is_near_nobody() -> None:
    scene = Scene(a_watch(a_room(rule("proximity", limit=2.0, target="forklift"))))
    scene.stand(1.0, {1: (3.0, 3.0)})
    told = scene.stand(3.0, {1: (3.0, 3.0), 9: (3.5, 3.0)}, devices={9: "forklift"}, sigma=2.0, unseen=(9,))
    assert told == []


def test_speed_is_told_once_per_run() -> None:
    scene = Scene(a_watch(a_room(rule("speed", limit=2.0))))
    scene.stand(3.0, {1: IN}, velocity=(1.5, 0.0))
    assert scene.told == []
    told = scene.stand(3.0, {1: IN}, velocity=(2.0, 1.5))
    assert kinds(told) == ["speed"]
    assert told[0].value == pytest.approx(2.5)
    scene.stand(4.0, {1: IN})
    assert kinds(scene.stand(3.0, {1: IN}, velocity=(3.0, 0.0))) == ["speed"]


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({"audience": "everybody"}, {None, "phone-1", "phone-2"}),
        ({"audience": "phones"}, {"phone-1", "phone-2"}),
        ({"audience": "anonymous"}, {None}),
        ({"devices": ["phone-2"]}, {"phone-2"}),
    ],
)
def test_a_rule_is_about_its_audience(asked: dict[str, Any], expected: set[str | None]) -> None:
    scene = Scene(a_watch(a_room(rule("enter", **asked))))
    told = scene.stand(2.0, {1: IN, 2: (5.0, 5.0), 3: (7.0, 7.0)}, devices={1: "phone-1", 2: "phone-2"})
    assert {one.device for one in told} == expected
    assert len(told) == len(expected)


def test_whose_phone_is_recognised_inside_is_told_then_with_the_time_of_entering() -> None:
    scene = Scene(a_watch(a_room(rule("enter", audience="phones"), rule("enter", "all"))))
    assert [one.rule.told_as for one in scene.walk(1, [OUT, IN])] == ["all"]
    entered = scene.told[0].t
    scene.stand(3.0, {1: IN})
    told = scene.stand(2.0, {1: IN}, devices={1: "phone-1"})
    assert [(one.rule.told_as, one.device, one.t) for one in told] == [("enter", "phone-1", entered)]


def test_a_revised_identity_is_told_of_a_line_crossed_before() -> None:
    scene = Scene(a_watch(a_line(rule("cross", devices=["phone-1"]))))
    assert scene.walk(1, [(-3.0, 0.0), (3.0, 0.0)]) == []
    crossed = scene.t - 3.0 / 1.3
    revision = Revision(
        t=scene.t, area="hall", chunk=1, tracker="test", device=["phone-1"], since=[crossed - 2.0],
        of=[0, 0], at=[crossed - 0.2, crossed + 0.2], track=[1, 1], x=[0.0, 0.0], y=[0.0, 0.0],
        covariance=[(0.01, 0.0, 0.01)] * 2, probability=[0.9, 0.9],
    )  # fmt: skip
    told = scene.watch.revise(revision)
    assert [(one.rule.rule.kind, one.device, one.direction) for one in told] == [("cross", "phone-1", "forward")]
    assert scene.watch.revise(revision) == [], "told once"


def test_quiet_holds_for_a_person_under_a_new_number_too() -> None:
    scene = Scene(a_watch(a_room(rule("enter", quiet=60.0))))
    assert len(scene.walk(1, [OUT, IN, OUT], devices={1: "phone-1"})) == 1
    scene.stand(3.0, {})
    assert scene.walk(7, [OUT, IN, OUT], devices={7: "phone-1"}) == []
    assert len(scene.walk(8, [OUT, IN])) == 1, "somebody else"
    scene.stand(70.0, {})
    assert len(scene.walk(9, [OUT, IN], devices={9: "phone-1"})) == 1


def test_two_areas_that_see_one_person_tell_once() -> None:
    scene = Scene(a_watch(a_room(rule("enter"), rule("exit")), areas=("east", "west")), area="east")
    scene.walk(1, [OUT, IN])
    # The other area sees the same person, a little aside, and later alone.
    scene.stand(1.0, {5: (3.2, 5.1)}, area="west")
    assert kinds(scene.told) == ["enter"]
    assert scene.watch.counts()["room"] == (1, 0)
    scene.stand(4.0, {}, area="east")
    scene.stand(0.2, {5: (3.2, 5.1)}, area="west")
    assert kinds(scene.told) == ["enter"]
    scene.stand(3.0, {5: (-4.0, 5.0)}, area="west")
    assert kinds(scene.told) == ["enter", "exit"]


def test_two_areas_that_see_two_people_tell_of_both() -> None:
    scene = Scene(a_watch(a_room(rule("enter")), areas=("east", "west")), area="east")
    scene.stand(1.0, {1: IN})
    scene.stand(1.0, {1: (8.0, 5.0)}, area="west")
    assert kinds(scene.told) == ["enter", "enter"]


def test_a_track_with_a_former_id_stays_and_its_stay_goes_on() -> None:
    scene = Scene(a_watch(a_room(rule("enter"), rule("dwell", limit=6.0))))
    scene.walk(1, [OUT, IN])
    scene.stand(3.0, {1: IN})
    scene.stand(5.0, {2: IN}, former={2: [1]})
    assert kinds(scene.told) == ["enter", "dwell"]
    assert scene.told[1].track == 2


# -- zones that change -------------------------------------------------------------------------------------------------


def test_who_is_inside_of_a_zone_that_changes_shape_does_not_enter_again() -> None:
    rules = (rule("enter"), rule("exit"), rule("dwell", limit=8.0))
    scene = Scene(a_watch(a_room(*rules)))
    scene.walk(1, [OUT, IN])
    scene.stand(3.0, {1: IN, 2: (8.0, 5.0)})
    assert kinds(scene.told) == ["enter", "enter"]
    smaller = [(0.0, 0.0), (5.0, 0.0), (5.0, 10.0), (0.0, 10.0)]
    told = scene.watch.follow(a_plan(a_room(*rules, points=smaller)), scene.t)
    assert [(one.rule.rule.kind, one.track) for one in told] == [("exit", 2)]
    assert kinds(scene.stand(5.0, {1: IN, 2: (8.0, 5.0)})) == ["dwell"]
    assert scene.watch.counts() == {"room": (1, 0)}


def test_who_stands_where_a_zone_is_drawn_is_counted_and_has_not_entered() -> None:
    scene = Scene(a_watch())
    scene.stand(1.0, {1: IN})
    assert scene.watch.follow(a_plan(a_room(rule("enter"), rule("exit"))), scene.t) == []
    assert scene.stand(2.0, {1: IN}) == []
    assert scene.watch.counts() == {"room": (1, 0)}
    assert kinds(scene.walk(1, [IN, OUT, IN])) == ["exit", "enter"]


def test_a_crossing_under_way_is_not_lost_when_another_zone_is_drawn() -> None:
    line = a_line(rule("cross"))
    scene = Scene(a_watch(line))
    scene.walk(1, [(-2.0, 0.0), (0.05, 0.0)])
    scene.watch.follow(a_plan(line, a_room(rule("enter"), points=[(20.0, 20.0), (22.0, 20.0), (22.0, 22.0)])), scene.t)
    assert kinds(scene.walk(1, [(0.05, 0.0), (2.0, 0.0)])) == ["cross"]


def test_a_rule_added_to_a_zone_tells_of_those_who_come_after() -> None:
    scene = Scene(a_watch(a_room()))
    scene.stand(1.0, {1: IN})
    scene.watch.follow(a_plan(a_room(rule("enter"))), scene.t)
    assert [one.track for one in scene.stand(1.0, {1: IN, 2: DEEP})] == [2]


@pytest.mark.parametrize(
    ("zone", "why"),
    [
        (ZoneDefinition(id="z", floor="cellar", points=ROOM), "no floor"),
        (ZoneDefinition(id="z", floor="ground", points=ROOM[:2]), "three corners"),
        (ZoneDefinition(id="z", floor="ground", points=[(0, 0), (1, 1), (1, 0), (0, 1)]), "crosses"),
        (ZoneDefinition(id="z", floor="ground", points=[(0, 0), (1, 0), (2, 0)]), "crosses or touches|nothing"),
        (ZoneDefinition(id="z", floor="ground", points=[(0, 0), (float("nan"), 0), (2, 2)]), "finite"),
        (ZoneDefinition(id="z", floor="ground", points=[(0, 0), (1e300, 0), (0, 1e300)]), "farther"),
        (ZoneDefinition(id="z", floor="ground", points=[(900, 900), (901, 900), (901, 901)]), "outside of floor"),
        (ZoneDefinition(id="z", floor="ground", shape="line", points=[(1, 1), (1, 1)]), "no length"),
        (a_room(rule("cross"), zone="z"), "no rule of an area"),
        (a_room(rule("crowd"), zone="z"), "needs a limit"),
    ],
)
def test_what_cannot_be_watched_is_said_and_the_rest_is_watched(zone: ZoneDefinition, why: str) -> None:
    plan = a_plan(zone, a_room(rule("enter")))
    assert list(plan.problems) == ["z"]
    assert any(word in plan.problems["z"] for word in why.split("|"))
    assert "room" in plan.zones


def test_a_huge_zone_and_many_small_ones_are_watched_together() -> None:
    huge = [(-1e7, -1e7), (1e7, -1e7), (1e7, 1e7), (-1e7, 1e7)]
    small = [
        a_room(zone=f"z{n}", points=[(x, y), (x + 0.8, y), (x + 0.8, y + 0.8)])
        for n, (x, y) in enumerate((float(n % 40), float(n // 40)) for n in range(1000))
    ]
    plan = ZonePlan.of([a_room(rule("enter"), zone="huge", points=huge), *small], a_site(), 0.1, 0.3)
    assert plan.problems == {}
    scene = Scene(a_watch(a_room(rule("enter"), zone="huge", points=huge), *small))
    assert kinds(scene.stand(1.0, {1: IN})) == ["enter"]


# -- schedules ---------------------------------------------------------------------------------------------------------


def at(text: str, zone: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=ZoneInfo(zone)).timestamp()


@pytest.mark.parametrize(
    ("schedule", "local", "expected"),
    [
        (None, "2026-06-01T03:00", True),
        (Schedule(since="09:00", until="18:00"), "2026-06-01T09:00", True),
        (Schedule(since="09:00", until="18:00"), "2026-06-01T18:00", False),
        (Schedule(days=[0], since="09:00", until="18:00"), "2026-06-02T10:00", False),
        (Schedule(days=[0], since="22:00", until="06:00"), "2026-06-01T23:00", True),
        (Schedule(days=[0], since="22:00", until="06:00"), "2026-06-02T05:59", True),  # Monday's night
        (Schedule(days=[0], since="22:00", until="06:00"), "2026-06-01T05:00", False),  # Sunday's night
        (Schedule(days=[1]), "2026-06-02T00:00", True),
        (Schedule(days=[1]), "2026-06-01T23:59", False),
    ],
)
def test_a_schedule_holds_by_the_sites_clock(schedule: Schedule | None, local: str, expected: bool) -> None:
    for zone in ("Europe/Rome", "America/New_York"):
        assert holds(schedule, at(local, zone), ZoneInfo(zone)) is expected


def test_a_rule_out_of_its_hours_tells_nothing_and_a_stay_is_told_when_they_begin() -> None:
    night = Schedule(since="22:00", until="06:00")
    start = datetime(2026, 6, 1, 19, 59, 50, tzinfo=UTC).timestamp()  # 21:59:50 in Rome
    zone = a_room(rule("enter", schedule=night), rule("dwell", limit=4.0, schedule=night))
    scene = Scene(a_watch(zone, clock="Europe/Rome"), t=start)
    assert scene.stand(9.0, {1: IN}) == []
    assert kinds(scene.stand(4.0, {1: IN})) == ["dwell"]
    assert kinds(scene.stand(1.0, {1: IN, 2: DEEP})) == ["enter"]
