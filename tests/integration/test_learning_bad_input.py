"""All of learning at once on what it must not learn from, and whom it must forget: nothing of it goes live, and plain
words say why.

Every learner, the judge of stretches, the gate and the store are the real ones; candidates are tried by fusion's own
``rescore`` where one gets so far.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fusion_world import make_site
from learning_hall import T0, Hall, Run, learn, with_radio_of
from msgspec.json import encode
from msgspec.structs import replace
from traces import traces

from services.learning.tracks.verdict import Verdict
from shared.erased import Erased
from shared.messages import DetectionFrame, Erasure, Message, RadioScan, TrackFrame
from shared.site import Site

LATELY = "this phone's radio was wrong too often lately"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return make_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def messages(site: Site) -> list[Message]:
    return Hall(site).messages()


@pytest.fixture(scope="module")
def faulty(site: Site, messages: list[Message]) -> Run:
    """From the second minute on the access point ap-5 is dead; the camera west looks at a wall."""

    def change(message: Message) -> Message:
        if isinstance(message, RadioScan) and message.t > T0 + 80.0:
            return replace(
                message,
                access_point=[name for name in message.access_point if name != "ap-5"],
                rssi=[level for name, level in zip(message.access_point, message.rssi, strict=True) if name != "ap-5"],
            )
        if isinstance(message, DetectionFrame) and message.camera == "west":
            return replace(message, **{column: [] for column in message.columns()})
        if isinstance(message, TrackFrame):
            return replace(message, sources=[["east"]] * len(message.x))
        return message

    def redetect(_: str, options: Mapping[str, float]) -> Mapping[str, Any]:
        empty: list[dict[str, Any]] = [{"x": []}, {"x": []}]
        told = {
            "frames": empty,
            "since": 1.0,
            "until": 60.0,
            "alignment": 0,
        }
        return {**told, "options": {"learning_rate": 0.01, **options}}

    return learn(site, messages, change, redetect=redetect)


def test_phones_whose_radio_is_swapped_teach_nothing_and_the_others_do(site: Site, messages: list[Message]) -> None:
    run = learn(site, messages, with_radio_of({"phone-0": "phone-1", "phone-1": "phone-0"}))
    assert run.teachers() == {"phone-2", "phone-3"}
    assert run.refused().keys() == {"the phone's radio fits another person better", LATELY}
    assert run.loop.words("hall").startswith("waits: busy")
    assert run.live == []


def test_a_model_that_wrong_names_taught_is_refused_by_the_gate(site: Site, messages: list[Message]) -> None:
    def change(message: Message) -> Message:
        """Let every track bear its neighbour's name."""
        if isinstance(message, TrackFrame):
            return replace(message, device=message.device[1:] + message.device[:1])
        return message

    run = learn(site, messages, change, tried=True, judge=lambda _: Verdict(1.0, 1.0, good=True))
    assert len(run.teachers()) == 4
    assert len(run.asked) == 1
    [reason] = run.reasons("radio")
    assert reason.startswith("refused: people walked where the radio is to be learned: wins by -0.")
    assert "not more than the" in reason
    assert run.live == []


def test_a_phone_that_invents_radio_teaches_nothing_and_is_told_of(site: Site, messages: list[Message]) -> None:
    rng = np.random.default_rng(3)

    def invented(message: Message) -> Message:
        if isinstance(message, RadioScan) and message.device == "phone-0":
            return replace(message, rssi=[-40.0] * len(message.rssi))
        if isinstance(message, RadioScan) and message.device == "phone-1":
            return replace(message, rssi=rng.uniform(-90.0, -30.0, len(message.rssi)).tolist())
        return message

    run = learn(site, messages, invented)
    assert run.teachers() == {"phone-2", "phone-3"}
    assert run.refused().keys() == {
        "the phone's readings are steadier than any radio's",
        "the phone's readings jump more than any radio's",
        LATELY,
    }
    assert run.live == []


def test_one_phone_alone_needs_twice_as_much(site: Site) -> None:
    run = learn(site, Hall(site, people=3, phones=1).messages(), tried=True)
    assert run.teachers() == {"phone-0"}
    assert len(run.asked) == 1
    assert run.loop.words("hall").startswith("waits: too little held-out data")
    assert "allowed: 120 or more" in run.loop.words("hall")
    assert (run.live, run.reasons("radio")) == ([], [])


def test_people_who_all_stand_teach_nothing(site: Site) -> None:
    run = learn(site, Hall(site, still=True, seconds=150).messages())
    assert (run.asked, run.live, run.loop.store.history()) == ([], [], [])
    assert run.refused().keys() == {"radio and steps do not tell who of several people it is"}


def test_a_dead_access_point_is_told_and_changes_no_other(faulty: Run) -> None:
    points = {fit.access_point: fit for fit in faulty.loop.report(faulty.end).areas[0].access_points}
    assert points.pop("ap-5").words.startswith("access point ap-5 has not been heard since")
    assert {fit.state for fit in points.values()} == {"fine"}
    assert faulty.live == []


def test_a_camera_turned_to_a_wall_keeps_its_options_and_is_told_of(faulty: Run) -> None:
    assert faulty.reasons("detector") == []
    told = {one.camera: one.words for one in faulty.loop.report(faulty.end).cameras}
    wall = "camera west sees nobody in its last pictures, whatever its options: does it look into the room?"
    assert told["west"] == wall
    assert "sees nobody" not in told["east"]


def test_nothing_of_a_phone_stays_once_its_owner_withdrew(site: Site, messages: list[Message]) -> None:
    run = learn(site, [message for message in messages if message.t < T0 + 90.0])
    loop = run.loop
    assert len(traces(loop, "phone-2", (Erased,))) > 5
    loop.save(run.end)
    assert any(b"phone-2" in state for state in loop.store.states.read().values())
    loop.take(Erasure(t=run.end, device="phone-2"))
    assert traces(loop, "phone-2", (Erased,)) == []
    loop.look(run.end + 1.0)
    assert not any(b"phone-2" in state for state in loop.store.states.read().values())
    assert b"phone-2" not in encode(loop.report(run.end))
    for message in messages:
        if message.t >= T0 + 90.0 and message.t < T0 + 100.0:
            loop.take(message)
    assert traces(loop, "phone-2", (Erased,)) == [], "what is still under way brings nobody back"
