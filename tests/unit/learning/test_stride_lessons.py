"""Stride lines from tracks: right to a few per cent, used only where they predict better, forgotten as asked."""

import dataclasses
import json

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from walked_stretch import walked

from services.learning.walking.runs import STEPS, runs_of
from services.learning.walking.stride_lessons import StrideLessons
from shared.messages import StrideModel


def taught(length: float, published: float, seed: int = 1, stretches: int = 8) -> StrideLessons:
    rng = np.random.default_rng(seed)
    lessons = StrideLessons("hall")
    for k in range(stretches):
        cadence = float(rng.normal(1.7, 0.05))
        lessons.learn(walked(rng, 100.0 * k, length=length, cadence=cadence, published=published))
    return lessons


def test_the_way_of_a_run_is_that_of_its_steps() -> None:
    runs = runs_of(walked(np.random.default_rng(0), length=0.65, cadence=1.6, irregular=0.0))
    assert len(runs.t) >= 4
    assert runs.way.mean() == pytest.approx(0.65, rel=0.03)
    assert runs.cadence.mean() == pytest.approx(1.6, rel=0.03)


def test_steps_that_no_camera_saw_teach_nothing() -> None:
    stretch = walked(np.random.default_rng(0))
    unseen = dataclasses.replace(stretch, seen=np.zeros(len(stretch.t), np.bool_))
    assert not len(runs_of(unseen).t)


@settings(max_examples=15, deadline=None)
@given(st.floats(0.45, 0.9), st.integers(0, 1000))
def test_a_line_is_right_within_four_per_cent_at_the_cadences_walked(length: float, seed: int) -> None:
    lesson = taught(length, 0.7, seed).lesson("phone")
    assert float(lesson["slope"] or 0) * 1.7 + float(lesson["offset"] or 0) == pytest.approx(length, rel=0.04)


def test_a_person_who_was_taken_wrongly_gets_a_line_and_fusion_is_asked() -> None:
    [proposal] = taught(0.55, 0.7).propose(2000.0, 1000.0)
    model = proposal.model
    assert isinstance(model, StrideModel)
    assert model.slope * 1.7 + model.offset == pytest.approx(0.55, rel=0.04)
    assert 0.03**2 <= model.scale_variance < 0.06**2
    question = json.loads(proposal.question)
    assert question["kind"] == "stride"
    assert question["scale"]["phone"] == pytest.approx(0.55 / 0.7, rel=0.04)
    assert (proposal.gain or 0.0) > (proposal.margin or 0.0) > 0.0
    assert "shorter" in proposal.reason


def test_a_person_whose_trial_walks_were_right_keeps_that_line() -> None:
    assert all(not taught(0.6, 0.6, seed).propose(2000.0, 1000.0) for seed in range(10))


def test_steady_walks_have_no_r_squared_and_are_learned_all_the_same() -> None:
    rng = np.random.default_rng(3)
    ours, study = StrideLessons("hall"), StrideLessons("hall", least_r2=0.5)
    for k in range(8):
        stretch = walked(rng, 100.0 * k, length=0.55, cadence=1.7)
        ours.learn(stretch)
        study.learn(stretch)
    [proposal] = ours.propose(2000.0, 1000.0)
    assert proposal.evidence["r2"] < 0.5
    assert study.propose(2000.0, 1000.0) == []


def test_a_line_in_use_is_not_proposed_again_and_nothing_new_is_not_looked_at_twice() -> None:
    lessons = taught(0.55, 0.7)
    assert lessons.propose(1000.0, 50.0) == []
    [proposal] = lessons.propose(2000.0, 1000.0)
    assert lessons.propose(2001.0, 1000.0) == []
    lessons.activated(msgspec.structs.replace(proposal.model, version=1))
    assert lessons.propose(2002.0, 1000.0) == []
    assert lessons.lesson("phone")["used"] is True
    lessons.activated(StrideModel(t=0.0, device="phone", version=2, slope=0.0, offset=0.0, scale_variance=0.0))
    assert lessons.lesson("phone")["used"] is False
    assert len(lessons.propose(2003.0, 1000.0)) == 1


def test_steps_that_came_after_tell_whether_the_line_before_was_better() -> None:
    lessons = taught(0.6, 0.6)
    wrong, right = (
        StrideModel(t=1000.0, device="phone", version=n, slope=0.0, offset=length, scale_variance=0.01)
        for n, length in ((2, 0.8), (1, 0.6))
    )
    anybody = StrideModel(t=0.0, device="phone", version=0, slope=0.0, offset=0.0, scale_variance=0.0)
    lessons.activated(wrong)
    assert lessons.regret(right, 1000.0) is None, "nobody has walked since"
    told = lessons.regret(right, 0.0)
    assert told is not None
    assert told[0] > told[1] > 0.0
    lessons.activated(right)
    told = lessons.regret(wrong, 0.0)
    assert told is not None
    assert told[0] < 0.0
    assert lessons.regret(anybody, 0.0) is None


def test_few_steps_teach_nothing() -> None:
    assert taught(0.5, 0.7, stretches=3).propose(2000.0, 1000.0) == []
    assert taught(0.5, 0.7).propose(2000.0, 50.0) == []  # all but one stretch are newer than what may teach


def test_what_was_learned_survives_and_is_forgotten_on_request() -> None:
    lessons = taught(0.55, 0.7)
    kept = msgspec.json.decode(msgspec.json.encode(lessons.state()))
    other = StrideLessons("hall")
    other.restore(kept)
    assert other.lesson("phone") == lessons.lesson("phone")
    assert [p.model for p in other.propose(2000.0, 1000.0)] == [p.model for p in lessons.propose(2000.0, 1000.0)]
    other.forget("phone")
    assert other.devices == []
    assert "phone" not in str(other.state())
    for wrong in ({}, {**kept, "devices": 3}, {**kept, "devices": {"phone": {"rows": [[1.0]]}}}):
        with pytest.raises(ValueError, match="stride lessons"):
            lessons.restore(wrong)
    assert lessons.devices == ["phone"]


def test_memory_is_bounded() -> None:
    rng = np.random.default_rng(0)
    lessons = StrideLessons("hall")
    for k in range(120):
        lessons.learn(walked(rng, 100.0 * k))
    assert int(lessons.lesson("phone")["steps"] or 0) <= 200 * STEPS
