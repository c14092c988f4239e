"""The site file's list of access points was edited: what was learned of each stays with its name, and none is lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from fusion_world import make_site
from hypothesis import given
from hypothesis import strategies as st
from radio_stretches import T0, hall_of, model_of, off_by, rms, teach

from services.learning.area_judge import AreaJudge
from services.learning.radio.by_name import columns_today
from services.learning.radio.lessons import RadioLessons
from services.learning.tracks.radio_habits import RadioHabits
from shared.site import AccessPoint, Site

MINUTES = range(9)


def with_points(site: Site, *names: str) -> Site:
    """Return the site with these access points in this order; one it does not have hangs in its middle."""
    known = {point.id: point for point in site.access_points}
    new = site.access_points[0]
    points: list[AccessPoint] = [
        known[name] if name in known else new.model_copy(update={"id": name, "position": (12.0, 7.0, 3.0)})
        for name in names
    ]
    return site.model_copy(update={"access_points": points})


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.fixture(scope="module")
def names(site: Site) -> list[str]:
    return [point.id for point in site.access_points if point.floor == "ground"]


@pytest.fixture(scope="module")
def taught(site: Site) -> RadioLessons:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    [*_, proposal] = teach(lessons, hall, MINUTES)
    lessons.activated(proposal.model)
    return lessons


def restored(lessons: RadioLessons, site: Site) -> RadioLessons:
    again = RadioLessons(site, "hall")
    again.restore(msgspec.json.decode(msgspec.json.encode(lessons.state())))
    return again


def visits_by_name(lessons: RadioLessons) -> dict[str, int]:
    return {name: lessons._evidence.count(point) for point, name in enumerate(lessons.points)}


def test_in_another_order_readings_stay_with_their_access_point(
    site: Site, names: list[str], taught: RadioLessons
) -> None:
    before = {fit.access_point: fit for fit in taught.fits(T0 + 540.0)}
    turned = with_points(site, *reversed(names))
    again = restored(taught, turned)
    after = {fit.access_point: fit for fit in again.fits(T0 + 540.0)}
    assert [fit.readings for fit in after.values()] == [before[name].readings for name in after]
    assert [fit.bias for fit in after.values()] == pytest.approx([before[name].bias for name in after])
    assert again.offsets() == taught.offsets()
    assert restored(again, site).state() == taught.state()


def test_one_that_is_added_costs_the_others_nothing_and_one_that_is_gone_takes_its_own_along(
    site: Site, names: list[str], taught: RadioLessons
) -> None:
    before = visits_by_name(taught)
    assert min(before.values()) > 100
    added = restored(taught, with_points(site, "ap-new", *names))
    assert visits_by_name(added) == {"ap-new": 0, **before}
    replaced = restored(taught, with_points(site, "ap-new", *names[1:]))
    assert visits_by_name(replaced) == {"ap-new": 0, **{name: before[name] for name in names[1:]}}
    gone = restored(taught, with_points(site))
    assert len(gone._evidence) == 0
    assert gone._evidence.devices == []


def test_what_is_learned_afterwards_is_as_near_to_the_truth(site: Site, names: list[str], taught: RadioLessons) -> None:
    turned = with_points(site, *reversed(names))
    again = restored(taught, turned)
    hall = hall_of(site, seed=3)
    hall.loss = type(hall.loss)(
        hall.loss.names[::-1], hall.loss.positions[::-1], hall.loss.power_1m[::-1], hall.loss.exponent[::-1]
    )
    [*_, proposal] = teach(again, hall, range(9, 15))
    assert rms(off_by(model_of(proposal, turned, again), hall)) < 2.5


def test_what_changed_and_what_was_found_stays_with_its_access_point(
    site: Site, names: list[str], taught: RadioLessons
) -> None:
    state: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(taught.state()))
    change = {"state": "moved", "found": T0, "since": T0, "by": 3.0, "words": "moved"}
    state["changes"]["found"] = {"1": change, "2": change}
    state["changes"]["located"] = {"1": [5.0, 6.0, 1.0, 0.0, 0.0, 1.0, 9.0], "2": [7.0, 6.0, 1.0, 0.0, 0.0, 1.0, 9.0]}
    again = RadioLessons(with_points(site, "ap-new", *names[2:]), "hall")
    again.restore(state)
    assert list(again._changes.found) == [1]
    assert {point: where.place.tolist() for point, where in again._changes.located.items()} == {1: [7.0, 6.0]}
    assert again._changes.guess.names[1] == names[2]


@pytest.mark.parametrize("wrong", [None, "ap-1", ["ap-1", "ap-1"], [1, 2]])
def test_a_state_that_does_not_say_whose_columns_it_has_is_refused(
    site: Site, taught: RadioLessons, wrong: Any
) -> None:
    state = {**taught.state(), "access_points": wrong}
    again = RadioLessons(site, "hall")
    with pytest.raises(ValueError, match="hall"):
        again.restore(state)
    assert len(again._evidence) == 0


def test_habits_of_the_judge_stay_with_their_access_point(site: Site, names: list[str]) -> None:
    judge = AreaJudge(site, "hall")
    judge._judge._habits.hear(np.repeat(np.arange(len(names)), 3), np.repeat(-50.0 - np.arange(len(names)), 3))
    state = msgspec.json.decode(msgspec.json.encode(judge.state()))
    level = dict(zip(names, judge._judge.belief("d").nowhere.level.tolist(), strict=True))
    again = AreaJudge(with_points(site, names[2], "ap-new", names[0]), "hall")
    again.restore(state)
    told = again._judge.belief("d").nowhere.level.tolist()
    assert told == [level[names[2]], RadioHabits(1).belief("d").nowhere.level[0], level[names[0]]]
    with pytest.raises(ValueError, match="access points"):
        again.restore({**state, "access_points": names[1:]})


@given(st.lists(st.sampled_from("abcdef"), unique=True), st.lists(st.sampled_from("abcdef"), unique=True))
def test_columns_are_found_again_by_name(saved: list[str], today: list[str]) -> None:
    columns = columns_today(saved, today).tolist()
    assert [today[column] if column >= 0 else None for column in columns] == [
        name if name in today else None for name in saved
    ]
