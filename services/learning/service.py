"""Learning as a process: tracks, detections and phones in; models out, when they win."""

from __future__ import annotations

import functools
import queue
import threading
import time
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import msgspec
import structlog
from prometheus_client import Counter, Gauge
from sqlalchemy.exc import SQLAlchemyError

from services.learning.activation.content import Contents
from services.learning.activation.database import SCHEMA, migrate, open_learning
from services.learning.activation.gate import Gate
from services.learning.activation.kinds import PERSONAL, kind_of, subject_of
from services.learning.activation.store import ModelStore
from services.learning.cameras.detector_lessons import NO_PICTURES
from services.learning.commands import Commands
from services.learning.faults import REST
from services.learning.learners import Tools, areas_of, lessons_of
from services.learning.loop import LearningLoop
from services.learning.settings import LearningSettings
from services.learning.thread_executor import DaemonExecutor
from shared.acknowledgements import Acknowledgements
from shared.bus import Bus, Publisher, Question
from shared.database import unreachable
from shared.messages import (
    CameraStatus,
    DetectionFrame,
    Erasure,
    Message,
    MotionBatch,
    RadioScan,
    Revision,
    TrackFrame,
)
from shared.runner import Health, Service, ServiceError
from shared.settings import SettingsError
from shared.setup_told import FollowedSite, SetupTold
from shared.site import Site

__all__ = ["LearningService"]

log = structlog.get_logger(__name__)

TURN = 1.0
"""Seconds between two looks at most."""
NOBODY_FOR = 3600.0
"""Seconds without a stretch that may teach that are told of."""
PUBLISHERS_KEPT = 10_000
DATABASE = "database"

LIVE = Counter("atrium_learning_published_total", "Models published, those of before a restart included", ["kind"])
TRYING = Gauge("atrium_learning_seconds_since_stretch", "Since the last stretch that could teach", ["area"])


class LearningService(Service[LearningSettings]):
    """Learns one site."""

    name = "learning"
    Settings = LearningSettings

    def __init__(self, settings: LearningSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        url = settings.learning_database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        self._engine = open_learning(url)
        problem = SCHEMA.problem(self._engine)
        if problem is not None:
            raise ServiceError(problem)
        areas = settings.areas or [area.id for area in site.areas]
        self._turn_of_area = {area: threading.Lock() for area in areas}
        tools = Tools(self._redetect, self._rescore, DaemonExecutor(), self.stopping.wait)
        self.loop = LearningLoop(
            areas_of(site, areas),
            lessons_of(site, areas, tools),
            Gate(),
            ModelStore(self._engine, Contents(site)),
            self._rescore,
            self._send,
            settings.pace(),
            activate=settings.activate,
            executor=DaemonExecutor(),
            retract=self._retract,
        )
        self._commands = Commands(self.loop, site)
        self._publishers: OrderedDict[str, Publisher[Message]] = OrderedDict()
        self._questions: queue.SimpleQueue[tuple[Question, bool]] = queue.SimpleQueue()
        """With whether it is an order; else the report is asked for."""
        self._acknowledged = Acknowledgements(bus, self.keys, self.name)
        self._failed: set[str] = set()
        """Lessons whose failure the health page tells."""
        self._began = time.monotonic()
        self._followed = FollowedSite(settings.site_file, site, health)
        self._inbox = bus.inbox(capacity=20_000)

    @classmethod
    def check(cls, settings: LearningSettings, site: Site) -> None:
        """Refuse areas that do not exist."""
        known = [area.id for area in site.areas]
        for area in settings.areas:
            if area not in known:
                raise SettingsError(
                    f"areas: {area!r} is no area of the site; allowed: {', '.join(known)}; "
                    "set it by --areas or ATRIUM_AREAS"
                )

    def run(self) -> None:
        """Learn until asked to stop."""
        self._begin()
        # Cached, and first: whoever withdrew consent while this process was down is in the state it restored.
        self._inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        self._inbox.subscribe(self.keys.tracks(), TrackFrame)
        self._inbox.subscribe(self.keys.revisions(), Revision)
        self._inbox.subscribe(self.keys.camera_status(), CameraStatus, cached=True)
        self._inbox.subscribe(self.keys.detections(), DetectionFrame, newest=True, depth=64)
        self._inbox.subscribe(self.keys.radio(), RadioScan)
        self._inbox.subscribe(self.keys.motion(), MotionBatch)
        self._inbox.subscribe(self.keys.setup(), SetupTold, cached=True)
        self.bus.answer_questions(self.keys.learning_report(), lambda question: self._ask(question, order=False))
        self.bus.answer_questions(self.keys.learning_command(), lambda question: self._ask(question, order=True))
        self.health.ready.set()
        looked = time.monotonic()  # the first turn publishes phones' models: not before those erasures were heard
        while not self.stopping.is_set():
            for delivery in self._inbox.receive(timeout=TURN):
                self._guarded(lambda message=delivery.message: self._take(message))
            while not self._questions.empty():
                self._answer(*self._questions.get())
            if time.monotonic() - looked >= TURN:
                self._guarded(lambda: self.loop.look(time.time()))
                self._acknowledged.tell_gone()
                self._tell_health()
                looked = time.monotonic()
        self._guarded(lambda: self.loop.save(time.time()))
        self._engine.dispose()

    def stop(self) -> None:
        """Wake the loop so that it ends at once."""
        super().stop()
        self._inbox.wake()

    def _begin(self) -> None:
        try:
            self.loop.begin()
        except SQLAlchemyError as error:
            raise ServiceError(unreachable(self._engine, error)) from error

    def _take(self, message: Message) -> None:
        if isinstance(message, SetupTold):
            if self._followed.take(message):
                self.begin_anew(self._followed.site)
            return
        if isinstance(message, Erasure):
            self._retract(message.device)  # first: whether or not the database is there
            self._acknowledged.await_gone(message.device, functools.partial(self._forgot, message.device))
        self.loop.take(message)

    def _retract(self, device: str) -> None:
        """Close a phone's publishers, and with them what they keep for late joiners."""
        for kind in PERSONAL:
            publisher = self._publishers.pop(f"{kind}/{device}", None)
            if publisher is not None:
                publisher.close()
        self.loop.decisions.forget(device)

    def _forgot(self, device: str) -> bool:
        return not self.loop.holds(device)

    def _guarded(self, work: Any) -> None:
        """Do something that needs the database; while that is away, learning goes on in memory and says so."""
        try:
            work()
        except SQLAlchemyError as error:
            self.health.degraded(DATABASE, f"{unreachable(self._engine, error)}; nothing goes live meanwhile")
        else:
            self.health.well(DATABASE)

    # -- asked and asking ----------------------------------------------------------------------------------------------

    def _ask(self, question: Question, *, order: bool) -> None:
        """Hand a question to the loop's thread."""
        self._questions.put((question, order))
        self._inbox.wake()

    def _answer(self, question: Question, order: bool) -> None:
        now = time.time()
        try:
            if order:
                question.answer(self._commands.answer(question.payload, now))
            else:
                question.answer(msgspec.json.encode(self.loop.report(now)))
        except SQLAlchemyError as error:
            words = f"not done: {unreachable(self._engine, error)}"
            question.answer(msgspec.json.encode({"done": False, "words": words}))
        except Exception as error:  # whoever asks again and again must not end learning again and again
            log.error("a question could not be answered", exc_info=error)
            words = f"not done: learning failed ({type(error).__name__}); its log says more"
            question.answer(msgspec.json.encode({"done": False, "words": words}))

    def _rescore(self, area: str, question: bytes) -> Mapping[str, Any]:
        """Ask fusion of an area, which tries one candidate at a time; called in threads of their own, in turns."""
        with self._turn_of_area[area]:
            return self._asked(self.keys.rescore(area), question, f"fusion of area {area} does not answer")

    def _redetect(self, camera: str, options: Mapping[str, float]) -> Mapping[str, Any]:
        question = msgspec.json.encode({"options": dict(options)})
        silence = f"{NO_PICTURES} no process of camera {camera} answers; it is simulated, or down"
        return self._asked(self.keys.redetect(camera), question, silence)

    def _asked(self, key: str, question: bytes, silence: str) -> Mapping[str, Any]:
        for _, payload in self.bus.ask(key, self.settings.patience, question):
            try:
                answer = msgspec.json.decode(payload, type=dict[str, Any])
            except msgspec.DecodeError as error:
                return {"error": f"busy: what {key} answers is not understood: {error}"}
            return answer
        return {"error": silence}

    def _send(self, model: Message) -> None:
        """Publish a live model, kept for whoever joins later."""
        kind, subject = kind_of(model), subject_of(model)
        key = {
            "radio": self.keys.radio_model,
            "detector": self.keys.detector_settings,
            "stride": self.keys.stride_model,
            "heading": self.keys.heading_model,
            "alignment": self.keys.alignment,
        }[kind](subject)
        name = f"{kind}/{subject}"
        publisher = self._publishers.pop(name, None) or self.bus.publisher(key, type(model), cached=True)
        self._publishers[name] = publisher
        if len(self._publishers) > PUBLISHERS_KEPT:
            self._publishers.popitem(last=False)[1].close()
        publisher.publish(model)
        LIVE.labels(kind).inc()

    def _tell_health(self) -> None:
        running = time.monotonic() - self._began
        for name, area in self.loop.areas.items():
            words, topic = self.loop.words(name), f"area {name}"
            if words.startswith("waits: ") and "does not answer" in words:
                self.health.degraded(topic, f"learning {words}")
            elif running > NOBODY_FOR and area.t - area.taught > NOBODY_FOR:
                self.health.degraded(topic, "nobody with a phone has walked well in view for an hour: nothing teaches")
            else:
                self.health.well(topic)
            if area.taught > 0.0:
                TRYING.labels(name).set(area.t - area.taught)
        unused = self.loop.decisions.untold()
        if unused:
            mend = "`atrium models rollback` returns to the one before"
            self.health.degraded("live models", f"{'; '.join(unused[:5])}; {mend}")
        else:
            self.health.well("live models")
        troubles = self.loop.troubles()
        for lesson, (areas, words) in troubles.items():
            where = f"area{'s' * (len(areas) > 1)} {', '.join(sorted(areas))}"
            again = f"this is tried again after {REST / 60.0:.0f} minutes, all else goes on; the log says more"
            self.health.degraded(f"lesson {lesson}", f"{where}: {words}; {again}")
        for lesson in self._failed - troubles.keys():
            self.health.well(f"lesson {lesson}")
        self._failed = set(troubles)
        for lesson, words in self.loop.set_aside().items():
            self.health.degraded(f"state {lesson}", words)
