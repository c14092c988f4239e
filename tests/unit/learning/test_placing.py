"""An access point whose place the site file does not say is kept, looked for, found, and told of in plain words."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import make_site
from radio_stretches import PHONES, T0, Hall, hall_of, model_of, off_by, rms, teach

from services.learning.proposal import Proposal
from services.learning.radio.lessons import RadioLessons
from services.learning.radio.placing import NEEDED
from shared.learning_report import AccessPointFit
from shared.messages import RadioModelFile, RadioModelUpdate
from shared.site import Site

UNKNOWN = "ap-3"
MINUTES = range(9)


def stripped(site: Site, *names: str) -> Site:
    points = [
        point.model_copy(update={"position": None}) if point.id in names else point for point in site.access_points
    ]
    return site.model_copy(update={"access_points": points})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.fixture(scope="module")
def site(whole: Site) -> Site:
    return stripped(whole, UNKNOWN)


@pytest.fixture(scope="module")
def taught(whole: Site, site: Site) -> tuple[RadioLessons, Hall, list[Proposal]]:
    lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
    return lessons, hall, teach(lessons, hall, MINUTES)


@pytest.fixture
def lessons(taught: tuple[RadioLessons, Hall, list[Proposal]]) -> RadioLessons:
    return copy.deepcopy(taught[0])


def fit_of(lessons: RadioLessons, name: str = UNKNOWN, minutes: int = MINUTES.stop) -> AccessPointFit:
    [fit] = [fit for fit in lessons.fits(T0 + 60.0 * minutes) if fit.access_point == name]
    return fit


def file_of(proposal: Proposal) -> RadioModelFile:
    assert isinstance(proposal.model, RadioModelUpdate)
    assert proposal.model.model is not None
    return proposal.model.model


def test_until_it_is_found_it_is_told_how_much_is_missing_and_teaches_nothing(whole: Site, site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
    assert fit_of(lessons).words == f"access point {UNKNOWN} is not placed yet: 0 readings of {NEEDED} needed"
    lessons.learn(hall.stretch("a", 0.0, seconds=20.0))
    fit = fit_of(lessons)
    assert (fit.state, fit.position, fit.sigma) == ("not placed", None, None)
    assert 0 < fit.readings < NEEDED
    assert f"{fit.readings} readings of {NEEDED}" in fit.words


def test_what_is_heard_of_it_does_not_draw_what_is_learned_of_others(whole: Site, site: Site) -> None:
    found = []
    for heard in (True, False):
        lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
        for minute in range(3):
            for device, offset in PHONES.items():
                stretch = hall.stretch(device, 60.0 * minute, offset=offset)
                kept = (stretch.point != 2) | heard
                columns = ("scan_t", "point", "level", "scan_place", "scan_spread")
                lessons.learn(dataclasses.replace(stretch, **{name: getattr(stretch, name)[kept] for name in columns}))
        [proposal] = lessons.propose(T0 + 180.0, T0 + 180.0)
        assert file_of(proposal).positions[2] is None
        assert file_of(proposal).located == []
        found.append(model_of(proposal, site, lessons))
    assert found[0].path_loss.placed.tolist() == [True, True, False, True, True, True]
    np.testing.assert_array_equal(found[0].path_loss.power_1m, found[1].path_loss.power_1m)
    np.testing.assert_array_equal(found[0].shadowing.mean, found[1].shadowing.mean)


def test_it_is_found_where_it_hangs_and_goes_into_the_model(
    taught: tuple[RadioLessons, Hall, list[Proposal]], lessons: RadioLessons, site: Site, whole: Site
) -> None:
    _, hall, proposals = taught
    fit = fit_of(lessons)
    assert fit.position is not None
    assert fit.position_error is not None
    away = float(np.hypot(*(np.array(fit.position[:2]) - hall.loss.positions[2, :2])))
    assert away < 3.0 * fit.position_error
    assert away < 3.0
    with_it = [proposal for proposal in proposals if file_of(proposal).located]
    assert with_it[0].trained_until <= T0 + 480.0
    assert f"{UNKNOWN} was found" in with_it[0].reason
    assert file_of(with_it[-1]).located == [UNKNOWN]
    assert rms(off_by(model_of(with_it[-1], site, lessons), hall)[:, 2]) < 2.5
    assert fit.state == "fine"
    assert fit.words == f"access point {UNKNOWN} was found by what phones hear of it"


def test_rolled_back_it_is_not_placed_and_says_what_it_waits_for(lessons: RadioLessons) -> None:
    lessons.activated(RadioModelUpdate(t=T0, area="hall", version=9, model=None))
    fit = fit_of(lessons)
    assert fit.state == "not placed"
    assert fit.position is not None
    assert "not used until" in fit.words
    assert {fit_of(lessons, f"ap-{n}").state for n in (1, 2, 4, 5, 6)} == {"fine"}


def test_it_is_no_access_point_that_fell_silent(whole: Site, site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
    hall.dead = {2}
    teach(lessons, hall, range(3))
    assert fit_of(lessons, minutes=3).state == "not placed"


def test_a_restart_loses_nothing_and_a_place_measured_since_is_believed(
    lessons: RadioLessons, site: Site, whole: Site
) -> None:
    stored = msgspec.json.decode(msgspec.json.encode(lessons.state()))
    again = RadioLessons(site, "hall")
    again.restore(stored)
    assert msgspec.json.encode(again.state()) == msgspec.json.encode(lessons.state())
    assert fit_of(again) == fit_of(lessons)
    measured = RadioLessons(whole, "hall")
    measured.restore(stored)
    assert fit_of(measured).position is None
    np.testing.assert_array_equal(
        measured._changes.guess.positions[2], next(p.position for p in whole.access_points if p.id == UNKNOWN)
    )


def test_people_who_walk_along_one_line_do_not_say_on_which_side_it_hangs(whole: Site, site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
    for minute in range(6):
        for device, offset in PHONES.items():
            stretch = hall.stretch(device, 60.0 * minute, offset=offset)
            line = np.column_stack([np.clip(stretch.scan_place[:, 0], 1.0, 9.0), np.full(len(stretch.scan_t), 7.0)])
            level = hall.level(line)[np.arange(len(line)), stretch.point] + offset
            lessons.learn(dataclasses.replace(stretch, scan_place=line, level=level))
        lessons.review(T0 + 60.0 * (minute + 1))
    fit = fit_of(lessons)
    assert (fit.state, fit.position) == ("not placed", None)
    assert "known only to within" in fit.words


def test_it_is_looked_for_anew_though_fewer_visits_are_kept_than_at_the_last_look(whole: Site, site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(whole)
    teach(lessons, hall, range(3))
    number, looked = lessons.points.index(UNKNOWN), lessons._placing._looked.copy()
    before = lessons._evidence.count(number)
    assert before > NEEDED
    lessons._evidence.fade(number, T0 + 110.0, 0.02)  # as after a change, or a withdrawal
    teach(lessons, hall, range(3, 5))
    assert lessons._evidence.count(number) < 1.25 * before
    assert lessons._placing._looked[number] > looked[number]
