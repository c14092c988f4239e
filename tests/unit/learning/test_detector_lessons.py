"""The learner of detector options: when it sweeps, what it asks, and what stops it."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from typing import Any

import msgspec
import numpy as np
import pytest

from services.learning.cameras.detector_lessons import EVERY, FEWEST, RARELY, DetectorLessons
from services.learning.lesson import Watching
from services.learning.proposal import Learner
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from shared.messages import CameraStatus, DetectorSettings

CHANGES: tuple[tuple[tuple[str, Any], str], ...] = (
    (("error", "its pictures cannot teach: it is covered"), "covered"),
    (("moves", True), "well as can be told"),
    (("turns", True), "well as can be told"),
)
NONE = np.zeros(0)
WALK = Stretch(
    device="phone",
    track=1,
    t=np.arange(2.0),
    place=np.zeros((2, 2)),
    covariance=np.zeros((2, 2, 2)),
    probability=np.ones(2),
    seen=np.ones(2, np.bool_),
    sight=np.ones(2),
    scan_t=NONE,
    point=NONE.astype(np.int64),
    level=NONE,
    scan_place=np.zeros((0, 2)),
    scan_spread=NONE,
    step_t=NONE,
    length=NONE,
    length_variance=NONE,
    heading=NONE,
    heading_variance=NONE,
    walk=NONE.astype(np.int64),
)


class Later(Executor):
    """Runs what was submitted when it is told to."""

    def __init__(self) -> None:
        self.waiting: list[Callable[[], None]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()

        def work() -> None:
            try:
                future.set_result(fn(*args, **kwargs))
            except Exception as error:
                future.set_exception(error)

        self.waiting.append(work)
        return future

    def run(self) -> None:
        while self.waiting:
            self.waiting.pop(0)()


class Site:
    """A camera whose people are followed best at 0.1 per second, and a fusion that scores it."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, float]]] = []
        self.busy = 0
        self.until = 900.0
        self.moves = False
        self.turns = False
        self.alignment = 0
        self.error = ""
        self.sizes: dict[str, float] = {}
        self.held_against: list[float] = []

    def redetect(self, camera: str, options: Mapping[str, float]) -> Mapping[str, Any]:
        if self.error:
            return {"error": self.error}
        if self.busy:
            self.busy -= 1
            return {"error": "busy: other options are being tried; ask again later"}
        self.asked.append((camera, dict(options)))
        self.until += self.moves
        self.alignment += self.turns
        plain = {"learning_rate": 0.003, "sensitivity": 16.0, "least_gain": 0.1, "height_scale": 1.0}
        used = {**plain, **options}
        told = {"since": 600.0, "until": self.until, "options": used, "alignment": self.alignment}
        told |= {"sizes": self.sizes}
        return {"frames": [{"camera": camera, "x": [1.0], **used}], **told}

    def rescore(self, area: str, question: bytes) -> Mapping[str, Any]:
        asked = msgspec.json.decode(question)
        assert asked["kind"] == "detections"
        [(camera, [frame])] = asked["frames"].items()
        self.held_against.append(asked["active"][camera][0]["learning_rate"])
        off = math.log10(frame["learning_rate"] / 0.1) ** 2 + 4.0 * math.log(frame["sensitivity"] / 16.0) ** 2
        off += 20.0 * math.log(frame["height_scale"] / 0.9) ** 2
        return {"sight": {"candidate": 50.0 - 10.0 * off, "gain_error": 0.5}}


def lessons(site: Site, executor: Later, *cameras: str) -> DetectorLessons:
    made = DetectorLessons("hall", cameras, site.redetect, site.rescore, executor, lambda _: None)
    checked: Learner = made
    for _ in range(FEWEST):
        checked.learn(WALK)
    return made


def test_a_sweep_runs_beside_the_learner_and_is_proposed_when_it_is_over() -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "door")
    assert learner.propose(1000.0, 900.0) == ()
    assert learner.propose(1010.0, 900.0) == ()
    assert site.asked == []
    executor.run()
    [proposal] = learner.propose(1020.0, 900.0)
    assert isinstance(proposal.model, DetectorSettings)
    assert proposal.model.options["learning_rate"] == pytest.approx(0.1, rel=0.25)
    assert "sensitivity" not in proposal.model.options
    assert site.held_against[0] == 0.003
    assert site.held_against[-1] == proposal.model.options["learning_rate"]
    assert len(site.asked) == len({tuple(sorted(options.items())) for _, options in site.asked}), "detected twice"
    assert (proposal.trained_until, proposal.subject, proposal.area) == (900.0, "door", "hall")
    assert "learning_rate" in learner.words["door"]
    assert learner.propose(1030.0, 900.0) == ()


def test_cameras_take_turns_and_nobody_walking_means_no_sweep() -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "door", "window")
    learner.propose(1000.0, 900.0)
    executor.run()
    learner.propose(1100.0, 900.0)
    learner.propose(1000.0 + EVERY, 900.0)
    assert {camera for camera, _ in site.asked} == {"door"}  # nobody has walked since
    for _ in range(FEWEST):
        learner.learn(WALK)
    again = DetectorLessons("hall", ["door", "window"], site.redetect, site.rescore, executor, lambda _: None)
    again.restore(learner.state())
    for _ in range(FEWEST):
        again.learn(WALK)
    again.propose(1500.0, 900.0)  # too early, also after a restart
    assert not executor.waiting
    again.propose(1000.0 + EVERY, 900.0)
    executor.run()
    assert site.asked[-1][0] == "window"
    with pytest.raises(ValueError, match="swept"):
        again.restore({"swept": {"door": "soon"}})


def test_what_is_active_is_kept_and_a_change_in_mid_sweep_drops_it() -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "door")
    learner.activated(DetectorSettings(t=1.0, camera="door", version=3, options={"least_gain": 0.2}))
    learner.propose(1000.0, 900.0)
    executor.run()
    assert all(options["least_gain"] == 0.2 for _, options in site.asked)
    [proposal] = learner.propose(1020.0, 900.0)
    assert isinstance(proposal.model, DetectorSettings)
    assert proposal.model.options["least_gain"] == 0.2
    for _ in range(FEWEST):
        learner.learn(WALK)
    learner.propose(1020.0 + EVERY, 900.0)
    learner.activated(DetectorSettings(t=1.0, camera="door", version=4))
    executor.run()
    assert learner.propose(1030.0 + EVERY, 900.0) == ()


def test_who_is_busy_is_asked_again_and_other_refusals_are_told() -> None:
    site, executor = Site(), Later()
    site.busy = 7
    learner = lessons(site, executor, "door")
    learner.propose(1000.0, 900.0)
    executor.run()
    assert learner.propose(1020.0, 900.0)
    for change, told in CHANGES:
        site, executor = Site(), Later()
        setattr(site, *change)
        learner = lessons(site, executor, "door")
        learner.propose(1000.0, 900.0)
        executor.run()
        assert learner.propose(1020.0, 900.0) == ()
        assert told in learner.words["door"]


@pytest.mark.parametrize("answer", [{}, {"frames": [], "since": 1.0, "until": 2.0, "options": "many"}])
def test_what_is_no_answer_of_a_camera_is_told_and_changes_nothing(answer: Mapping[str, Any]) -> None:
    executor = Later()
    learner = DetectorLessons("hall", ["door"], lambda *_: answer, Site().rescore, executor, lambda _: None)
    for _ in range(FEWEST):
        learner.learn(WALK)
    learner.propose(1000.0, 900.0)
    executor.run()
    assert learner.propose(1020.0, 900.0) == ()
    assert learner.words["door"].startswith("what camera door answers is not understood")


def words(learner: DetectorLessons, camera: str) -> str:
    draft = ReportDraft()
    learner.tell(draft)
    return next(told.words for told in draft.report(1.0, False, []).cameras if told.camera == camera)


def test_a_camera_without_pictures_is_asked_rarely_and_holds_up_no_other() -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "simulated", "door")
    site.error = "no pictures: no process of camera simulated answers"
    learner.propose(1000.0, 900.0)
    executor.run()
    learner.propose(1060.0, 900.0)
    assert "no pictures" in words(learner, "simulated")
    site.error = ""
    for _ in range(FEWEST):
        learner.learn(WALK)
    again = DetectorLessons("hall", ["simulated", "door"], site.redetect, site.rescore, executor, lambda _: None)
    again.restore(learner.state())
    for _ in range(FEWEST):
        again.learn(WALK)
    again.propose(1120.0, 900.0)  # the other one need not wait for an hour
    executor.run()
    assert {camera for camera, _ in site.asked} == {"door"}
    for now in (1180.0, 1120.0 + EVERY, 1120.0 + 2.0 * EVERY, 1060.0 + RARELY):
        for _ in range(FEWEST):
            again.learn(WALK)
        again.propose(now, 900.0)
        executor.run()
        again.propose(now + 1.0, 900.0)
        assert {camera for camera, _ in site.asked} == ({"door", "simulated"} if now > RARELY else {"door"})


def test_it_tells_what_it_waits_for_and_which_version_is_in_use() -> None:
    site, executor = Site(), Later()
    learner = DetectorLessons("hall", ["door"], site.redetect, site.rescore, executor, lambda _: None)
    learner.learn(WALK)
    assert f"1 of {FEWEST} walks" in words(learner, "door")
    for _ in range(FEWEST):
        learner.learn(WALK)
    learner.propose(1000.0, 900.0)
    assert "being tried" in words(learner, "door")
    learner.activated(DetectorSettings(t=1.0, camera="door", version=7, options={"least_gain": 0.2}))
    draft = ReportDraft()
    learner.tell(draft)
    [told] = draft.report(1.0, False, []).cameras
    assert (told.version, told.options) == (7, {"least_gain": 0.2})


def test_a_camera_that_is_covered_teaches_nothing_and_says_why() -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "door")
    assert isinstance(learner, Watching)  # or nobody would tell it
    learner.propose(1000.0, 900.0)
    learner.watch(CameraStatus(t=1001.0, camera="door", state="degraded", reason="it is covered"))
    executor.run()
    assert learner.propose(1010.0, 900.0) == ()  # what was found on the way is not believed
    assert "learns nothing while it is degraded: it is covered" in words(learner, "door")
    for _ in range(FEWEST):
        learner.learn(WALK)
    learner.propose(1000.0 + EVERY, 900.0)
    assert not executor.waiting
    learner.watch(CameraStatus(t=1002.0 + EVERY, camera="door", state="ok"))
    learner.propose(1003.0 + EVERY, 900.0)
    assert executor.waiting


@pytest.mark.parametrize(("measured", "taken"), [(0.9, True), (1.15, False), (1.005, None)])
def test_the_sizes_a_camera_measured_are_tried_and_told_of(measured: float, taken: bool | None) -> None:
    site, executor = Site(), Later()
    site.sizes = {"height_scale": measured}
    learner = lessons(site, executor, "door")
    learner.propose(1000.0, 900.0)
    executor.run()
    assert any(options.get("height_scale") == measured for _, options in site.asked) is (taken is not None)
    [proposal] = learner.propose(1020.0, 900.0)
    assert isinstance(proposal.model, DetectorSettings)
    assert ("height_scale" in proposal.model.options) is bool(taken)
    told = words(learner, "door")
    if taken:
        assert "people look 10 % smaller" in told
    elif taken is not None:
        assert "people look 15 % taller than the camera is configured for, but would be followed no better" in told
    else:
        assert "people look" not in told


def test_sizes_that_the_detector_has_no_options_for_are_left_alone() -> None:
    site, executor = Site(), Later()
    site.sizes = {"girth": 2.0}
    learner = lessons(site, executor, "door")
    learner.propose(1000.0, 900.0)
    executor.run()
    assert not any("girth" in options for _, options in site.asked)


@pytest.mark.parametrize("reason", ["a model change", "degraded for a second"])
def test_a_sweep_that_counts_for_nothing_is_made_again_at_once_and_never_two_at_a_time(reason: str) -> None:
    site, executor = Site(), Later()
    learner = lessons(site, executor, "door")
    learner.propose(1000.0, 900.0)
    for t in (1001.0, 1002.0):
        if reason == "a model change":
            learner.activated(DetectorSettings(t=t, camera="door", version=int(t)))
        else:
            learner.watch(CameraStatus(t=t, camera="door", state="degraded", reason="it is covered"))
            learner.watch(CameraStatus(t=t, camera="door", state="ok"))
    assert words(learner, "door") == "its detector's options are tried soon"
    assert learner.state()["swept"] == {}
    assert learner.propose(1060.0, 900.0) == ()
    assert len(executor.waiting) == 1, "the one that counts for nothing is still at work"
    executor.run()
    assert learner.propose(1120.0, 900.0) == ()
    assert len(executor.waiting) == 1
    assert "being tried" in words(learner, "door")
    executor.run()
    [proposal] = learner.propose(1180.0, 900.0)
    assert proposal.subject == "door"
    learner.propose(1240.0, 900.0)
    assert not executor.waiting, "the same walks do not judge twice"
