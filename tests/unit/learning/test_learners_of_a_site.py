"""The learners of a site in their places: each kept under a name of its own, judged under the live radio model."""

from pathlib import Path

import msgspec
import pytest
from learning_models import radio, walk

from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.rows import Decided
from services.learning.activation.store import ModelStore
from services.learning.learners import Tools, areas_of, lessons_of
from services.learning.lessons import _plain
from services.learning.loop import PHONES, LearningLoop
from services.learning.trials import Inline
from shared.erased import Erased
from shared.messages import CameraStatus, Erasure, Message, RadioModelUpdate
from shared.site import Site, load_site

POINTS = [f"ap-{number}" for number in range(1, 7)]
NOBODY = Tools(
    lambda *_: {"error": "camera away"}, lambda *_: {"error": "fusion of area hall away"}, Inline(), lambda _: None
)


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


def loop_of(site: Site, store: ModelStore, sent: list[Message]) -> LearningLoop:
    lessons = lessons_of(site, ["hall"], NOBODY)
    return LearningLoop(areas_of(site, ["hall"]), lessons, Gate(), store, NOBODY.rescore, sent.append)


def test_every_learner_is_kept_under_a_name_of_its_own_and_goes_on_after_a_restart(site: Site) -> None:
    store = ModelStore(in_memory())
    loop = loop_of(site, store, [])
    names = [lesson.name for lesson in loop.lessons]
    assert len(set(names)) == len(names) > 0
    for frame in walk(100.0, 1000.0):
        loop.take(frame)
    loop.look(1100.0)
    loop.save(1100.0)
    again = loop_of(site, store, [])
    again.begin()
    assert {name: state for name, state in store.states.read().items() if name != PHONES} == {
        name: msgspec.json.encode(part.state(), enc_hook=_plain) for name, part in again.lessons._parts()
    }


def test_stretches_are_judged_under_the_model_that_is_live(site: Site) -> None:
    store = ModelStore(in_memory())
    store.activate(radio("hall", -33.0, "hall", POINTS), "radio", "hall", "hall", Decided(1.0, 1.0, "wins"))
    sent: list[Message] = []
    loop = loop_of(site, store, sent)
    loop.begin()
    judge = loop.areas["hall"]._judge
    assert judge._radio.power_1m.tolist() == [-33.0] * 6  # type: ignore[attr-defined]
    loop.decisions.roll_back("radio", "hall", 2.0, "by hand")
    assert judge._radio is judge._filed  # type: ignore[attr-defined]
    assert [one.version for one in sent if isinstance(one, RadioModelUpdate)] == [1, 2]


def test_the_report_tells_why_stretches_do_not_teach(site: Site) -> None:
    area = areas_of(site, ["hall"])["hall"]
    for frame in walk(30.0, 1000.0):
        area.take(frame, Erased())
    for frame in walk(30.0, 1040.0, device="d-2"):
        area.take(frame, Erased())
    assert area.close() == []
    loop = LearningLoop({"hall": area}, [], Gate(), ModelStore(in_memory()), NOBODY.rescore, lambda _: None)
    told = loop.report(2000.0).areas[0].tracks
    assert told.good == 0
    assert sum(told.refused.values()) >= 1
    assert all(told.refused)


def test_a_camera_that_says_it_is_covered_is_told_of(site: Site) -> None:
    loop = loop_of(site, ModelStore(in_memory()), [])
    loop.take(CameraStatus(t=1.0, camera="hall-east", state="degraded", reason="it is covered"))
    [camera] = loop.report(2.0).cameras
    assert "it is covered" in camera.words
    loop.take(CameraStatus(t=2.0, camera="hall-east", state="ok"))
    assert "it is covered" not in loop.report(3.0).cameras[0].words


def test_who_cannot_forget_is_made_anew_in_its_own_place_and_knows_the_live_model(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = ModelStore(in_memory())
    store.activate(radio("hall", -33.0, "hall", POINTS), "radio", "hall", "hall", Decided(1.0, 1.0, "wins"))
    loop = loop_of(site, store, [])
    loop.begin()
    blank = loop.lessons.states()
    before = [one.learner for one in loop.lessons]
    tracks = loop.areas["hall"]

    def raises(_: str) -> None:
        raise IndexError

    for part in (tracks, *before):
        monkeypatch.setattr(part, "forget", raises)
    loop.take(Erasure(t=1000.0, device="d-1"))
    loop.look(1001.0)
    assert loop.areas["hall"] is not tracks
    for one, former in zip(loop.lessons, before, strict=True):
        assert one.learner is not former
        assert type(one.learner) is type(former)
    assert loop.lessons.states() == blank
    assert loop.areas["hall"]._judge._radio.power_1m.tolist() == [-33.0] * 6  # type: ignore[attr-defined]
