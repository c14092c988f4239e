"""The loop without bus and clock: messages in, decisions out, the same each time."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from learning_models import TestLearner, area, area_judged_by, lesson, power_of, radio, stride, walk
from sqlalchemy import Engine
from sqlalchemy.exc import OperationalError

from services.learning.activation.content import Contents
from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.rows import Decided
from services.learning.activation.store import ModelStore
from services.learning.area_tracks import AreaTracks
from services.learning.lesson import Lesson
from services.learning.loop import LearningLoop
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.settings import LearningSettings
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from services.learning.trials import Candidate, Inline, Key, Pace, Trials
from shared.learning_report import ModelKind, TrackLessons
from shared.messages import CameraAlignment, Erasure, HeadingModel, Message, RadioModelUpdate, RadioScan
from shared.site import Site, load_site
from shared.site.geometry_digest import geometry_digest
from shared.site.site_file import PoseGeometry

BEGIN = 1000.0
BEFORE = BEGIN - 100.0
"""Everything since is held out for a candidate that was taught until then."""


class World:
    """A loop with a fusion that answers as it is told, and everything it sends."""

    def __init__(
        self,
        engine: Engine | None = None,
        executor: Executor | None = None,
        tracks: AreaTracks | None = None,
        lessons: Sequence[Lesson] = (),
        site: Site | None = None,
        **options: Any,
    ) -> None:
        self.gain, self.gain_of_configured = 0.1, -0.1
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.sent: list[Message] = []
        self.learner, self.walker = TestLearner(), TestLearner("stride")
        self.engine = engine or in_memory()
        self.loop = LearningLoop(
            {"hall": tracks or area()},
            [lesson(self.learner), lesson(self.walker), *lessons],
            Gate(),
            ModelStore(self.engine, Contents(site)),
            self.answer,
            self.sent.append,
            Pace(
                propose=10.0,
                held_out=60.0,
                urgent=30.0,
                again=20.0,
                after_refusal=60.0,
                after_roll_back=600.0,
                save=50.0,
            ),
            executor=executor,
            **options,
        )

    def answer(self, place: str, question: bytes) -> Mapping[str, Any]:
        asked = msgspec.json.decode(question)
        self.asked.append((place, asked))
        gain = self.gain_of_configured if asked.get("model", 0) is None else self.gain
        return {
            "scans": 200,
            "seconds": 120.0,
            "gain": gain,
            "gain_error": 0.01,
            "active_named": 0.8,
            "candidate_named": 0.8,
            "devices": {name: {"scans": 100, "gain": gain} for name in ("d-1", "d-2")},
        }

    def live_until(self, end: float, begin: float = BEGIN, every: float = 5.0) -> None:
        """Let somebody walk, and look now and then."""
        looked = begin
        for frame in walk(end - begin, begin):
            self.loop.take(frame)
            if frame.t >= looked + every:
                looked = frame.t
                self.loop.look(frame.t)

    def propose(self, power: float = -41.0, until: float = BEFORE) -> None:
        self.learner.proposals = [
            Proposal("radio", "hall", "hall", radio(power=power), until, b'{"kind":"radio"}', reason="learned")
        ]

    def decisions(self) -> list[str]:
        return [one.decision for one in reversed(self.loop.store.history())]

    def powers(self) -> list[float | None]:
        return [power_of(one) for one in self.sent if isinstance(one, RadioModelUpdate)]


def test_good_stretches_teach_and_what_wins_on_newer_time_goes_live() -> None:
    world = World()
    world.live_until(BEGIN + 100.0)
    assert {one.device for one in world.learner.learned} == {"d-1"}
    world.propose(until=BEGIN + 45.0)
    world.live_until(BEGIN + 130.0, BEGIN + 100.0)
    assert world.decisions() == ["activated"]
    assert world.asked[0] == ("hall", {"kind": "radio", "since": BEGIN + 45.0})
    assert world.powers() == [-41.0]
    assert [power_of(one) for one in world.learner.live] == [-41.0]
    report = world.loop.report(2000.0)
    assert report.areas[0].version == 1
    assert report.history[0].reason.startswith("learned: wins by 0.1")


def test_two_runs_of_the_same_messages_decide_the_same() -> None:
    told = []
    for _ in range(2):
        world = World()
        world.propose()
        world.live_until(BEGIN + 200.0)
        told.append(msgspec.json.encode(world.loop.report(3000.0)))
    assert told[0] == told[1]


def test_what_loses_is_refused_and_its_subject_is_left_alone_until_there_is_new_time() -> None:
    world = World()
    world.gain = -0.1
    world.propose()
    world.live_until(BEGIN + 50.0)
    assert world.decisions() == ["refused"]
    assert world.sent == []
    world.live_until(BEGIN + 110.0, BEGIN + 50.0)
    assert len(world.asked) == 2


def test_a_clock_that_was_set_back_ends_no_subject() -> None:
    pace = Pace()
    trials = Trials(Gate(), lambda *_: {}, Inline(), pace, lambda _: 0, lambda _, now: now)
    key: Key = ("radio", "hall")
    day = 86400.0
    for pause in (pace.again, pace.after_refusal, pace.after_roll_back):
        trials.wait(key, 10.0 * day + pause)
        assert not trials.may_begin(key, 10.0 * day)
        assert trials.may_begin(key, 10.0 * day + pause)
        assert trials.may_begin(key, 9.0 * day)


def test_a_candidate_that_fusion_has_no_time_for_is_tried_again_though_its_learner_tells_it_once() -> None:
    world, busy = World(), True

    def tell(place: str, question: bytes) -> Mapping[str, Any]:
        return {"error": "busy: another candidate is being tried"} if busy else world.answer(place, question)

    world.loop._trials._ask = tell
    world.propose()
    world.live_until(BEGIN + 10.0)
    world.learner.proposals, busy = [], False
    assert world.decisions() == []
    world.live_until(BEGIN + 60.0, BEGIN + 10.0)
    assert world.decisions() == ["activated"]


def test_of_two_candidates_the_second_waits_its_turn_until_a_newer_one_or_an_erasure_ends_it() -> None:
    slow = Slow()
    world = World(executor=slow)
    world.propose()
    asked = Proposal("stride", "d-1", "hall", stride("d-1"), BEFORE, b'{"kind":"stride"}')
    world.walker.proposals = [asked, Proposal("stride", "d-2", "hall", stride("d-2"), BEFORE, b'{"kind":"stride"}')]
    world.live_until(BEGIN + 10.0)
    world.learner.proposals, world.walker.proposals = [], []
    assert world.loop._untried.keys() == [("stride", "d-1"), ("stride", "d-2")]
    world.loop.take(Erasure(t=0.0, device="d-1"))
    assert world.loop._untried.keys() == [("stride", "d-2")]
    stored = world.loop.store.refuse(stride("d-2"), "stride", "d-2", "hall", Decided(BEGIN, BEGIN, ""))
    world.loop.decisions.put_live(stored, BEGIN + 10.0, "by hand")
    assert not world.loop._untried.keys(), "it was to be better than what is live no more"


def test_who_withdraws_while_the_database_is_away_is_forgotten_there_as_soon_as_it_is_back() -> None:
    world = World()
    world.loop.store.activate(stride("d-1"), "stride", "d-1", "hall", Decided(1.0, 1.0, "wins"))
    forget = world.loop.store.forget

    def away(device: str) -> None:
        raise OperationalError("delete", {}, Exception("away"))

    world.loop.store.forget = away  # type: ignore[method-assign]
    with pytest.raises(OperationalError):
        world.loop.take(Erasure(t=0.0, device="d-1"))
    with pytest.raises(OperationalError):
        world.loop.look(BEGIN)
    assert world.learner.forgotten == ["d-1"], "in memory at once"
    world.loop.store.forget = forget  # type: ignore[method-assign]
    world.loop.look(BEGIN + 1.0)
    assert (world.loop.store.models(), world.loop.store.history()) == ([], [])


def test_phones_models_are_published_after_a_start_once_erasures_were_heard() -> None:
    world = World()
    for device in ("d-1", "d-2"):
        world.loop.store.activate(stride(device), "stride", device, "hall", Decided(1.0, 1.0, "wins"))
    again = World(world.engine)
    again.loop.begin()
    assert again.sent == []
    again.loop.take(Erasure(t=0.0, device="d-1"))
    again.loop.look(BEGIN)
    again.loop.look(BEGIN + 1.0)
    assert [getattr(one, "device", None) for one in again.sent] == ["d-2"]


@pytest.mark.parametrize(("urgent", "times"), [(False, 10.0), (True, 4.0)])
def test_after_a_trial_learning_rests_so_that_trials_take_a_share_of_a_core_only(urgent: bool, times: float) -> None:
    world = World()
    trials = Trials(
        Gate(),
        lambda place, question: {**world.answer(place, question), "took": 12.0},
        Inline(),
        LearningSettings(site_file=Path("site.yaml")).pace(),
        lambda _: 0,
        lambda _place, now: now,
    )
    world.propose()
    first = world.learner.proposals[0]
    trials.start(Candidate(first), BEFORE, BEGIN)
    assert trials.finished(BEGIN) is not None
    trials.expect(Candidate(replace(first, trained_until=BEGIN - 1000.0, urgent=urgent)))
    assert not trials.go_on(BEGIN + times * 12.0 - 1.0, urgent=urgent)
    assert trials.go_on(BEGIN + times * 12.0, urgent=urgent)


def test_a_trial_that_names_who_withdrew_meanwhile_is_void_and_the_candidate_is_tried_again() -> None:
    slow = Slow()
    world = World(executor=slow)
    world.propose()
    world.live_until(BEGIN + 10.0)
    world.learner.proposals = []
    world.loop.take(Erasure(t=0.0, device="d-1"))
    slow.answer()
    world.loop.look(BEGIN + 11.0)
    assert world.decisions() == []
    assert not world.loop._trials._open, "what it was better by is not kept: it names the phone"
    world.loop.look(BEGIN + 40.0)
    assert len(slow.waiting) == 1


def test_a_model_that_does_worse_on_what_came_after_goes_back_by_itself() -> None:
    world = World()
    world.gain_of_configured = 0.1
    world.propose()
    world.live_until(BEGIN + 40.0)
    assert world.powers() == [-41.0]
    world.live_until(BEGIN + 110.0, BEGIN + 40.0)
    assert world.decisions() == ["activated", "rolled back"]
    assert world.powers() == [-41.0, None]
    assert world.asked[1][1] == {"kind": "radio", "model": None, "since": world.asked[1][1]["since"]}
    assert "on what came after, the model before was better" in world.loop.store.history()[0].reason
    world.live_until(BEGIN + 400.0, BEGIN + 110.0)
    assert len(world.asked) == 2, "a model that had to go back is not tried again soon"
    again = World(world.engine)
    again.propose()
    again.loop.begin()
    again.live_until(BEGIN + 450.0, BEGIN + 400.0)
    assert again.asked == [], "nor after a restart"


def test_a_model_that_stands_its_probation_stays() -> None:
    world = World()
    world.propose()
    world.live_until(BEGIN + 10.0)
    world.learner.proposals = []
    world.live_until(BEGIN + 200.0, BEGIN + 10.0)
    assert world.decisions() == ["activated"]
    assert len(world.asked) == 2
    live = world.loop.store.active("radio", "hall")
    assert live is not None
    assert not live.probation


def test_what_is_better_but_not_surely_is_tried_again_on_time_that_has_not_judged_it() -> None:
    world = World()
    world.gain = 0.0175  # of an error of 0.01
    world.propose()
    world.live_until(BEGIN + 170.0)
    assert world.decisions() == ["activated"]
    since = [question["since"] for _, question in world.asked]
    assert since[1] - BEGIN < 10.0


def test_an_urgent_candidate_is_tried_on_the_first_minute_that_comes_before_whatever_else_waits() -> None:
    world = World()
    world.gain = 0.0175
    world.propose()
    world.live_until(BEGIN + 20.0)
    assert len(world.asked) == 1, "the other is better, but not surely: it waits for more time"
    world.learner.urgent = [
        Proposal("radio", "hall", "hall", radio(power=-50.0), BEGIN + 20.0, b"{}", reason="a wall", urgent=True)
    ]
    world.gain = 0.1
    world.live_until(BEGIN + 90.0, BEGIN + 20.0)
    assert [question["since"] for _, question in world.asked[1:]] == [BEGIN + 20.0]
    assert world.powers() == [-50.0]
    assert world.loop.store.history()[0].reason.startswith("a wall: wins")
    assert world.loop.store.history()[0].t < BEGIN + 20.0 + 30.0 + 10.0


@pytest.mark.parametrize("switch", ["setting", "frozen"])
def test_with_activation_off_candidates_are_tried_and_told_of_only(switch: str) -> None:
    world = World(activate=switch != "setting")
    world.loop.store.freeze(switch == "frozen")
    world.propose()
    world.live_until(BEGIN + 60.0)
    assert world.decisions() == ["refused"]
    assert world.sent == []
    assert "would go live" in world.loop.store.history()[0].reason


def test_an_imported_model_that_wins_while_frozen_waits_and_goes_live_after() -> None:
    world = World()
    come: tuple[Message, ModelKind, str, str] = (radio(power=-41.0), "radio", "hall", "hall")
    world.loop.store.take_in_all([come], [Decided(BEGIN, BEGIN, "from elsewhere")])
    world.loop.store.freeze(True)
    world.live_until(BEGIN + 60.0)
    assert world.asked
    assert [one.state for one in world.loop.store.models()] == ["imported"]
    world.loop.store.freeze(False)
    world.live_until(BEGIN + 180.0, BEGIN + 60.0)
    assert world.decisions() == ["imported", "activated"]
    assert world.powers() == [-41.0]


def test_what_wins_and_could_be_used_by_nobody_is_refused() -> None:
    world = World()
    world.propose(power=1e6)
    world.live_until(BEGIN + 60.0)
    assert (world.decisions(), world.sent) == (["refused"], [])
    assert "model.power_1m: found 1e+06; allowed: -150 to 50" in world.loop.store.history()[0].reason


def test_killed_between_decision_and_publication_the_model_is_published_at_the_next_start() -> None:
    world = World()
    world.propose()

    def fail(_: Message) -> None:
        raise ConnectionError("the bus is gone")

    world.loop.decisions._publish = fail
    with pytest.raises(ConnectionError):
        world.live_until(BEGIN + 60.0)
    again = World(world.engine)
    again.loop.begin()
    assert again.powers() == [-41.0]
    assert [power_of(one) for one in again.learner.live] == [-41.0]


def test_what_learners_know_survives_a_restart_and_a_state_that_is_none_begins_anew() -> None:
    world = World()
    world.live_until(BEGIN + 200.0)
    assert world.learner.known["d-1"] >= 1
    world.loop.save(BEGIN + 200.0)
    again = World(world.engine)
    again.walker.known = {"kept": 1}
    states = again.loop.store.states.read()
    again.loop.store.states.save({**states, "test-stride": b'{"broken":1}'}, 1.0)
    again.loop.begin()
    assert again.learner.known == world.learner.known
    assert again.walker.known == {"kept": 1}


def test_who_withdraws_is_forgotten_everywhere_at_once() -> None:
    world = World()
    model = Proposal("stride", "d-1", "hall", stride("d-1"), BEFORE, gain=1.0, margin=0.1)
    world.walker.proposals = [model]
    world.live_until(BEGIN + 130.0)
    world.walker.proposals = []
    assert {type(one).__name__ for one in world.sent} == {"StrideModel"}
    assert world.loop.store.states.read()["test-radio"] != b"{}"
    world.loop.take(Erasure(t=0.0, device="d-1"))
    world.sent.clear()
    world.loop.look(BEGIN + 131.0)
    assert world.learner.forgotten == world.walker.forgotten == ["d-1"]
    assert world.loop.store.models() == []
    assert world.loop.store.history() == []
    assert set(world.loop.store.states.read().values()) == {b"{}"}
    scan = RadioScan(t=BEGIN + 131.0, device="d-1", seq=1, access_point=["ap-1"], rssi=[-50.0])
    world.loop.take(scan)
    world.live_until(BEGIN + 200.0, BEGIN + 131.0)  # frames still under way name it
    assert world.sent == []
    assert world.learner.known == {}


def test_a_phones_own_model_that_its_learner_scored_needs_no_fusion() -> None:
    world = World()
    world.walker.proposals = [
        Proposal("stride", "d-1", "hall", stride(), BEFORE, b'{"kind":"stride"}', gain=0.2, margin=0.3)
    ]
    world.live_until(BEGIN + 30.0)
    assert world.asked == []
    assert set(world.decisions()) == {"refused"}


def test_a_proposal_that_is_not_what_it_says_is_left_out() -> None:
    world = World()
    world.learner.proposals = [Proposal("radio", "hall", "hall", radio("east"), BEFORE, b"{}")]
    world.live_until(BEGIN + 60.0)
    assert world.asked == []


class Slow(Executor):
    """Answers when it is told to."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.waiting.append((future, lambda: fn(*args, **kwargs)))
        return future

    def answer(self) -> None:
        future, work = self.waiting.pop(0)
        future.set_result(work())


def test_one_candidate_at_a_time_and_an_answer_about_what_is_no_longer_live_is_void() -> None:
    slow = Slow()
    world = World(executor=slow)
    world.propose()
    world.live_until(BEGIN + 60.0)
    assert len(slow.waiting) == 1
    assert world.loop.words("hall") == "a candidate is being tried: radio"
    stored = world.loop.store.refuse(radio(power=-39.0), "radio", "hall", "hall", Decided(BEGIN, BEGIN, ""))
    world.loop.decisions.put_live(stored, BEGIN + 60.0, "by hand")
    slow.answer()
    world.loop.look(BEGIN + 61.0)
    assert world.powers() == [-39.0]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ({"error": "fusion of area hall does not answer"}, "waits: fusion of area hall does not answer"),
        ({"error": "scans: found 2 to withhold"}, "waits: scans: found 2"),
        (ConnectionError("no bus"), "waits: fusion of area hall: no bus"),
    ],
)
def test_where_fusion_cannot_say_anything_nothing_is_decided(answer: Any, words: str) -> None:
    world = World()

    def tell(_place: str, _question: bytes) -> Mapping[str, Any]:
        if isinstance(answer, Exception):
            raise answer
        return answer  # type: ignore[no-any-return]

    world.loop._trials._ask = tell
    world.propose()
    world.live_until(BEGIN + 60.0)
    assert world.decisions() == []
    assert world.loop.words("hall").startswith(words)


def test_words_say_what_learning_waits_for() -> None:
    world = World()
    assert "no tracks yet" in world.loop.words("hall")
    world.loop.take(walk(1.0, BEGIN)[0])
    assert "nobody with a phone" in world.loop.words("hall")
    world.live_until(BEGIN + 100.0)
    assert world.loop.words("hall") == "learns"


def test_kinds_that_nobody_can_judge_end_their_probation_at_once() -> None:
    world = World()
    turned = HeadingModel(t=0.0, device="d-1", version=0, bias=0.2, variance=0.1)
    world.walker.proposals = [Proposal("heading", "d-1", "hall", turned, BEFORE, gain=1.0, margin=0.1)]
    world.live_until(BEGIN + 30.0)
    kind: ModelKind = "heading"
    live = world.loop.store.active(kind, "d-1")
    assert live is not None
    assert not live.probation
    assert isinstance(world.loop._trials._executor, Inline)


class Strict:
    """A judge that knows phones, and keeps what it knows."""

    def __init__(self) -> None:
        self.seen: dict[str, int] = {}

    def __call__(self, stretch: Stretch) -> Verdict:
        self.seen[stretch.device] = self.seen.get(stretch.device, 0) + 1
        return Verdict(1.0, 0.1, False, "not sure")

    def forget(self, device: str) -> None:
        self.seen.pop(device, None)

    def tell(self, draft: ReportDraft) -> None:
        draft.area("hall", tracks=TrackLessons(good=0, refused={"not sure": sum(self.seen.values())}))

    def state(self) -> dict[str, Any]:
        return dict(self.seen)

    def restore(self, state: Mapping[str, Any]) -> None:
        self.seen = dict(state)


def test_a_judge_that_keeps_something_is_restored_and_forgets_too() -> None:
    engine = in_memory()
    judges = []
    for _ in range(2):
        judge = Strict()
        world = World(engine, tracks=area_judged_by(judge))
        world.loop.begin()
        judges.append(dict(judge.seen))
        world.live_until(BEGIN + 100.0)
        world.loop.save(BEGIN + 100.0)
    assert judges == [{}, {"d-1": 1}]
    assert world.learner.learned == []
    assert world.loop.report(BEGIN).areas[0].tracks.refused == {"not sure": 2}  # one of them before the restart
    world.loop.take(Erasure(t=0.0, device="d-1"))
    assert judge.seen == {}


class Wary(TestLearner):
    """Wants what is in doubt too."""

    def __init__(self) -> None:
        super().__init__("alignment")
        self.doubted: list[Stretch] = []

    def learn_doubtful(self, stretch: Stretch) -> None:
        self.doubted.append(stretch)


@pytest.mark.parametrize("doubtful", [False, True])
def test_what_is_in_doubt_is_told_to_who_asks_for_it_only(doubtful: bool) -> None:

    def judge(_: Stretch) -> Verdict:
        return Verdict(1.0, 0.1, False, "too short", doubtful)

    wary = Wary()
    world = World(tracks=area_judged_by(judge), lessons=[lesson(wary)])
    world.live_until(BEGIN + 100.0)
    assert bool(wary.doubted) == doubtful
    assert wary.learned == world.learner.learned == []
    assert world.loop.areas["hall"].taught == -math.inf


def test_numbers_of_numpy_in_a_state_are_saved_like_any_other() -> None:
    world = World()
    world.learner.known = {"rate": np.float64(0.5), "row": np.arange(2)}
    world.loop.save(BEGIN)
    assert world.loop.store.states.read()["test-radio"] == b'{"rate":0.5,"row":[0,1]}'


@pytest.mark.parametrize(
    ("regretted", "told"), [((0.2, 0.1), ["activated", "rolled back"]), ((0.05, 0.1), ["activated"])]
)
def test_what_fusion_cannot_try_goes_back_when_its_learner_regrets_it(
    regretted: tuple[float, float], told: list[str]
) -> None:
    world = World()
    world.walker.proposals = [
        Proposal("stride", "d-1", "hall", stride("d-1"), BEFORE, gain=0.3, margin=0.1, reason="learned")
    ]
    world.live_until(BEGIN + 20.0)
    world.walker.proposals = []
    assert world.loop.store.on_probation(), "too little has come to tell"
    world.walker.regretted = regretted
    world.live_until(BEGIN + 40.0, BEGIN + 20.0)
    assert world.decisions() == told
    assert not world.loop.store.on_probation()


def test_a_correction_of_a_calibration_that_is_no_more_is_taken_back_by_itself(project: Path) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    camera = site.cameras[0]
    shift = (1.0, 0.0, 0.4, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    digest = geometry_digest(camera.geometry)
    model = CameraAlignment(t=BEGIN, camera=camera.id, version=0, homography=shift, geometry=digest)
    first = World(site=site)
    first.loop.store.activate(model, "alignment", camera.id, "hall", Decided(BEGIN, BEGIN, "knocked"))

    same = World(first.engine, site=site)
    same.loop.begin()
    same.loop.look(BEGIN + 10.0)
    assert [one.homography for one in same.sent if isinstance(one, CameraAlignment)] == [shift]

    pose = PoseGeometry(kind="pose", image_size=(640, 360), position=(1, 1, 4), look_at=(9, 6, 0), horizontal_fov=80)
    other = site.model_copy(update={"cameras": [camera.model_copy(update={"geometry": pose}), *site.cameras[1:]]})
    anew = World(first.engine, site=other)
    anew.loop.begin()
    anew.loop.look(BEGIN + 20.0)
    (told,) = [one for one in anew.sent if isinstance(one, CameraAlignment)]
    assert (told.homography, told.version) == ((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), 2)
    newest = anew.loop.store.history()[0]
    assert (newest.decision, newest.by) == ("rolled back", "learning")
    assert "was calibrated anew" in newest.reason
    assert "another calibration" in anew.loop.store.problem(model), "nor by hand can it go live again"
