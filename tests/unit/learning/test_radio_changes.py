"""A moved, weakened or dead access point is noticed, told and learned anew; what is no change is not."""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_site
from numpy.typing import NDArray
from radio_stretches import PHONES, T0, Hall, hall_of, model_of, off_by, rms, teach

from services.learning.proposal import Proposal
from services.learning.radio.doubts import DOUBT, doubted, doubts
from services.learning.radio.lessons import RadioLessons
from services.learning.radio.shifts import Shift
from shared.messages import RadioModelUpdate
from shared.radio import locate_access_point
from shared.site import Site

LATER = range(10, 15)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.fixture(scope="module")
def taught(site: Site) -> tuple[RadioLessons, Hall]:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    teach(lessons, hall, range(10))
    return lessons, hall


@pytest.fixture
def learned(taught: tuple[RadioLessons, Hall]) -> tuple[RadioLessons, Hall]:
    """Ten minutes of lessons, for each test anew."""
    return copy.deepcopy(taught)


def told(lessons: RadioLessons, point: str, now: float = T0 + 900.0) -> tuple[str, str]:
    """Return state and words of an access point; of no other anything is told."""
    fits = {fit.access_point: fit for fit in lessons.fits(now)}
    mine = fits.pop(point)
    assert {fit.state for fit in fits.values()} == {"fine"}, [fit.words for fit in fits.values()]
    return mine.state, mine.words


def after(proposals: list[Proposal]) -> Proposal:
    """Return the last proposal; the first came within four minutes of walking."""
    assert proposals
    assert proposals[0].trained_until <= T0 + 60.0 * (LATER.start + 4)
    return proposals[-1]


def test_an_access_point_that_sends_less_is_told_and_learned(learned: tuple[RadioLessons, Hall], site: Site) -> None:
    lessons, hall = learned
    hall.loss = dataclasses.replace(hall.loss, power_1m=hall.loss.power_1m - np.eye(6)[2] * 8.0)
    proposal = after(teach(lessons, hall, LATER))
    state, words = told(lessons, "ap-3")
    assert state == "changed"
    assert "ap-3 reads" in words
    assert "dB lower" in words
    assert abs(np.median(off_by(model_of(proposal, site, lessons), hall)[:, 2])) < 1.5


def test_what_seems_to_have_changed_is_put_up_for_trial_at_once_and_no_more_once_it_is_live(
    learned: tuple[RadioLessons, Hall], site: Site
) -> None:
    lessons, hall = learned
    assert lessons.alarms(T0 + 630.0) == ()
    hall.loss = dataclasses.replace(hall.loss, power_1m=hall.loss.power_1m - np.eye(6)[2] * 8.0)
    urgent: list[Proposal] = []
    for minute in range(10, 13):
        for device, offset in PHONES.items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
        found = [*lessons.alarms(T0 + 60.0 * (minute + 1)), *lessons.alarms(T0 + 60.0 * (minute + 1) + 1.0)]
        urgent += [one for one in found if one.question]
        assert not lessons.alarms(T0 + 60.0 * (minute + 1) + 10.0)
    assert urgent[0].urgent
    assert urgent[0].trained_until <= T0 + 60.0 * 12
    assert "ap-3 seems to have changed" in urgent[0].reason
    assert abs(np.median(off_by(model_of(urgent[0], site, lessons), hall)[:, 2])) < 2.5
    lessons.activated(urgent[0].model)
    for device, offset in PHONES.items():
        lessons.learn(hall.stretch(device, 60.0 * 13, offset=offset))
    assert not lessons.alarms(T0 + 60.0 * 14)


def urged(lessons: RadioLessons, hall: Hall, minutes: range, site: Site) -> list[tuple[Proposal, NDArray[np.bool_]]]:
    """Let people walk; what is decided without a trial goes live. Returns it, and which access points it doubts."""
    found = []
    for minute in minutes:
        for device, offset in PHONES.items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
        for proposal in lessons.alarms(T0 + 60.0 * (minute + 1)):
            if not proposal.question:
                variance = model_of(proposal, site, lessons).shadowing.variance
                found.append((proposal, (variance >= DOUBT**2).all(axis=(1, 2))))
                lessons.activated(proposal.model)
    return found


def test_an_access_point_that_is_known_to_read_otherwise_is_not_gone_by_until_it_does_again(
    learned: tuple[RadioLessons, Hall], site: Site
) -> None:
    lessons, hall = learned
    before, live = hall.loss, lessons._live.model
    assert live is not None
    positions = before.positions.copy()
    positions[0] = [10.0, 9.0, 2.8]
    hall.loss = dataclasses.replace(before, positions=positions)
    [(proposal, doubted)] = urged(lessons, hall, range(10, 13), site)
    assert proposal.urgent
    assert proposal.gain is not None
    assert proposal.gain > (proposal.margin or 0.0) > 0.0
    assert proposal.reason.startswith("ap-1 no longer reads what was learned")
    assert doubted.tolist() == [True, False, False, False, False, False]
    model = model_of(proposal, site, lessons)
    np.testing.assert_allclose(model.shadowing.mean, live.shadowing.mean, atol=2e-3)
    np.testing.assert_allclose(model.shadowing.variance[1:], live.shadowing.variance[1:], atol=2e-3)
    [fit] = [fit for fit in lessons.fits(T0 + 780.0) if fit.access_point == "ap-1"]
    assert fit.state in ("changed", "moved")
    assert "not gone by" in fit.words
    hall.loss = before
    [(proposal, doubted)] = urged(lessons, hall, range(18, 24), site)
    assert proposal.reason == "ap-1 reads what was learned, after all"
    assert not doubted.any()
    np.testing.assert_allclose(model_of(proposal, site, lessons).shadowing.variance, live.shadowing.variance, atol=2e-3)


def test_a_doubt_that_did_not_go_live_is_not_told_again_at_every_look(learned: tuple[RadioLessons, Hall]) -> None:
    lessons, hall = learned
    positions = hall.loss.positions.copy()
    positions[0] = [10.0, 9.0, 2.8]
    hall.loss = dataclasses.replace(hall.loss, positions=positions)
    doubted_at = []
    for minute in range(10, 14):
        for device, offset in PHONES.items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
        for now in (T0 + 60.0 * (minute + 1), T0 + 60.0 * (minute + 1) + 31.0):
            doubted_at += [now for proposal in lessons.alarms(now) if not proposal.question]
    assert len(doubted_at) == 1


def test_where_more_than_half_read_otherwise_only_half_are_doubted(taught: tuple[RadioLessons, Hall]) -> None:
    lessons, _ = taught
    model = lessons._live.model
    assert model is not None
    shifts = [Shift(point, 12.0, T0, 20.0 + point, np.ones((2, 2)), whole=True, phones=3) for point in range(6)]
    assert [one.point for one in doubts(model, shifts)] == [5, 4, 3]
    assert doubts(doubted(model, shifts[3:]), shifts) == []
    assert doubts(model, [dataclasses.replace(shifts[0], nats=13.0)]) == []
    part = doubted(model, [dataclasses.replace(shifts[0], whole=False)]).shadowing.variance[0] >= DOUBT**2
    assert 0 < part.sum() < part.size


def test_a_moved_access_point_is_found_where_it_hangs_now(learned: tuple[RadioLessons, Hall], site: Site) -> None:
    lessons, hall = learned
    positions = hall.loss.positions.copy()
    positions[0] = [10.0, 9.0, 2.8]
    hall.loss = dataclasses.replace(hall.loss, positions=positions)
    proposal = after(teach(lessons, hall, LATER))
    state, words = told(lessons, "ap-1")
    assert state == "moved"
    assert "was it moved" in words
    [fit] = [fit for fit in lessons.fits(T0 + 900.0) if fit.access_point == "ap-1"]
    assert fit.position is not None
    assert fit.position_error is not None
    assert fit.position_error < 3.0
    assert np.hypot(fit.position[0] - 10.0, fit.position[1] - 9.0) < 3.0
    model = model_of(proposal, site, lessons)
    np.testing.assert_allclose(model.path_loss.positions[0, :2], fit.position[:2], atol=1e-6)
    assert isinstance(proposal.model, RadioModelUpdate)
    assert proposal.model.model is not None
    assert proposal.model.model.located == ["ap-1"]
    assert rms(off_by(model, hall)[:, 0]) < 3.0


def test_a_wall_is_told_as_something_in_part_of_the_area(learned: tuple[RadioLessons, Hall], site: Site) -> None:
    lessons, hall = learned
    before = hall.more
    shaded = np.eye(6)[3] * -9.0
    hall.more = lambda places: before(places) + (places[:, :1] < 11.0) * shaded
    proposal = after(teach(lessons, hall, LATER))
    state, words = told(lessons, "ap-4")
    assert state == "changed"
    assert "is there a new wall" in words
    assert rms(off_by(model_of(proposal, site, lessons), hall)[:, 3]) < 3.5  # 4.5 where the wall is not known of


def test_a_dead_access_point_is_told(learned: tuple[RadioLessons, Hall], site: Site) -> None:
    lessons, hall = learned
    hall.dead = {4}
    teach(lessons, hall, range(10, 14))
    state, words = told(lessons, "ap-5", T0 + 840.0)
    assert state == "silent"
    assert "does it have power" in words


def test_one_phone_that_reads_an_access_point_otherwise_changes_nothing(learned: tuple[RadioLessons, Hall]) -> None:
    lessons, hall = learned
    for minute in LATER:
        for device, offset in PHONES.items():
            stretch = hall.stretch(device, 60.0 * minute, offset=offset)
            lied = stretch.level - 15.0 * (stretch.point == 1) * (device == "a")
            lessons.learn(dataclasses.replace(stretch, level=lied))
        assert not lessons.alarms(T0 + 60.0 * (minute + 1))
    assert told(lessons, "ap-2")[0] == "fine"


def test_nothing_is_told_of_a_hall_in_which_nothing_changes(learned: tuple[RadioLessons, Hall], site: Site) -> None:
    fresh = RadioLessons(site, "hall"), hall_of(site, 20)
    for (lessons, hall), minutes in ((learned, range(10, 15)), (fresh, range(12))):
        teach(lessons, hall, minutes)
        assert {fit.state for fit in lessons.fits(T0 + 60.0 * minutes.stop)} == {"fine"}


def test_a_place_is_told_with_an_honest_error(site: Site) -> None:
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        there = rng.uniform((2.0, 2.0), (22.0, 12.0))
        places = rng.uniform((1.0, 1.0), (23.0, 13.0), (60, 2))
        distance = np.sqrt(((places - there) ** 2).sum(axis=1) + 1.7**2)
        level = -42.0 - 22.0 * np.log10(distance) + rng.normal(0.0, 4.0, 60)
        found = locate_access_point(
            places, level, np.full(60, 1.0), np.zeros(2), np.array([24.0, 14.0]),
            height=2.8, power=-40.0, exponent=2.2, asked=np.array([0.3, 0.3]),
        )  # fmt: skip
        off = found.place - there
        squares.append(float(off @ np.linalg.solve(found.covariance, off)))
        assert found.error < 4.0
    assert np.mean(squares) / 2.0 < 2.0
