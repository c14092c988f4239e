"""Which stretches may teach: right ones may; swapped, invented, undecidable ones may not, and are told why."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from unit.learning.walking_crowd import POINTS, Crowd

from services.learning.tracks.quality import QualityJudge


@functools.cache
def _lessons() -> dict[str, Any]:
    first = Crowd(0)
    judge = QualityJudge(POINTS)
    for minute in range(4):
        crowd = Crowd(minute)
        crowd.bias = first.bias
        for person in range(6):
            judge.judge(crowd.stretch(person, start=60.0 * minute), first.radio)
    return judge.state()


def _taught() -> tuple[QualityJudge, Crowd]:
    """A judge that has seen some minutes of a hall, and the people of the next minute."""
    first, judge = Crowd(0), QualityJudge(POINTS)
    judge.restore(_lessons())
    crowd = Crowd(100)
    crowd.bias, crowd.radio = first.bias, first.radio
    return judge, crowd


def test_right_names_may_teach_and_their_quality_is_the_sum_per_second() -> None:
    judge, crowd = _taught()
    verdicts = [judge.judge(crowd.stretch(person), crowd.radio) for person in range(8)]
    assert sum(verdict.good for verdict in verdicts) >= 7, verdicts
    for verdict in verdicts:
        assert verdict.rate == pytest.approx(verdict.printed / 60.0)
        assert verdict.good == (verdict.reason == "")
    lessons = judge.lessons()
    assert lessons.good + sum(lessons.refused.values()) == 32
    assert lessons.threshold is not None
    assert lessons.quality is not None


def test_what_cameras_say_is_part_of_the_printed_sum() -> None:
    crowd = Crowd(5)
    low, high = (crowd.stretch(0, sight=sight, readings=crowd.readings(0)) for sight in (0.0, 1.0))
    high = dataclasses.replace(low, sight=high.sight)
    first, second = (QualityJudge(POINTS).judge(stretch, crowd.radio) for stretch in (low, high))
    assert second.printed - first.printed == pytest.approx(len(low.t))


def test_a_name_on_somebody_elses_track_is_refused() -> None:
    judge, crowd = _taught()
    for person in range(8):
        verdict = judge.judge(crowd.stretch(person, (person + 1) % 8), crowd.radio)
        assert not verdict.good
        assert not verdict.doubtful
        assert "fits another person better" in verdict.reason or "fit another person better" in verdict.reason


def test_radio_of_another_phone_is_refused_though_the_steps_fit() -> None:
    judge, crowd = _taught()
    verdicts = [
        judge.judge(crowd.stretch(person, readings=crowd.readings((person + 3) % 8)), crowd.radio)
        for person in range(8)
    ]
    assert sum(verdict.good for verdict in verdicts) == 0, verdicts


def test_a_name_that_moves_to_another_person_in_between_is_refused() -> None:
    judge, crowd = _taught()
    for person in range(8):
        path = crowd.paths[person].copy()
        path[len(path) // 2 :] = crowd.paths[(person + 1) % 8, len(path) // 2 :]
        assert not judge.judge(crowd.stretch(person, path=path), crowd.radio).good


def test_people_who_all_stand_cannot_be_told_apart() -> None:
    judge, _ = _taught()
    crowd = Crowd(200, still=True)
    crowd.bias = np.random.default_rng(9).normal(0.0, 6.0, POINTS)  # radio that says little of where
    quiet = [dataclasses.replace(crowd.stretch(person), point=np.zeros(488, np.int64)) for person in range(8)]
    verdicts = [judge.judge(stretch, Crowd(0).radio) for stretch in quiet]
    assert not any(verdict.good for verdict in verdicts)


@pytest.mark.parametrize("invention", ["constant", "random", "place", "yesterday"])
def test_invented_radio_is_refused(invention: str) -> None:
    judge, crowd = _taught()
    rng = np.random.default_rng(3)
    t, point, level = crowd.readings(0)
    match invention:
        case "constant":
            level = np.full(len(level), -60.0)
        case "random":
            level = np.round(rng.uniform(-90.0, -40.0, len(level)))
        case "place":
            level = np.round(crowd.radio.rssi(np.array([[2.0, 12.0]]))[0][point] + rng.normal(0.0, 2.0, len(point)))
        case _:
            level = crowd.readings(5)[2]
            level = level.reshape(-1, POINTS)[::-1].ravel()
    for person in range(4):
        verdict = judge.judge(crowd.stretch(person, readings=(t, point, level)), crowd.radio)
        assert not verdict.good, (invention, person)


def test_a_phone_without_radio_a_short_or_an_unseen_stretch_is_refused_in_plain_words() -> None:
    judge, crowd = _taught()
    none = (np.zeros(0), np.zeros(0, np.int64), np.zeros(0))
    assert judge.judge(crowd.stretch(0, readings=none), crowd.radio).reason == "the phone told no radio"
    unseen = dataclasses.replace(crowd.stretch(0), seen=np.zeros(len(crowd.t), np.bool_))
    assert judge.judge(unseen, crowd.radio).reason == "cameras saw too little of the person"
    brief = Crowd(7, seconds=5)
    told = judge.judge(brief.stretch(0), crowd.radio)
    assert told.reason == "too short to judge"
    assert told.doubtful


def test_a_short_stretch_of_a_phone_that_was_wrong_too_often_is_not_even_in_doubt() -> None:
    judge, crowd = _taught()
    t, point, level = crowd.readings(0)
    for _ in range(8):
        judge.judge(crowd.stretch(0, readings=(t, point, np.full(len(level), -60.0))), crowd.radio)
    assert not judge.judge(Crowd(7, seconds=5).stretch(0), crowd.radio).doubtful


def test_one_phone_alone_in_the_hall_may_teach() -> None:
    judge, _ = _taught()
    crowd = Crowd(301, people=1)
    first = Crowd(0)
    crowd.bias = first.bias
    assert judge.judge(crowd.stretch(0), first.radio).good


def test_a_judge_goes_on_from_its_state_and_refuses_a_state_of_another_hall() -> None:
    judge, crowd = _taught()
    state = judge.state()
    again = QualityJudge(POINTS)
    again.restore(state)
    stretch = crowd.stretch(0)
    assert again.judge(stretch, crowd.radio) == judge.judge(stretch, crowd.radio)
    with pytest.raises(ValueError, match="access points"):
        QualityJudge(POINTS - 1).restore(state)
    with pytest.raises(ValueError, match="not a state"):
        again.restore({"model": ""})
    assert again.state() == judge.state()
