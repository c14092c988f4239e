"""All phones of this gateway: batches in, in groups, and the promise that what is acknowledged reaches the bus."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter as Tally
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import NoReturn, TypeVar, cast

import numpy as np
import structlog
from prometheus_client import Counter, Gauge

from services.gateway.devices.storage import Registered, Walker
from services.gateway.errors import RequestError, read_json, refuse
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.dispatch import Dispatcher
from services.gateway.phones.group_worker import ClosedError, FullError, GroupWorker
from services.gateway.phones.heard_site import HeardSite
from services.gateway.phones.phone import LATENESS, NATIVE, Intake, Phone
from services.gateway.phones.spool import Spool
from services.gateway.protocol import Batch, BatchReply, FieldError
from services.gateway.reckoning.dead_reckoning import Carrying, DeadReckoner, Motion
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import HeadingModel, StrideModel
from shared.site import Site
from shared.walking.stride import StrideLine

__all__ = ["PhoneBook", "busy"]

BATCHES = Counter("atrium_gateway_batches_total", "Batches of phones", ["result"])
USED = Counter("atrium_gateway_accepted_total", "What was used of batches", ["kind"])
IGNORED = Counter("atrium_gateway_ignored_total", "What was not used of batches", ["reason"])
PHONES = Gauge("atrium_gateway_phones", "Phones that posted lately")
OUTBOX = 10_000
"""Messages a phone may have waiting for the bus before its batches are refused."""
WAITING = 1000
"""Batches that may wait for their turn; more are answered 503 rather than kept waiting."""
FORGOTTEN_KEPT = 100_000
"""Forgotten devices remembered: far more than can have a batch on its way at once."""
BYTES_OF_A_SAMPLE = 80
"""Of JSON: a stamp and nine numbers of some decimals."""
MODELS_KEPT = 100_000
"""Personal stride models remembered, and as many of headings."""
SILENCE = 60.0
"""Seconds between two warnings that the spool cannot be emptied."""

log = structlog.get_logger(__name__)
F = TypeVar("F")
L = TypeVar("L", StrideModel, HeadingModel)


def busy(problem: str) -> RequestError:
    """Return the refusal of a request that may be tried again in a second."""
    return RequestError(503, FieldError(field="", problem=problem), headers={"Retry-After": "1"})


@dataclass(slots=True)
class _Posted:
    owner: Registered
    batch: bytes | Batch
    received: float
    source: str

    @property
    def samples(self) -> int:
        """How many it holds; of a body not yet read, at least so many if it holds little else."""
        if isinstance(self.batch, bytes):
            return len(self.batch) // BYTES_OF_A_SAMPLE
        return 0 if self.batch.imu is None else len(self.batch.imu.t)


@dataclass(slots=True)
class _Entry:
    phone: Phone
    last_heard: float = 0.0
    walker: Walker | None = None


class PhoneBook:
    """Takes batches from any thread. One thread of its own works on all that wait at once, and alone touches phones.

    Args:
        site: whose access points and north.
        bus: where messages go.
        limits: of a batch.
        idle: seconds of silence after which a phone's walk is forgotten.
        spool: where messages wait while the bus is away; None: batches are refused meanwhile.
        lateness: seconds after which a measurement is marked late.
        detector: name of the step detector, ``shipped`` for the ones that count best.
    """

    def __init__(
        self,
        site: Site,
        bus: Bus,
        limits: Limits,
        idle: float,
        spool: Spool | None = None,
        lateness: float = LATENESS,
        detector: str = "shipped",
    ) -> None:
        self._keys = Keys(site.site)
        self._limits = limits
        self._idle = idle
        self._lateness = lateness
        self._access_points = {address.lower(): point.id for point in site.access_points for address in point.addresses}
        self._reckoner = DeadReckoner(site.north_radians, detector=None if detector == "shipped" else detector)
        self._dispatcher = Dispatcher(bus, self._keys, spool, lateness)
        self._entries: dict[str, _Entry] = {}
        self.heard = HeardSite()
        self._models: OrderedDict[str, StrideModel] = OrderedDict()
        self._turned: OrderedDict[str, HeadingModel] = OrderedDict()
        self._news = bus.inbox()
        self._news.subscribe(self._keys.stride_model(), StrideModel, cached=True)
        self._news.subscribe(self._keys.heading_model(), HeadingModel, cached=True)
        self._looked = 0.0
        self._silent_until = 0.0
        self._forgotten: OrderedDict[str, None] = OrderedDict()
        self._lock = threading.Lock()
        """Of what is forgotten."""
        self._worker: GroupWorker[_Posted, BatchReply] = GroupWorker(self._work, WAITING, self._look_after, "phones")

    def submit(
        self, owner: Registered, batch: bytes | Batch, received: float, source: str = NATIVE
    ) -> Future[BatchReply]:
        """Let one batch wait for its turn; from any thread.

        Args:
            owner: whose it is.
            batch: as JSON or read already.
            received: server clock when it arrived.
            source: who numbered it: the app itself or an adapter.

        Raises:
            RequestError: 503 where too many wait. The future raises it too: 4xx for a bad batch or a forgotten device,
                nothing of it used; 503 where the bus is away and nothing more can be stored: send it again, what was
                used of it is kept and will be published once.
        """
        return _queued(self._worker.submit, _Posted(owner, batch, received, source))

    def submit_soon(
        self, owner: Registered, batch: bytes | Batch, received: float, source: str = NATIVE
    ) -> asyncio.Future[BatchReply]:
        """Do what ``submit`` does, from an event loop."""
        return _queued(self._worker.submit_soon, _Posted(owner, batch, received, source))

    def post(self, owner: Registered, batch: bytes | Batch, received: float) -> BatchReply:
        """Take one batch and wait for the reply; see ``submit``."""
        return self.submit(owner, batch, received).result()

    def forget(self, device: str) -> None:
        """Forget a device whose consent was withdrawn, for good; what it sent and is not yet on the bus is dropped."""
        with self._lock:
            self._forgotten[device] = None
            if len(self._forgotten) > FORGOTTEN_KEPT:
                self._forgotten.popitem(last=False)
        self._worker.call(lambda: self._drop(device))

    def has_forgotten(self, device: str) -> bool:
        """Whether this device's consent was withdrawn here."""
        with self._lock:
            return device in self._forgotten

    def rest(self, now: float) -> None:
        """Let idle phones cost nothing; ``now`` is monotonic. After twelve times as long they are forgotten whole."""
        with suppress(ClosedError):  # while the gateway ends
            self._worker.call(lambda: self._rest(now))

    def close(self) -> None:
        """Answer what waits and end the thread."""
        self._worker.close()

    def __enter__(self) -> PhoneBook:
        """Use it for the length of a block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    # What follows runs in the worker's thread.

    def _work(self, posted: Sequence[_Posted]) -> list[BatchReply | Exception]:
        """Answer a group; several batches of one phone are taken one after the other."""
        answers: list[BatchReply | Exception] = []
        start = 0
        while start < len(posted):
            devices: set[str] = set()
            stop = start
            while stop < len(posted) and posted[stop].owner.id not in devices:
                devices.add(posted[stop].owner.id)
                stop += 1
            answers += self._work_on_phones(posted[start:stop])
            start = stop
        _count(answers)
        self._note_heard(answers)
        return answers

    def _work_on_phones(self, posted: Sequence[_Posted]) -> list[BatchReply | Exception]:
        """Answer one batch each of some phones."""
        taken = [self._admit(entry) for entry in posted]
        self._use([one for one in taken if isinstance(one, _Taken) and not one.intake.duplicate])
        self._dispatcher.send([one.phone for one in taken if isinstance(one, _Taken) and one.phone.outbox])
        return [one.answer() if isinstance(one, _Taken) else one for one in taken]

    def _admit(self, posted: _Posted) -> _Taken | Exception:
        try:
            batch = read_json(posted.batch, Batch) if isinstance(posted.batch, bytes) else posted.batch
            entry = self._entry(posted.owner)
            if len(entry.phone.outbox) > OUTBOX:
                return busy("too much of this phone waits for the bus")
            intake = entry.phone.admit(batch, posted.received, self._limits, posted.source)
            return _Taken(entry.phone, batch.seq, intake)
        except RequestError as error:
            return error
        except Exception as error:  # ours, and no other phone's loss
            log.exception("a batch could not be looked at", device=posted.owner.id)
            return error

    def _use(self, taken: Sequence[_Taken]) -> None:
        """Advance and tell batches of different phones; one that fails is not told, so that it may be sent again."""
        with_samples = [one for one in taken if one.intake.samples is not None]
        together = [one for one in with_samples if not one.phone.failed]
        alone = [one for one in with_samples if one.phone.failed]
        if together and not self._reckon(together):
            alone += together
        for one in alone:
            self._reckon([one])
        for one in taken:
            if one.failure is None:
                one.phone.tell(one.intake, one.motions, one.dropped)

    def _reckon(self, taken: Sequence[_Taken]) -> bool:
        """Advance walks; where that fails they begin anew, and False is returned."""
        walks = [one.phone.walk for one in taken]
        before = [walk.late for walk in walks]
        try:
            told = self._reckoner.advance(
                walks, [one.intake.samples for one in taken if one.intake.samples is not None]
            )
        except Exception as error:
            log.exception("dead reckoning failed; the walks begin anew", phones=[one.phone.device for one in taken])
            for one in taken:
                one.phone.rest()
                one.failure = error
                one.phone.failed = len(taken) == 1
            return False
        for one, motions, walk, late in zip(taken, told, walks, before, strict=True):
            one.failure, one.phone.failed = None, False
            one.motions, one.dropped = motions, walk.late - late
        return True

    def _entry(self, owner: Registered) -> _Entry:
        # A batch may have been authorised before the consent was withdrawn and come to its end only now.
        if self.has_forgotten(owner.id):
            _refuse_forgotten()
        entry = self._entries.get(owner.id)
        if entry is None:
            phone = Phone(owner.id, self._access_points, lateness=self._lateness)
            entry = self._entries[owner.id] = _Entry(phone, walker=owner.walker)
            phone.walk.line, phone.walk.thresholds = self._line(entry), _thresholds(entry.walker)
            phone.turned = self._turned.get(owner.id)
            PHONES.set(len(self._entries))
        elif entry.walker is not owner.walker and entry.walker != owner.walker:
            entry.walker = owner.walker
            entry.phone.walk.line, entry.phone.walk.thresholds = self._line(entry), _thresholds(entry.walker)
        entry.phone.walk.carrying = cast(Carrying, owner.carrying)
        entry.last_heard = time.monotonic()
        return entry

    def _line(self, entry: _Entry) -> StrideLine | None:
        """Return how long this person's steps are: learned (and not all zeros), else as trial walks told."""
        model, walker = self._models.get(entry.phone.device), entry.walker
        if model is not None and (model.slope != 0.0 or model.offset != 0.0):
            return _line(model.slope, model.offset, model.scale_variance)
        if walker is not None and walker.slope is not None:
            return _line(walker.slope, walker.offset or 0.0, walker.scale_variance or 0.0)
        return None

    def _look_after(self) -> None:
        now = time.monotonic()
        try:
            self._dispatcher.drain()
        except Exception as error:  # the database's or Zenoh's; tried again at the next occasion
            if now >= self._silent_until:
                self._silent_until = now + SILENCE
                log.warning("what waits could not be published; trying again", error=type(error).__name__)
        if now - self._looked >= 1.0:
            self._looked = now
            self._learn(delivery.message for delivery in self._news.receive(0.0))

    def _note_heard(self, answers: Sequence[BatchReply | Exception]) -> None:
        now = time.monotonic()
        for answer in answers:
            if isinstance(answer, BatchReply) and not answer.duplicate:
                unknown = (answer.ignored or {}).get("unknown address", 0)
                self.heard.note(answer.accepted.scans, answer.accepted.readings, unknown, now)

    def _learn(self, messages: Iterable[object]) -> None:
        """Use the newest models of each person."""
        for message in messages:
            if not isinstance(message, StrideModel | HeadingModel) or self.has_forgotten(message.device):
                continue
            fresh = isinstance(message, StrideModel) and _keep(self._models, message)
            fresh = fresh or (isinstance(message, HeadingModel) and _keep(self._turned, message))
            entry = self._entries.get(message.device)
            if fresh and entry is not None:
                entry.phone.walk.line = self._line(entry)
                entry.phone.turned = self._turned.get(message.device)

    def _rest(self, now: float) -> None:
        for device, entry in list(self._entries.items()):
            if now - entry.last_heard <= self._idle:
                continue
            self._dispatcher.hush(device)
            entry.phone.rest()
            if now - entry.last_heard > 12 * self._idle and not entry.phone.outbox:
                del self._entries[device]
        PHONES.set(len(self._entries))

    def _drop(self, device: str) -> None:
        self._entries.pop(device, None)
        self._models.pop(device, None)
        self._turned.pop(device, None)
        self._dispatcher.forget(device)
        PHONES.set(len(self._entries))


@dataclass(slots=True)
class _Taken:
    """One batch of a group, on its way to its answer."""

    phone: Phone
    seq: int
    intake: Intake
    motions: Sequence[Motion] = ()
    dropped: int = 0
    """Samples too late to be used."""
    failure: Exception | None = None

    def answer(self) -> BatchReply | Exception:
        if self.failure is not None:
            return self.failure
        if self.phone.outbox:
            return busy("the bus is away and no more can be stored; send the batch again with the same seq")
        intake = self.intake
        return BatchReply(
            seq=self.seq,
            duplicate=intake.duplicate,
            received=intake.received,
            replied=time.time(),
            clock_offset=intake.clock_offset,
            clock_drift=intake.clock_drift,
            late=intake.late,
            accepted=intake.accepted,
            ignored=intake.ignored,
        )


def _count(answers: Sequence[BatchReply | Exception]) -> None:
    results, used, ignored = Tally[str](), Tally[str](), Tally[str]()
    for answer in answers:
        if isinstance(answer, BatchReply):
            results["duplicate" if answer.duplicate else "accepted"] += 1
            used["sample"] += answer.accepted.samples
            used["scan"] += answer.accepted.scans
            used["reading"] += answer.accepted.readings
            if answer.ignored:
                ignored.update(answer.ignored)
        else:
            results["waiting" if isinstance(answer, RequestError) and answer.status == 503 else "refused"] += 1
    for counter, tally in ((BATCHES, results), (USED, used), (IGNORED, ignored)):
        for label, count in tally.items():
            counter.labels(label).inc(count)


def _keep(models: OrderedDict[str, L], model: L) -> bool:
    """Keep a model unless a newer one of its device is known; whether it was kept."""
    known = models.get(model.device)
    if known is not None and model.version < known.version:
        return False
    models[model.device] = model
    if len(models) > MODELS_KEPT:
        models.popitem(last=False)
    return True


def _thresholds(walker: Walker | None) -> tuple[float, float] | None:
    """Return a person's own step thresholds, where trial walks told them."""
    return None if walker is None or walker.peak is None or walker.mean is None else (walker.peak, walker.mean)


def _line(slope: float, offset: float, scale_variance: float) -> StrideLine:
    return StrideLine(np.array(slope), np.array(offset), np.array(scale_variance))


def _queued(submit: Callable[[_Posted, int, str], F], posted: _Posted) -> F:
    """Let a batch wait for its turn; where it cannot, say so as a refusal."""
    try:
        return submit(posted, posted.samples, posted.owner.id)
    except FullError as error:
        BATCHES.labels("waiting").inc()
        raise busy("more batches wait than can be taken") from error
    except ClosedError as error:
        raise busy("the gateway ends") from error


def _refuse_forgotten() -> NoReturn:
    refuse("Authorization", "this device has been forgotten", allowed="enrol again", status=401)
