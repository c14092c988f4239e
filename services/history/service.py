"""History as a process: what happens goes to the disk, from there into the database; questions come from the bus."""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence

import msgspec
import structlog
from prometheus_client import Counter

from services.history.database import SCHEMA, migrate, open_history
from services.history.desk import Desk, zones_of_site
from services.history.entries import AlertTold, Counted, Entry, Forgotten
from services.history.retention import Tidying
from services.history.sampling import Sampler, plausible
from services.history.settings import HistorySettings
from services.history.spool import Spool
from services.history.writer import DATABASE, DISK, Writer
from shared.acknowledgements import Acknowledgements
from shared.bus import Bus, Question
from shared.erased import Erased
from shared.keys import is_identifier
from shared.messages import Alert, Erasure, Message, Occupancy, Revision, TrackFrame
from shared.runner import Health, Service, ServiceError
from shared.settings import SettingsError
from shared.site import Site
from shared.zones import ZoneDefinition, ZoneSet

__all__ = ["HistoryService"]

log = structlog.get_logger(__name__)

TURN = 0.5
"""Seconds between two looks at the bus at most."""
ANSWERING = 2
"""Questions that are worked on at once."""
WAITING_QUESTIONS = 100
LONGEST_ID = 200
"""Characters of an alert's id."""
LAST_WRITE = 1.5
"""Seconds a stop waits for the database; what is not in by then stays in the spool."""

LOST = Counter("atrium_history_lost_total", "Entries that were not kept: the disk is full or too much waits")
UNANSWERED = Counter("atrium_history_unanswered_total", "Questions that found too many others waiting")


class HistoryService(Service[HistorySettings]):
    """Keeps the past of one site."""

    name = "history"
    Settings = HistorySettings

    def __init__(self, settings: HistorySettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        url = settings.history_database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        self._engine = open_history(url)
        self._look_at_database()
        self._spool = Spool(settings.history_spool, round(settings.history_spool_megabytes * 1e6))
        self._sampler = Sampler(settings.history_interval, {area.id: area.floor for area in site.areas})
        self._erased = Erased()
        self._zones: tuple[int, list[ZoneDefinition]] = (-1, zones_of_site(site))
        self._desk = Desk(self._engine, site, lambda: self._zones[1])
        tidying = Tidying(self._engine, settings.retention())
        self._acknowledged = Acknowledgements(bus, self.keys, self.name)
        self._writer = Writer(self._spool, self._engine, health, self._acknowledged.tell, tidying.work)
        self._questions: queue.Queue[Question] = queue.Queue(WAITING_QUESTIONS)
        self._inbox = bus.inbox(capacity=20_000)

    @classmethod
    def check(cls, settings: HistorySettings, site: Site) -> None:
        """Refuse a spool that cannot be written."""
        folder = settings.history_spool
        try:
            Spool(folder, 1).close()
        except OSError as error:
            raise SettingsError(
                f"history_spool: {folder} cannot be written: {error.strerror}; "
                "set it by --history-spool or ATRIUM_HISTORY_SPOOL"
            ) from error

    def run(self) -> None:
        """Keep what happens until asked to stop."""
        # Cached, and first: who withdrew consent while this process was down may stand in the database.
        self._inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        self._inbox.subscribe(self.keys.zones(), ZoneSet, cached=True)
        self._inbox.subscribe(self.keys.tracks(), TrackFrame)
        self._inbox.subscribe(self.keys.revisions(), Revision)
        self._inbox.subscribe(self.keys.alert(), Alert, cached=True)
        self._inbox.subscribe(self.keys.occupancy(), Occupancy)
        self.bus.answer_questions(self.keys.history(), self._ask)
        writing = threading.Thread(
            target=self._writer.run,
            args=(self.settings.history_write_every, self.stopping),
            name="writer",
            daemon=True,
        )
        writing.start()
        for number in range(ANSWERING):
            threading.Thread(target=self._answer, name=f"answer {number}", daemon=True).start()
        self.health.ready.set()
        while not self.stopping.is_set():
            self._keep([delivery.message for delivery in self._inbox.receive(timeout=TURN)])
        self._finish()

    def stop(self) -> None:
        """Wake the loop so that it ends at once."""
        super().stop()
        self._inbox.wake()

    def _look_at_database(self) -> None:
        """Refuse a database without tables; one that is away may come back, and until then the disk holds all."""
        try:
            problem = SCHEMA.problem(self._engine)
        except ServiceError as error:
            self.health.degraded(DATABASE, str(error))
            return
        if problem is not None:
            raise ServiceError(problem)

    def _finish(self) -> None:
        """Write what still waits, if the database takes it at once."""
        last = threading.Thread(target=self._writer.turn, args=(threading.Event(),), name="last write", daemon=True)
        last.start()
        last.join(LAST_WRITE)
        self._spool.close()

    # -- what happens --------------------------------------------------------------------------------------------------

    def _keep(self, messages: Sequence[Message]) -> None:
        entries = [entry for message in messages for entry in self._entries(message)]
        if not entries:
            return
        try:
            self._spool.append(entries)
        except OSError as error:
            LOST.inc(len(entries))
            self.health.degraded(DISK, f"what happens now is lost, the disk does not take it: {error}")
        else:
            self.health.well(DISK)

    def _entries(self, message: Message) -> list[Entry]:
        """Return what is kept of a message."""
        if isinstance(message, TrackFrame):
            return self._sampler.tracks(self._erased.from_tracks(message))
        if isinstance(message, Revision):
            replaced = self._sampler.revision(self._erased.from_revision(message))
            return [] if replaced is None else [replaced]
        if isinstance(message, Alert):
            return self._told(message)
        if isinstance(message, Occupancy):
            return _counted(message)
        if isinstance(message, Erasure):
            self._erased.add(message.device)
            known = message.device in self._acknowledged
            return [] if known else [Forgotten(device=message.device, t=message.t)]
        if isinstance(message, ZoneSet) and message.version > self._zones[0]:
            self._zones = message.version, message.zones
        return []

    def _told(self, alert: Alert) -> list[Entry]:
        """Return what is kept of an alert: nothing of one that no index of a database could hold."""
        if not plausible(alert.t) or not is_identifier(alert.zone) or not 0 < len(alert.id) <= LONGEST_ID:
            return []
        device, other = (
            name if name is not None and is_identifier(name) and name not in self._erased else None
            for name in (alert.device, alert.other_device)
        )
        return [AlertTold(alert=msgspec.structs.replace(alert, device=device, other_device=other))]

    # -- what is asked -------------------------------------------------------------------------------------------------

    def _ask(self, question: Question) -> None:
        """Hand a question to those who answer; whoever asks while too many wait gets no answer."""
        try:
            self._questions.put_nowait(question)
        except queue.Full:
            UNANSWERED.inc()

    def _answer(self) -> None:
        while True:
            question = self._questions.get()
            try:
                question.answer(self._desk.answer(question.payload))
            except Exception as error:  # whoever asks again and again must not end history again and again
                log.error("a question could not be answered", exc_info=error)


def _counted(message: Occupancy) -> list[Entry]:
    rows = [
        row
        for row, (zone, people) in enumerate(zip(message.zone, message.people, strict=True))
        if is_identifier(zone) and 0 <= people < 10**6 and 0 <= message.phones[row] < 10**6
    ]
    if not rows or not plausible(message.t):
        return []
    return [
        Counted(
            kind="zone",
            t=message.t,
            place=[message.zone[row] for row in rows],
            people=[message.people[row] for row in rows],
            phones=[message.phones[row] for row in rows],
        )
    ]
