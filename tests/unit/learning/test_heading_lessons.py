"""Heading biases from tracks: found where walks agree, left alone where they do not."""

import math

import msgspec
import numpy as np
import pytest
from walked_stretch import walked

from services.learning.walking.heading_lessons import HeadingLessons, bias_of
from shared.messages import HeadingModel


def taught(bias: float, between: float, seed: int, walks: int = 12) -> HeadingLessons:
    rng = np.random.default_rng(seed)
    lessons = HeadingLessons("hall")
    for k in range(walks):
        turned = math.radians(bias) + rng.normal(0.0, math.radians(between))
        lessons.learn(walked(rng, 100.0 * k, turned=turned, walk=k))
    return lessons


@pytest.mark.parametrize("seed", range(5))
def test_a_phone_that_is_always_turned_is_turned_back(seed: int) -> None:
    [proposal] = taught(20.0, 8.0, seed).propose(2000.0, 1500.0)
    model = proposal.model
    assert isinstance(model, HeadingModel)
    assert math.degrees(model.bias) == pytest.approx(20.0, abs=7.0)
    assert 6.0 < math.degrees(math.sqrt(model.variance)) < 14.0
    assert proposal.evidence["error after"] < proposal.evidence["error before"]


def test_a_phone_that_differs_from_walk_to_walk_alone_is_left_alone() -> None:
    assert sum(len(taught(0.0, 10.0, seed).propose(2000.0, 1500.0)) for seed in range(30)) <= 1


def test_what_is_taken_off_already_is_not_taken_off_again() -> None:
    lessons = taught(20.0, 8.0, 1)
    [proposal] = lessons.propose(2000.0, 1500.0)
    lessons.activated(proposal.model)
    assert lessons.propose(2001.0, 1500.0) == []
    rng = np.random.default_rng(9)
    before = lessons.lesson("phone")["heading_bias"]
    for k in range(10):
        lessons.learn(walked(rng, 3000.0 + 100.0 * k, turned=rng.normal(0.0, 0.1), walk=100 + k))
    assert lessons.lesson("phone")["heading_bias"] == pytest.approx(before, abs=math.radians(4.0))


def test_what_was_said_before_a_model_went_live_is_not_taken_for_what_was_said_under_it() -> None:
    lessons = taught(20.0, 2.0, 1)
    [proposal] = lessons.propose(2000.0, 1500.0)
    lessons.activated(msgspec.structs.replace(proposal.model, t=3000.0))
    before, rng = lessons.state()["devices"]["phone"]["rows"], np.random.default_rng(9)
    lessons.learn(walked(rng, 2950.0, turned=math.radians(20.0), walk=100))
    assert lessons.state()["devices"]["phone"]["rows"] == before
    lessons.learn(walked(rng, 3000.0, turned=0.0, walk=100))
    assert len(lessons.state()["devices"]["phone"]["rows"]) == len(before) + 1


@pytest.mark.parametrize(("after", "regretted"), [(20.0, False), (0.0, True)])
def test_walks_that_came_after_tell_whether_the_bias_before_was_better(after: float, regretted: bool) -> None:
    lessons = taught(20.0, 8.0, 1)
    [proposal] = lessons.propose(2000.0, 1500.0)
    former = HeadingModel(t=0.0, device="phone", version=0, bias=0.0, variance=3.0)
    assert lessons.regret(former, 2000.0) is None
    lessons.activated(proposal.model)
    assert lessons.regret(former, 2000.0) is None, "nobody has walked since"
    rng = np.random.default_rng(9)
    assert isinstance(proposal.model, HeadingModel)
    for k in range(8):
        turned = math.radians(after) - proposal.model.bias + rng.normal(0.0, 0.1)  # the gateway took the bias off
        lessons.learn(walked(rng, 3000.0 + 100.0 * k, turned=turned, walk=100 + k))
    told = lessons.regret(former, 2000.0)
    assert told is not None
    assert (told[0] > told[1]) is regretted


def test_biases_either_side_of_half_a_turn_do_not_cancel_and_flips_are_outliers() -> None:
    runs = np.full(8, 3.0)
    assert bias_of(np.full(8, math.radians(20.0)), runs).mean == pytest.approx(math.radians(20.0), abs=0.06)
    lessons = taught(0.0, 5.0, 1)
    rng = np.random.default_rng(2)
    for k in range(4):
        lessons.learn(walked(rng, 5000.0 + 100.0 * k, turned=math.pi, walk=50 + k))
    assert abs(lessons.lesson("phone")["heading_bias"] or 0.0) < math.radians(5.0)


def test_what_was_learned_survives_and_is_forgotten_on_request() -> None:
    lessons = taught(20.0, 8.0, 1)
    other = HeadingLessons("hall")
    other.restore(msgspec.json.decode(msgspec.json.encode(lessons.state())))
    assert other.lesson("phone") == lessons.lesson("phone")
    other.forget("phone")
    assert other.devices == []
    with pytest.raises(ValueError, match="heading lessons"):
        lessons.restore({"area": "hall", "devices": {"phone": {"rows": [[1.0]]}}})
    assert lessons.devices == ["phone"]
