"""Trial walks tell how somebody walks, or say why they do not."""

from typing import Any

import msgspec
import pytest
from trial_walking import trial_walk

from services.gateway.devices.trial_walks import learn_from
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits
from services.gateway.protocol import TrialWalks

SLOW, QUICK = trial_walk(1, 1.1, 9.0), trial_walk(1, 1.6, 9.0)


def learn(*walks: dict[str, Any]) -> Any:
    return learn_from(msgspec.convert({"walks": list(walks)}, TrialWalks), Limits())


@pytest.mark.parametrize("person", range(4))
def test_two_walks_tell_the_lengths_of_steps_at_a_pace_between_them(person: int) -> None:
    slow, quick, between = (trial_walk(person, speed, 9.0) for speed in (1.1, 1.6, 1.35))
    walker, found = learn(slow.body(steps=slow.steps), quick.body())
    assert [each.steps for each in found] == pytest.approx([slow.steps, quick.steps], abs=1)
    assert [each.cadence for each in found] == pytest.approx([slow.cadence, quick.cadence], abs=0.15)
    length = walker.slope * between.cadence + walker.offset
    assert length == pytest.approx(between.distance / between.steps, rel=0.09)  # the thesis: 4 to 9 %
    assert 0.0 < walker.scale_variance < 0.1**2
    assert 9.9 <= walker.mean < walker.peak <= 14.0


def test_one_walk_gives_thresholds_and_no_line() -> None:
    walker, found = learn(SLOW.body(steps=SLOW.steps))
    assert walker.peak is not None
    assert (walker.slope, walker.offset, walker.scale_variance) == (None, None, None)
    assert len(found) == 1


def test_start_and_end_on_the_plan_stand_for_the_distance() -> None:
    body = SLOW.body(steps=SLOW.steps)
    _, (found,) = learn(body)
    del body["distance"]
    _, (same,) = learn(body | {"start": [3.0, 4.0], "end": [3.0, 4.0 + SLOW.distance]})
    assert same.step_length == pytest.approx(found.step_length)


def with_hole(imu: dict[str, list[float]]) -> dict[str, list[float]]:
    return {name: column[:300] + column[400:] for name, column in imu.items()}


FIRST = SLOW.body(steps=SLOW.steps)
CASES: list[tuple[list[dict[str, Any]], str, str]] = [
    ([SLOW.body()], "walks[0].steps", "is missing"),
    ([FIRST | {"distance": None}], "walks[0].distance", "is missing"),
    ([FIRST | {"distance": 1.0}], "walks[0].distance", "is out of range"),
    ([FIRST | {"distance": None, "start": [0, 0], "end": [500, 0]}], "walks[0].distance", "is out of range"),
    ([FIRST | {"steps": 0}], "walks[0].steps", "is no count of steps"),
    ([FIRST | {"steps": 40}], "walks[0]", "no step thresholds"),
    ([FIRST | {"steps": SLOW.steps - 6}], "walks[0]", "no step thresholds"),
    ([FIRST | {"imu": SLOW.imu | {"ax": [1.0]}}], "walks[0].imu.ax", "columns differ"),
    ([FIRST | {"imu": {name: [] for name in SLOW.imu}}], "walks[0].imu.t", "wrong number"),
    ([FIRST | {"imu": with_hole(SLOW.imu)}], "walks[0].imu.t", "has holes"),
    ([FIRST, QUICK.body(steps=40)], "walks[1].steps", "is far from what was detected"),
    ([FIRST, SLOW.body()], "walks[1]", "gives no stride line"),
    ([FIRST, QUICK.body() | {"distance": 4.0}], "walks[1]", "gives no stride line"),
]


@pytest.mark.parametrize(("walks", "field", "problem"), CASES, ids=[f"{case[1]} {case[2]}" for case in CASES])
def test_walks_that_tell_nothing_are_refused_by_name(walks: list[dict[str, Any]], field: str, problem: str) -> None:
    with pytest.raises(RequestError) as caught:
        learn(*walks)
    refusal = caught.value.reply.detail[0]
    assert caught.value.status == 422
    assert refusal.field == field
    assert refusal.problem.startswith(problem)


def test_two_walks_at_one_pace_are_told_so() -> None:
    with pytest.raises(RequestError, match="gives no stride line") as caught:
        learn(FIRST, SLOW.body())
    assert "0.15 apart or more" in caught.value.reply.detail[0].found


def test_somebody_who_stands_has_not_walked() -> None:
    still = {name: [column[0]] * 500 for name, column in SLOW.imu.items()}
    still["t"] = [100.0 + i / 50 for i in range(500)]
    with pytest.raises(RequestError, match="no step thresholds"):
        learn({"imu": still, "distance": 10.0, "steps": 14})
