"""One lesson that raises, on the real loop: the others go on, it is told, and nobody who withdrew stays in it."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import msgspec
import numpy as np
import pytest
import structlog
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_models import TestLearner, area_judged_by, lesson, power_of, radio, walk
from sqlalchemy import Engine
from sqlalchemy.exc import OperationalError

from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.store import ModelStore
from services.learning.faults import REST
from services.learning.loop import LearningLoop
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from services.learning.trials import Pace
from shared.learning_command import LearningAnswer, LearningCommand
from shared.messages import Erasure, HeadingModel, Message, RadioModelUpdate

BEGIN = 1000.0
BEFORE = BEGIN - 100.0
CALLS = {
    "watch": "take in tracks",
    "learn": "learn from a walk",
    "learn_doubtful": "learn from a walk",
    "forget": "forget a phone, and knows nothing any more",
    "propose": "propose models",
    "alarms": "look for changes",
    "regret": "judge a live model",
    "activated": "take in a live model",
    "state": "save what it knows",
    "restore": "read what it knew",
    "tell": "report",
    "map": "draw a map",
}
JUDGED = {
    "judge": "judge walks",
    "watch": "take in tracks",
    "forget": "forget a phone, and knows nothing any more",
    "activated": "take in a live model",
    "state": "save what it knows",
    "restore": "read what it knew",
    "tell": "report",
}


@pytest.fixture(autouse=True, scope="module")
def logged() -> Iterator[list[Any]]:
    """What is logged: printed with all values of a test it takes longer than the test."""
    with structlog.testing.capture_logs() as lines:
        yield lines


class Broken(TestLearner):
    """Raises in the calls it is told to; one that is made anew does not."""

    def __init__(self, kind: Any = "heading", breaks: Sequence[str] = ()) -> None:
        super().__init__(kind)
        self.breaks = set(breaks)
        self.calls: Counter[str] = Counter()
        self.regretted = (0.0, 1.0)

    def _called(self, call: str) -> None:
        self.calls[call] += 1
        if call in self.breaks:
            raise KeyError("d-1")

    def watch(self, message: Message) -> None:
        self._called("watch")

    def learn(self, stretch: Stretch) -> None:
        super().learn(stretch)
        self._called("learn")

    def learn_doubtful(self, stretch: Stretch) -> None:
        self._called("learn_doubtful")

    def forget(self, device: str) -> None:
        self._called("forget")
        super().forget(device)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        self._called("propose")
        return super().propose(now, until)

    def alarms(self, now: float) -> Sequence[Proposal]:
        self._called("alarms")
        return ()

    def regret(self, former: Message, since: float) -> tuple[float, float] | None:
        self._called("regret")
        return super().regret(former, since)

    def activated(self, model: Message) -> None:
        self._called("activated")
        super().activated(model)

    def state(self) -> dict[str, Any]:
        self._called("state")
        return super().state()

    def restore(self, state: Mapping[str, Any]) -> None:
        super().restore(state)
        self._called("restore")

    def tell(self, draft: ReportDraft) -> None:
        self._called("tell")

    def map(self, command: LearningCommand) -> LearningAnswer | None:
        self._called("map")
        return None


class Judge:
    """Half of the stretches are good, the others in doubt; raises in the calls it is told to."""

    def __init__(self, breaks: Sequence[str] = ()) -> None:
        self.breaks = set(breaks)
        self.seen: dict[str, int] = {}
        self._good = cycle([True, False])

    def _called(self, call: str) -> None:
        if call in self.breaks:
            raise np.linalg.LinAlgError("singular: d-1")

    def __call__(self, stretch: Stretch) -> Verdict:
        self.seen[stretch.device] = self.seen.get(stretch.device, 0) + 1
        self._called("judge")
        return Verdict(1.0, 0.1, next(self._good), "too short", True)

    def watch(self, message: Message) -> None:
        self._called("watch")

    def forget(self, device: str) -> None:
        self._called("forget")
        self.seen.pop(device, None)

    def activated(self, model: Message) -> None:
        self._called("activated")

    def state(self) -> dict[str, Any]:
        self._called("state")
        return dict(self.seen)

    def restore(self, state: Mapping[str, Any]) -> None:
        self.seen = dict(state)
        if "restore" in self.breaks:
            raise KeyError("d-1")

    def tell(self, draft: ReportDraft) -> None:
        self._called("tell")


class World:
    """A loop with a broken lesson between two that are well, and a fusion by which radio models win."""

    def __init__(self, engine: Engine | None = None, breaks: Sequence[str] = (), judge: Judge | None = None) -> None:
        self.first, self.last = TestLearner(), TestLearner("stride")
        self.engine = engine or in_memory()
        self.sent: list[Message] = []
        self.loop = LearningLoop(
            {"hall": area_judged_by(judge or Judge())},
            [lesson(self.first), lesson(Broken(breaks=breaks)), lesson(self.last)],
            Gate(),
            ModelStore(self.engine),
            lambda place, question: {
                "scans": 200,
                "seconds": 120.0,
                "gain": 0.1,
                "gain_error": 0.01,
                "devices": {name: {"scans": 100, "gain": 0.1} for name in ("d-2", "d-3")},
            },
            self.sent.append,
            Pace(propose=10.0, held_out=60.0, after_refusal=60.0, save=50.0),
        )

    @property
    def broken(self) -> Broken:
        [learner] = [one.learner for one in self.loop.lessons if isinstance(one.learner, Broken)]
        return learner

    def run(self, begin: float = BEGIN, seconds: float = 150.0) -> None:
        """Let d-1 walk and stop and walk, and look now and then."""
        looked = begin
        for frame in walk(seconds, begin):
            self.loop.take(frame)
            if frame.t >= looked + 5.0:
                looked = frame.t
                self.loop.look(frame.t)

    def propose(self) -> None:
        turned = HeadingModel(t=0.0, device="d-3", version=0, bias=0.2, variance=0.1)
        self.broken.proposals = [Proposal("heading", "d-3", "hall", turned, BEFORE, gain=1.0, margin=0.1)]
        self.first.proposals = [Proposal("radio", "hall", "hall", radio(power=-41.0), BEFORE, b'{"kind":"radio"}')]

    def everything(self) -> None:
        """Have every call of every lesson made at least once, and each model live once."""
        self.loop.begin()
        self.run()
        self.propose()
        self.run(BEGIN + 150.0, 60.0)
        self.loop.report(BEGIN)
        self.loop.lessons.map(LearningCommand(do="map", area="hall", map="visits"))
        self.loop.take(Erasure(t=0.0, device="d-1"))
        self.loop.look(BEGIN + 211.0)

    def live(self) -> list[float | None]:
        return [power_of(one) for one in self.sent if isinstance(one, RadioModelUpdate)]


@pytest.fixture
def engine() -> Engine:
    """Of a site that learned of d-1 and d-3 before."""
    engine = in_memory()
    states = {"test-heading": b'{"d-1":1,"d-3":1}', "tracks/hall": b'{"d-1":1}'}
    ModelStore(engine).states.save(states, BEGIN)
    return engine


@pytest.mark.parametrize("call", CALLS)
def test_a_lesson_that_raises_harms_no_other_and_is_told_of(engine: Engine, call: str, logged: list[Any]) -> None:
    world = World(engine, [call])
    logged.clear()
    broken = world.broken
    world.everything()
    assert broken.calls[call] >= 1, "it was asked"
    assert world.live() == [-41.0]
    assert world.first.learned
    assert world.first.forgotten == world.last.forgotten == ["d-1"]
    words = f"lesson test-heading could not {CALLS[call]} (KeyError)"
    assert world.loop.troubles() == {"test-heading": (frozenset({"hall"}), words)}
    assert words in world.loop.report(BEGIN).areas[0].words
    assert not any(b"d-1" in state for state in world.loop.store.states.read().values())
    lines = [one for one in logged if one["log_level"] == "error"]
    assert {(line["lesson"], line["could_not"]) for line in lines} == {("test-heading", CALLS[call])}
    assert all(line["exc_info"].__traceback__ is not None for line in lines)


def test_all_calls_are_made_where_nothing_raises(engine: Engine) -> None:
    world = World(engine)
    world.everything()
    assert world.broken.calls.keys() == CALLS.keys()
    assert world.loop.troubles() == {}


@pytest.mark.parametrize("call", JUDGED)
def test_an_area_whose_judge_raises_ends_nothing_and_is_told_of(engine: Engine, call: str) -> None:
    world = World(engine, judge=Judge([call]))
    world.everything()
    error = "KeyError" if call == "restore" else "LinAlgError"
    assert world.loop.troubles()["tracks/hall"] == (
        frozenset({"hall"}),
        f"lesson tracks/hall could not {JUDGED[call]} ({error})",
    )
    assert world.first.forgotten == ["d-1"]
    assert world.live() == ([] if call == "watch" else [-41.0]), "without tracks there is no time"


def test_what_raised_rests_so_that_the_log_stays_short_and_is_tried_again_afterwards() -> None:
    world = World(breaks=["watch"])
    world.run(seconds=60.0)
    assert world.broken.calls["watch"] == 1
    assert world.broken.calls["propose"] > 1, "what works goes on"
    world.loop.look(BEGIN + REST + 60.0)
    world.broken.breaks.clear()
    world.run(BEGIN + REST + 60.0, 10.0)
    assert world.broken.calls["watch"] == 21
    assert world.loop.troubles(), "told for as long again"
    world.loop.look(BEGIN + 2.0 * REST + 60.0)
    assert world.loop.troubles() == {}


def test_a_clock_that_was_set_back_lengthens_no_rest() -> None:
    world = World(breaks=["watch"])
    world.run(seconds=10.0)
    world.loop.look(BEGIN - 1e6)
    world.loop.look(BEGIN - 1e6 + REST)
    world.loop.take(walk(1.0, BEGIN + 20.0)[0])
    assert world.broken.calls["watch"] == 2


def test_who_cannot_forget_is_made_anew_even_while_the_database_is_away_and_is_told_what_is_live() -> None:
    world = World()
    world.propose()
    world.run()
    former, store = world.broken, world.loop.store
    assert "d-1" in former.known
    assert store.active("heading", "d-3") is not None
    former.breaks = {"forget"}
    forget = store.forget

    def away(device: str) -> None:
        raise OperationalError("delete", {}, Exception("away"))

    store.forget = away  # type: ignore[method-assign]
    with pytest.raises(OperationalError):
        world.loop.take(Erasure(t=0.0, device="d-1"))
    assert world.broken is not former
    assert world.broken.known == {}
    assert world.last.forgotten == ["d-1"], "who comes after it forgets too"
    store.forget = forget  # type: ignore[method-assign]
    world.loop.look(BEGIN + 151.0)
    assert [type(one) for one in world.broken.live] == [HeadingModel]
    assert not any(b"d-1" in state for state in store.states.read().values())
    world.run(BEGIN + 152.0, 10.0)
    assert world.broken.calls["watch"] == 20, "it is the new one that messages come to"


def test_of_who_cannot_tell_what_it_knows_the_last_that_was_saved_stays_until_somebody_withdraws() -> None:
    world = World()
    world.run()
    world.loop.save(BEGIN + 150.0)
    saved = world.loop.store.states.read()["test-heading"]
    again = World(world.engine, ["state"])
    again.loop.begin()
    again.loop.save(BEGIN + 151.0)
    again.loop.save(BEGIN + 152.0)
    assert again.loop.store.states.read()["test-heading"] == saved
    again.loop.take(Erasure(t=0.0, device="d-1"))
    again.loop.look(BEGIN + 153.0)
    assert "test-heading" not in again.loop.store.states.read()


def test_who_does_not_know_what_is_live_proposes_nothing_until_it_was_told() -> None:
    world = World(breaks=["activated"])
    world.propose()
    world.run(seconds=60.0)
    asked = world.broken.calls["propose"]
    assert asked == 1
    world.broken.breaks.clear()
    world.loop.look(BEGIN + 60.0 + REST)
    assert [getattr(one, "version", None) for one in world.broken.live[:1]] == [1]
    world.run(BEGIN + 61.0 + REST, 20.0)
    assert world.broken.calls["propose"] > asked


def test_a_model_that_cannot_be_told_on_the_bus_is_its_lessons_error() -> None:
    world = World()
    wrong = HeadingModel(t=0.0, device="d-3", version=0, bias=float("nan"), variance=0.1)
    world.broken.proposals = [Proposal("heading", "d-3", "hall", wrong, BEFORE, gain=1.0, margin=0.1)]
    world.run(seconds=60.0)
    assert world.loop.store.history() == []
    assert "could not propose models" in world.loop.troubles()["test-heading"][1]


def everybody() -> Iterator[str]:
    yield from (f"lesson.{call}" for call in CALLS)
    yield from (f"judge.{call}" for call in JUDGED)


@settings(max_examples=15, deadline=None)
@given(st.sets(st.sampled_from(sorted(everybody())), max_size=8))
def test_whatever_raises_nothing_of_who_withdrew_stays(breaks: set[str]) -> None:
    judge = Judge([one.removeprefix("judge.") for one in breaks if one.startswith("judge.")])
    world = World(breaks=[one.removeprefix("lesson.") for one in breaks if one.startswith("lesson.")], judge=judge)
    world.run()
    judge.seen = {}  # this judge outlives its area
    world.loop.take(Erasure(t=0.0, device="d-1"))
    world.run(BEGIN + 150.0, 30.0)  # frames still under way name it
    told = [
        msgspec.json.encode(one.learner.known) for one in world.loop.lessons if isinstance(one.learner, TestLearner)
    ]
    kept = [*world.loop.store.states.read().values(), *told]
    assert not any(b"d-1" in state for state in kept)
