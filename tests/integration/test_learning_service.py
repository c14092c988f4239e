"""Learning on a real router with a database: a candidate wins, goes live, is kept, goes back when told to."""

import dataclasses
import itertools
import json
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest
from fusion_world import frame
from health_page import metric
from learning_models import TestLearner, lesson, power_of, radio, stride, walk
from service_process import process
from sqlalchemy import select
from sqlalchemy.orm import Session
from typer.testing import CliRunner
from waiting import wait_until

from services.cli.main import app
from services.cli.models import ModelsError, order
from services.learning import service as module
from services.learning.activation.database import migrate, open_learning
from services.learning.activation.rows import Decided
from services.learning.activation.store import ModelStore
from services.learning.activation.tables import ModelRow
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.service import LearningService
from services.learning.settings import LearningSettings
from shared.bus import Bus, Inbox, Question
from shared.keys import Keys
from shared.learning_report import LearningReport
from shared.messages import (
    DetectionFrame,
    Erasure,
    ErasureDone,
    Message,
    RadioModelUpdate,
    StrideModel,
    TrackFrame,
    encode,
)
from shared.runner import Health
from shared.settings import SettingsError
from shared.site import Site, load_site

KEYS = Keys("hall")
SITE = "deploy/sites/hall/site.yaml"
POINTS = [f"ap-{number}" for number in range(1, 7)]
DEADLINE = 20.0


class Fusion:
    """Answers ``rescore``: candidates win, what is configured does not."""

    def __init__(self, bus: Bus) -> None:
        self.asked: list[dict[str, Any]] = []
        self.gain = 0.1
        bus.answer_questions(KEYS.rescore("hall"), self.take)

    def take(self, question: Question) -> None:
        self.asked.append(json.loads(question.payload))
        devices = {name: {"scans": 90, "gain": self.gain} for name in ("d-1", "d-2")}
        told = {"scans": 180, "seconds": 200.0, "gain": self.gain, "gain_error": 0.001, "devices": devices}
        question.answer(json.dumps(told).encode())


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / SITE)


@contextmanager
def running(
    site: Site, project: Path, folder: Path, endpoint: str, learner: TestLearner, **changes: Any
) -> Iterator[LearningService]:
    settings = LearningSettings(
        site_file=project / SITE,
        profile="demo",
        bus=[endpoint],
        learning_database_url=f"sqlite:///{folder / 'learning.db'}",  # type: ignore[arg-type]
        learn_every=0.1,
        held_out_minutes=1.0,
        **changes,
    )
    with pytest.MonkeyPatch.context() as patch, Bus([endpoint]) as bus:
        lessons = [lesson(learner)]
        patch.setattr(module, "lessons_of", lambda *_: lessons)
        patch.setattr(module, "TURN", 0.05)
        health = Health.__new__(Health)  # a second one in one process would register its gauge twice
        health.__dict__.update(_problems={}, _lock=threading.Lock(), ready=threading.Event())
        service = LearningService(settings, site, bus, health)
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        assert health.ready.wait(DEADLINE)
        try:
            with Bus([endpoint]) as outside:  # the router hears of what answers a moment later than it is declared
                wait_until(lambda: list(outside.ask(KEYS.learning_report())), DEADLINE, "a report")
            yield service
        finally:
            service.stop()
            thread.join(DEADLINE)
            assert not thread.is_alive()


def proposed(power: float, until: float = 0.0) -> Proposal:
    return Proposal("radio", "hall", "hall", radio("hall", power, "hall", POINTS), until, b'{"kind":"radio"}')


def models(bus: Bus, key: str, kind: type[Message]) -> Inbox:
    inbox = bus.inbox()
    inbox.subscribe(key, kind, cached=True)
    return inbox


def next_message(inbox: Inbox) -> Any:
    return wait_until(lambda: inbox.receive(timeout=0.1), DEADLINE, "a model")[-1].message


def report(bus: Bus) -> LearningReport:
    told = wait_until(lambda: list(bus.ask(KEYS.learning_report())), DEADLINE, "a report")
    return msgspec.json.decode(told[0][1], type=LearningReport)


def test_a_candidate_that_wins_is_published_kept_for_late_joiners_and_taken_back_by_order(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    learner = TestLearner()
    learner.proposals = [proposed(-41.0)]
    with Bus([zenoh_router]) as bus:
        fusion = Fusion(bus)
        with running(site, project, tmp_path, zenoh_router, learner):
            assert report(bus).areas[0].words == "waits: fusion has told no tracks yet"
            bus.publisher(KEYS.tracks("hall"), TrackFrame).publish(walk(1.0, 1000.0)[0])
            live = next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))
            assert (power_of(live), live.version) == (-41.0, 1)
            assert fusion.asked[0]["since"] == 0.0
            late = next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))
            assert late == live
            told = report(bus)
            assert (told.history[0].decision, told.areas[0].version) == ("activated", 1)
            with pytest.raises(ModelsError, match="no radio model of 'east' is active; allowed: hall"):
                order(bus, "hall", {"do": "rollback", "kind": "radio", "subject": "east"})
            answer = order(bus, "hall", {"do": "rollback", "kind": "radio", "subject": "hall", "by": "staff"})
            assert answer.version == 2
            back = next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))
            assert (power_of(back), back.version) == (None, 2)
            assert report(bus).history[0].reason == "ordered by hand (staff)"
        with running(site, project, tmp_path, zenoh_router, TestLearner()):
            again = next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))
            assert again == back, "what is live is published again at every start"


def test_a_radio_model_reaches_a_running_fusion_and_a_roll_back_by_the_command_line_takes_it_back(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    learner = TestLearner()
    won = proposed(-41.0)
    learner.proposals = [dataclasses.replace(won, gain=1.0, margin=0.1)]  # what fusion tries is not asked here
    fusion = process("services.fusion", tmp_path, zenoh_router, project / SITE, ATRIUM_AREA="hall")
    with Bus([zenoh_router]) as bus, fusion as health:
        camera = bus.publisher(KEYS.detections("hall-east"), DetectionFrame)
        number, begin = itertools.count(), time.time()
        port = urlsplit(health).port
        assert port is not None

        def uses(version: int) -> bool:
            seen = next(number)
            camera.publish(frame(begin + seen / 10.0, [(10.0 + 0.05 * (seen % 50), 6.0)], "hall-east", seen))
            return metric(port, "atrium_fusion_radio_version") == version

        def live() -> Any:
            ((_, state),) = bus.ask(KEYS.fusion_state("hall"))
            return json.loads(state)["model"]

        wait_until(lambda: uses(0), DEADLINE, "fusion to run as configured")
        with running(site, project, tmp_path, zenoh_router, learner) as service:
            wait_until(lambda: uses(1), DEADLINE, "fusion to adopt the model")
            assert live()["model"]["power_1m"] == [-41.0] * 6
            learner.proposals = []
            done = CliRunner().invoke(
                app, ["models", "rollback", "radio", "hall", "--site", "hall", "--bus", zenoh_router]
            )
            assert "is back at what it was, now version 2" in " ".join(done.output.split())
            wait_until(lambda: uses(2), DEADLINE, "fusion to go back")
            assert (live()["version"], live()["model"]) == (2, None)
            assert [one.decision for one in service.loop.store.history()] == ["rolled back", "activated"]


def test_models_move_to_another_installation_by_the_command_line(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    def atrium(*arguments: str) -> str:
        done = CliRunner().invoke(app, ["models", *arguments, "--site", "hall", "--bus", zenoh_router])
        assert done.exit_code in (0, 1), done.output
        return " ".join(done.output.split())

    learner = TestLearner()
    learner.proposals = [proposed(-41.0)]
    file = tmp_path / "models.json"
    with Bus([zenoh_router]) as bus:
        Fusion(bus)
        (tmp_path / "first").mkdir()
        with running(site, project, tmp_path / "first", zenoh_router, learner):
            bus.publisher(KEYS.tracks("hall"), TrackFrame).publish(walk(1.0, 1000.0)[0])
            next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))
            assert "1 models that are live, written to" in atrium("export", str(file))
            assert "radio hall 1 active" in atrium("list")
        with running(site, project, tmp_path, zenoh_router, TestLearner()):
            assert "is frozen" not in atrium("list")
            atrium("freeze")
            assert "1 models taken in, live once they win" in atrium("import", str(file))
            assert "activation is frozen" in atrium("list")
            version = order(bus, "hall", {"do": "list"}).models[0].version
            assert "is live as version" in atrium("activate", "radio", "hall", str(version))
            assert power_of(next_message(models(bus, KEYS.radio_model("hall"), RadioModelUpdate))) == -41.0
            assert "--camera: found 'old'; allowed: OLD=NEW" in atrium("import", str(file), "--camera", "old")
            wrong = "kind: found 'rado'; allowed: radio, detector, stride, heading, alignment"
            assert wrong in atrium("rollback", "rado", "hall")
            file.write_text("[]")
            assert "bundle: no document of models" in atrium("import", str(file))


def test_who_withdraws_leaves_no_model_on_the_bus_and_no_row(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    learner = TestLearner("stride")
    learner.proposals = [Proposal("stride", "d-1", "hall", stride("d-1"), 0.0, gain=1.0, margin=0.1)]
    learner.known = {"d-1": 3}
    with Bus([zenoh_router]) as bus, running(site, project, tmp_path, zenoh_router, learner) as service:
        bus.publisher(KEYS.tracks("hall"), TrackFrame).publish(walk(1.0, 1000.0)[0])
        assert next_message(models(bus, KEYS.stride_model("d-1"), StrideModel)).slope == 0.3
        acknowledged = bus.inbox()
        acknowledged.subscribe(KEYS.erased("d-1", "learning"), ErasureDone, cached=True)
        gone = bus.publisher(KEYS.erasure("d-1"), Erasure, cached=True)
        gone.publish(Erasure(t=1001.0, device="d-1"))
        wait_until(lambda: learner.forgotten, DEADLINE, "the erasure")
        wait_until(lambda: not order(bus, "hall", {"do": "list"}).models, DEADLINE, "no row")
        assert report(bus).history == []
        wait_until(lambda: service.loop.store.states.read()["test-stride"] == b"{}", DEADLINE, "nothing saved of it")
        wait_until(lambda: acknowledged.receive(timeout=0.1), DEADLINE, "learning to tell that it is done")
        late = models(bus, KEYS.stride_model("d-1"), StrideModel)
        order(bus, "hall", {"do": "list"})  # what is kept for late joiners would have come meanwhile
        assert late.receive(timeout=0.2) == []


def test_a_live_model_that_nobody_can_use_ends_nothing_and_is_told_until_it_is_rolled_back(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    url = f"sqlite:///{tmp_path / 'learning.db'}"
    migrate(url)
    engine = open_learning(url)
    ModelStore(engine).activate(stride("d-1"), "stride", "d-1", "hall", Decided(50.0, 50.0, "wins"))
    with Session(engine) as session, session.begin():  # as a program without these checks has left it
        row = session.scalars(select(ModelRow)).one()
        row.subject, row.payload = "d/../*", encode(stride("d/../*"))
    with running(site, project, tmp_path, zenoh_router, TestLearner()) as service, Bus([zenoh_router]) as bus:

        def told() -> str:
            return service.health.problems().get("live models", "")

        wait_until(told, DEADLINE, "a word on it")
        assert "found a subject called 'd/../*'" in told()
        assert order(bus, "hall", {"do": "rollback", "kind": "stride", "subject": "d/../*"}).done
        wait_until(lambda: not told(), DEADLINE, "all well")


def test_while_fusion_is_away_learning_says_so(site: Site, project: Path, tmp_path: Path, zenoh_router: str) -> None:
    learner = TestLearner()
    learner.proposals = [proposed(-41.0)]
    with Bus([zenoh_router]) as bus, running(site, project, tmp_path, zenoh_router, learner) as service:
        bus.publisher(KEYS.tracks("hall"), TrackFrame).publish(walk(1.0, 1000.0)[0])
        problems = wait_until(service.health.problems, DEADLINE, "a word on the health page")
        assert problems == {"area hall": "learning waits: fusion of area hall does not answer"}


class Singular(TestLearner):
    """Cannot propose; its report is none."""

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        raise np.linalg.LinAlgError("singular")

    def tell(self, draft: ReportDraft) -> None:
        draft.area("hall", nonsense=1)


def test_a_lesson_that_raises_is_told_on_the_health_page_and_learning_goes_on(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    with Bus([zenoh_router]) as bus, running(site, project, tmp_path, zenoh_router, Singular()) as service:
        assert service.health.problems() == {}
        tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)
        tracks.publish(walk(1.0, 1000.0)[0])
        problems = wait_until(service.health.problems, DEADLINE, "a word on the health page")
        assert problems == {
            "lesson test-radio": "area hall: lesson test-radio could not propose models (LinAlgError); "
            "this is tried again after 5 minutes, all else goes on; the log says more"
        }
        ((_, answer),) = bus.ask(KEYS.learning_report())
        assert json.loads(answer)["words"] == "not done: learning failed (TypeError); its log says more"
        tracks.publish(walk(1.0, 1000.0)[1])
        wait_until(lambda: service.loop.areas["hall"].t == 1000.5, DEADLINE, "the next message")


def test_an_area_that_does_not_exist_is_refused(site: Site, project: Path) -> None:
    settings = LearningSettings(site_file=project / SITE, areas=["attic"])
    with pytest.raises(SettingsError, match=r"areas: 'attic' is no area of the site; allowed: hall; .*ATRIUM_AREAS"):
        LearningService.check(settings, site)


def test_what_is_not_understood_is_told_on_the_health_page_and_who_stayed_away_for_a_month_is_let_go(
    site: Site, project: Path, tmp_path: Path, zenoh_router: str
) -> None:
    url = f"sqlite:///{tmp_path / 'learning.db'}"
    migrate(url)
    before = ModelStore(open_learning(url))
    before.states.save({"test-radio": b'{"broken":1}', "phones": b'{"d-away":0.0}'}, time.time())
    for device in ("d-away", "d-here"):
        before.activate(stride(device), "stride", device, "hall", Decided(time.time(), 0.0, "wins"))
    with running(site, project, tmp_path, zenoh_router, TestLearner()) as service, Bus([zenoh_router]) as bus:
        heard = models(bus, KEYS.stride_model("*"), StrideModel)
        told = wait_until(service.health.problems, DEADLINE, "a word on the health page")
        assert "kept for 30 days" in told["state test-radio"]
        assert next_message(heard).device == "d-here"
        assert before.phones() == {"d-here"}
        assert "aside/test-radio" in before.states.read()
