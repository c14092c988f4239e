"""The radio lessons: what they learn, propose, forget and keep, and what cannot wreck them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import make_site
from radio_stretches import PHONES, T0, hall_of, model_of, off_by, rms, teach

from services.learning.radio.lessons import RadioLessons
from shared.messages import RadioModelFile, RadioModelUpdate
from shared.radio import PathLoss
from shared.site import Site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return make_site(tmp_path)


def test_what_is_proposed_is_near_to_the_truth_and_says_what_it_rests_on(site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    proposals = teach(lessons, hall, range(6))
    assert proposals
    last = proposals[-1]
    assert (last.kind, last.subject, last.area) == ("radio", "hall", "hall")
    assert rms(off_by(model_of(last, site, lessons), hall)) < 1.6
    assert last.evidence["residual"] < last.evidence["residual_active"] or len(proposals) > 1
    question = msgspec.json.decode(last.question)
    assert question["kind"] == "radio"
    assert question["since"] == last.trained_until
    assert msgspec.convert(question["model"], RadioModelFile).access_points == list(lessons.points)
    assert lessons.offsets()["a"] - lessons.offsets()["b"] == pytest.approx(5.0, abs=1.2)


def test_a_proposal_waits_for_new_evidence_that_is_spread_and_uses_none_that_is_newer_than_allowed(site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    assert not lessons.propose(T0 + 60.0, T0 + 60.0)
    for minute in range(5):
        for device in PHONES:
            lessons.learn(hall.stretch(device, 60.0 * minute, still=True))
    assert not lessons.propose(T0 + 300.0, T0 + 300.0), "everybody stood"
    for minute in range(5, 8):
        for device, offset in PHONES.items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
    assert not lessons.propose(T0 + 480.0, T0 + 300.0), "nothing that may teach is new"
    [proposal] = lessons.propose(T0 + 490.0, T0 + 480.0)
    assert proposal.trained_until == T0 + 480.0
    assert not lessons.propose(T0 + 900.0, T0 + 900.0), "nobody walked since"


def test_a_phone_that_invents_readings_hardly_moves_the_model(site: Site) -> None:
    errors = []
    for liar in (False, True):
        lessons, hall = RadioLessons(site, "hall"), hall_of(site)
        for minute in range(6):
            for device, offset in PHONES.items():
                lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
            if liar:
                told = hall.stretch("liar", 60.0 * minute)
                invented = np.random.default_rng(minute).uniform(-100.0, -20.0, len(told.level))
                lessons.learn(dataclasses.replace(told, level=invented))
        [proposal] = lessons.propose(T0 + 360.0, T0 + 360.0)
        errors.append(rms(off_by(model_of(proposal, site, lessons), hall)))
    assert errors[1] < 1.25 * errors[0]


def test_swapped_identities_and_a_single_phone_leave_a_model_better_than_the_site_file(site: Site) -> None:
    hall = hall_of(site)
    file = PathLoss.of([point for point in site.access_points if point.floor == "ground"])
    places = np.random.default_rng(9).uniform((1.0, 1.0), (23.0, 13.0), (200, 2))
    beside = file.rssi(places) - hall.level(places)
    unlearned = rms(beside - np.median(beside))
    swapped = RadioLessons(site, "hall")
    for minute in range(8):
        told = [hall.stretch(device, 60.0 * minute, offset=offset) for device, offset in PHONES.items()]
        wrong = minute in (2, 5)
        for number, stretch in enumerate(told):
            other = told[(number + 1) % 3]
            swapped.learn(dataclasses.replace(stretch, level=other.level) if wrong else stretch)
    [proposal] = swapped.propose(T0 + 480.0, T0 + 480.0)
    assert rms(off_by(model_of(proposal, site, swapped), hall)) < 0.7 * unlearned
    alone = RadioLessons(site, "hall")
    last = teach(alone, hall, range(8), {"a": 2.0})[-1]
    assert rms(off_by(model_of(last, site, alone), hall)) < 0.7 * unlearned


def test_an_erased_device_leaves_nothing_of_its_own(site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    teach(lessons, hall, range(4))
    lessons.forget("b")
    assert "b" not in lessons.offsets()
    assert b'"b"' not in msgspec.json.encode(lessons.state())
    without = RadioLessons(site, "hall")
    other = hall_of(site)
    for minute in range(4):
        for device, offset in PHONES.items():
            stretch = other.stretch(device, 60.0 * minute, offset=offset)
            if device != "b":
                without.learn(stretch)
    assert len(lessons._evidence) == len(without._evidence)


def test_it_goes_on_after_a_restart_as_if_there_had_been_none(site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    teach(lessons, hall, range(5))
    stored = msgspec.json.decode(msgspec.json.encode(lessons.state()))
    again = RadioLessons(site, "hall")
    again.restore(stored)
    assert msgspec.json.encode(again.state()) == msgspec.json.encode(lessons.state())
    now = T0 + 300.0
    assert [fit.readings for fit in again.fits(now)] == [fit.readings for fit in lessons.fits(now)]
    for field, value in (("evidence", {"rows": "???"}), ("offsets", 3), ("changes", {}), ("taught", "soon")):
        fresh = RadioLessons(site, "hall")
        with pytest.raises(ValueError, match="hall"):
            fresh.restore({**stored, field: value})
        assert msgspec.json.encode(fresh.state()) == msgspec.json.encode(RadioLessons(site, "hall").state())


def test_readings_are_held_against_the_active_model(site: Site) -> None:
    lessons, hall = RadioLessons(site, "hall"), hall_of(site)
    assert {fit.state for fit in lessons.fits(T0)} == {"few readings"}
    for minute in range(5):
        for device, offset in PHONES.items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
    [proposal] = lessons.propose(T0 + 300.0, T0 + 300.0)
    before = lessons.fits(T0 + 300.0)
    assert isinstance(proposal.model, RadioModelUpdate)
    lessons.activated(proposal.model)
    after = lessons.fits(T0 + 300.0)
    assert {fit.state for fit in after} == {"fine"}
    assert sum(abs(fit.bias or 0.0) for fit in after) < 0.5 * sum(abs(fit.bias or 0.0) for fit in before)
    assert after[0].power_1m == pytest.approx(hall.loss.power_1m[0], abs=3.5)
    lessons.activated(RadioModelUpdate(t=T0 + 301.0, area="hall", version=2, model=None))
    assert [fit.bias for fit in lessons.fits(T0 + 301.0)] == [fit.bias for fit in before]
