"""What a restart must not lose: other areas' lessons and what is not understood; and what must end: absent phones'."""

from __future__ import annotations

import msgspec
import pytest
from learning_models import TestLearner, area, lesson, stride
from sqlalchemy import Engine

from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.rows import Decided
from services.learning.activation.states import KEPT
from services.learning.activation.store import ModelStore
from services.learning.last_heard import HOUR, MOST, LastHeard
from services.learning.loop import AT_ONCE, LearningLoop
from services.learning.trials import Pace
from services.learning.walking.heading_lessons import HeadingLessons
from services.learning.walking.stride_lessons import StrideLessons
from shared.messages import Erasure, Message, RadioScan

NOW = 1_700_000_000.0


class Site:
    """A loop of two lessons, its database and what it does to phones' models."""

    def __init__(self, engine: Engine | None = None) -> None:
        self.engine = engine or in_memory()
        self.learner, self.walker = TestLearner(), TestLearner("stride")
        self.store = ModelStore(self.engine)
        self.sent: list[Message] = []
        self.retracted: list[str] = []
        self.loop = LearningLoop(
            {"hall": area()}, [lesson(self.learner), lesson(self.walker)], Gate(), self.store, lambda *_: {},
            self.sent.append, Pace(), retract=self.retracted.append,
        )  # fmt: skip

    def start(self, now: float = NOW) -> Site:
        self.loop.begin()
        self.loop.look(now)
        return self

    def line(self, device: str) -> None:
        self.store.activate(stride(device), "stride", device, "hall", Decided(NOW, NOW, "wins"))


def scan(device: str, t: float) -> RadioScan:
    return RadioScan(t=t, device=device, seq=1, access_point=["ap-1"], rssi=[-50.0])


def test_lessons_of_areas_that_are_not_learned_now_stay() -> None:
    engine = in_memory()
    ModelStore(engine).states.save({"radio/west": b'{"d-9":1}', "test-radio": b'{"d-1":1}'}, NOW - 60.0)
    site = Site(engine).start()
    site.learner.known["d-2"] = 1
    site.loop.save(NOW + 1.0)
    kept = site.store.states.read()
    assert kept["radio/west"] == b'{"d-9":1}'
    assert msgspec.json.decode(kept["test-radio"]) == {"d-1": 1, "d-2": 1}
    site.loop.take(Erasure(t=NOW, device="d-1"))
    assert "radio/west" in site.store.states.read()
    site.loop.take(Erasure(t=NOW, device="d-9"))
    assert "radio/west" not in site.store.states.read(), "nobody is there who could forget that phone alone"


def test_what_is_not_understood_is_kept_told_of_and_used_again_by_a_start_that_understands_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    engine = in_memory()
    ModelStore(engine).states.save({"test-radio": b'{"d-1":1,"of":"another hall"}'}, NOW - 60.0)

    def restore(learner: TestLearner, state: dict[str, object]) -> None:
        if state.get("of", here) != here:
            raise ValueError("of another hall")
        learner.known = dict(state)

    monkeypatch.setattr(TestLearner, "restore", restore)
    here: str = "this hall"
    slip = Site(engine).start()
    assert "kept for 30 days" in slip.loop.set_aside()["test-radio"]
    assert "d-1" not in str(slip.loop.set_aside())
    slip.learner.known = {"of": here}
    slip.loop.save(NOW + 10.0)
    here = "another hall"
    mended = Site(engine).start(NOW + 60.0)
    assert mended.learner.known == {"d-1": 1, "of": "another hall"}
    assert "goes on from what was set aside" in mended.loop.set_aside()["test-radio"]
    assert Site(engine).start(NOW + 90.0).loop.set_aside() == {}


def test_what_was_set_aside_goes_with_whoever_withdraws_and_after_a_month() -> None:
    engine = in_memory()
    ModelStore(engine).states.save({"test-radio": b'{"broken":1}', "test-stride": b'{"broken":["d-1"]}'}, NOW)
    site = Site(engine).start()
    assert {"aside/test-radio", "aside/test-stride"} <= site.store.states.read().keys()
    site.loop.take(Erasure(t=NOW, device="d-1"))
    assert "aside/test-stride" not in site.store.states.read()
    site.loop.look(NOW + KEPT + 2 * HOUR)
    assert "aside/test-radio" not in site.store.states.read()


def test_models_of_phones_that_stay_away_for_a_month_go_and_others_stay() -> None:
    site = Site()
    site.line("d-away")
    site.line("d-here")
    site.start()
    assert {one.device for one in site.sent if hasattr(one, "device")} == {"d-away", "d-here"}
    site.loop.take(scan("d-here", NOW + KEPT / 2))
    site.loop.look(NOW + KEPT / 2)
    site.loop.save(NOW + KEPT / 2)
    again = Site(site.engine).start(NOW + KEPT + HOUR)
    assert again.store.phones() == {"d-here"}
    assert again.retracted == ["d-away"]
    assert again.walker.forgotten == ["d-away"]
    assert [one.device for one in again.sent if hasattr(one, "device")] == ["d-here"]
    assert not again.loop.has_forgotten("d-away"), "it may come back and be learned anew"


def test_more_phones_than_fit_are_let_go_in_turns_those_longest_away_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.learning.last_heard.MOST", 3)
    monkeypatch.setattr("services.learning.loop.AT_ONCE", 4)
    site = Site()
    for number in range(9):
        site.line(f"d-{number}")
    for number in (1, 5):
        site.loop.take(scan(f"d-{number}", NOW + HOUR))
    site.loop._heard.restore({f"d-{number}": NOW - HOUR for number in range(9)})
    site.start()
    assert len(site.store.phones()) == 5
    site.loop.look(NOW + 1.0)
    assert site.store.phones() == {"d-1", "d-5", "d-8"}
    assert AT_ONCE < MOST


def test_a_clock_that_was_set_back_keeps_nobody_longer() -> None:
    heard = LastHeard()
    heard.look(["d-1"], NOW + 10 * KEPT)
    assert heard.look(["d-1"], NOW) == []
    assert heard.look(["d-1"], NOW + KEPT + HOUR) == ["d-1"]
    assert heard.look(["d-2"], NOW) == []
    assert heard.state().keys() == {"d-2"}
    with pytest.raises(ValueError, match="float"):
        heard.restore({"d-1": "soon"})


def test_lines_and_headings_learned_under_other_areas_are_understood() -> None:
    for make in (StrideLessons, HeadingLessons):
        lessons = make("west")
        lessons.activated(stride("d-1"))
        make("hall").restore(lessons.state())
