"""Fusion as a process: detections, radio and motion in; chunk marks and tracks out; its state on request."""

from __future__ import annotations

import functools
import time
from collections import Counter as Count
from typing import ClassVar

import msgspec
import structlog
from prometheus_client import Counter, Gauge, Histogram

from services.fusion.area_view import AreaView
from services.fusion.chunks import Chunker, ChunkerSettings, Closed, period_of
from services.fusion.positions.anonymous import MOST_CAMERAS
from services.fusion.radio_file import RadioFile
from services.fusion.registry import TRACKERS
from services.fusion.rescore.desk import RescoreDesk
from services.fusion.rescore.recent import RecentChunks
from services.fusion.running_tracker import RunningTracker
from services.fusion.settings import FusionSettings
from services.fusion.tracker import Complaining, Retuning, TrackerStateError
from services.fusion.trained_view import trained_view
from services.fusion.two_places import TwoPlaces
from services.fusion.watch import Watch
from shared.acknowledgements import Acknowledgements
from shared.bus import DROPPED as BUS_DROPPED
from shared.bus import Bus, Delivery, Trace
from shared.erased import Erased
from shared.messages import (
    ChunkMark,
    DetectionFrame,
    Erasure,
    Message,
    MotionBatch,
    RadioModelUpdate,
    RadioScan,
    Revision,
    TrackFrame,
)
from shared.radio import RadioModelError
from shared.runner import Health, Service
from shared.settings import SettingsError
from shared.setup_told import FollowedSite, SetupTold
from shared.site import AccessPoint, Camera, Site
from shared.state_file import StateFile

__all__ = ["FusionService"]

log = structlog.get_logger(__name__)

_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5, 5.0)
FROM_DETECTION = Histogram(
    "atrium_detection_to_track_seconds", "From the frame that closed a chunk being sent to its tracks", buckets=_SECONDS
)
FROM_CAPTURE = Histogram(
    "atrium_capture_to_track_seconds", "From that frame's picture reaching the camera service", buckets=_SECONDS
)
STEP = Histogram("atrium_fusion_step_seconds", "Time one tracker step takes", buckets=_SECONDS)
DROPPED = Counter("atrium_fusion_dropped_total", "Messages fusion did not use", ["reason"])
CHUNKS = Counter("atrium_fusion_chunks_total", "Chunks closed")
TRACKS = Gauge("atrium_fusion_tracks", "People tracked now")
RADIO_VERSION = Gauge(
    "atrium_fusion_radio_version", "Version of the learned radio model in use; 0: what settings and site file say"
)
RADIO_SINCE = Gauge(
    "atrium_fusion_radio_since_seconds", "When it was told, in seconds since the epoch; 0: it is what the settings say"
)


class FusionService(Service[FusionSettings]):
    """Tracks one area."""

    name = "fusion"
    Settings = FusionSettings
    TURN: ClassVar[float] = 0.25
    """Seconds between two looks at clock and health while nothing arrives."""
    QUIET: ClassVar[float] = 1.0
    """Seconds without a frame after which a withdrawal of consent does not wait for one."""

    BEHIND: ClassVar[int] = 16
    """Frames of a camera that wait at most: a second, after which older ones give way."""

    def __init__(self, settings: FusionSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        self.area = _area_of(settings, site)
        view = _view_of(settings, site, self.area)
        self.running = RunningTracker(view, settings.tracker, settings.tracker_seed)
        self._recent = RecentChunks(60.0 * settings.rescore_minutes, settings.rescore_megabytes * 2**20)
        self._desk = RescoreDesk(view, settings.tracker, settings.tracker_seed, self._recent, settings.rescore_patience)
        self.chunker = Chunker(
            ChunkerSettings(lateness=settings.camera_lateness, period=period_of(self.running.tracker.cycle))
        )
        self._cameras = {camera.id for camera in site.cameras_of(self.area)}
        self._watch = Watch(
            health, self._cameras, settings.silent_after, settings.phones_silent_after, time.monotonic()
        )
        self._two_places = TwoPlaces(site.access_points)
        self._counted: Count[str] = Count()
        """What was not used since this process began, by reason …"""
        self._exported: Count[str] = Count()
        """… and as far as it is exported."""
        self._known: Count[str] = Count()
        """What chunker and tracker counted so far, as far as it stands in ``_counted``."""
        self._people = 0
        self._erased = Erased()
        self._acknowledged = Acknowledgements(bus, self.keys, f"{self.name}-{self.area}")
        self._blank = False
        """Whether nothing was saved before this process began."""
        self._frame_at = time.monotonic() - self.QUIET
        folder = settings.state_folder
        file = None if folder is None else folder / f"fusion-{self.area}.json"
        self._radio_file = RadioFile(file)
        self._state_file = StateFile(
            file,
            settings.state_every,
            lambda: self.running.to_save(self._radio_file),
            health,
            what="the tracker's state",
            loss="everybody would be numbered and named anew",
        )
        self._followed = FollowedSite(settings.site_file, site, health)
        self._inbox = bus.inbox()

    @classmethod
    def check(cls, settings: FusionSettings, site: Site) -> None:
        """Refuse an area or a tracker that does not exist, and an area of more cameras than a tracker can tell."""
        area = _area_of(settings, site)
        cameras = len(site.cameras_of(area))
        if cameras > MOST_CAMERAS:
            raise SettingsError(
                f"area: {area!r} has {cameras} cameras in {settings.site_file}; allowed: at most {MOST_CAMERAS}; "
                "cut it into several areas"
            )
        if settings.tracker not in TRACKERS:
            raise SettingsError(
                f"tracker: {settings.tracker!r} is no tracker; allowed: {', '.join(sorted(TRACKERS))}; "
                "set it by --tracker or ATRIUM_TRACKER"
            )
        if settings.radio_model is not None:
            _view_of(settings, site, area)

    @property
    def instance(self) -> str:
        """One process per area."""
        return self.settings.instance or self.area

    @property
    def view(self) -> AreaView:
        """The area under the active radio model."""
        return self.running.radio.view

    def run(self) -> None:
        """Consume messages until told to stop."""
        self._restore()
        self._marks = self.bus.publisher(self.keys.chunks(self.area), ChunkMark)
        self._tracks = self.bus.publisher(self.keys.tracks(self.area), TrackFrame)
        self._revisions = self.bus.publisher(self.keys.revisions(self.area), Revision)
        self.bus.answer(self.keys.fusion_state(self.area), self.answer_state)
        self.bus.answer_questions(self.keys.rescore(self.area), self._desk.take)
        for camera in sorted(self._cameras):
            self._inbox.subscribe(self.keys.detections(camera), DetectionFrame, newest=True, depth=self.BEHIND)
        self._inbox.subscribe(self.keys.radio(), RadioScan)
        self._inbox.subscribe(self.keys.motion(), MotionBatch)
        # Cached: whoever withdrew consent while this process was down is in the state it restored.
        self._inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        self._inbox.subscribe(self.keys.radio_model(self.area), RadioModelUpdate, cached=True)
        self._inbox.subscribe(self.keys.setup(), SetupTold, cached=True)
        if not self._cameras:
            self.health.degraded("cameras", f"area {self.area} has no camera: nobody is tracked or located there")
        self.health.ready.set()
        while not self.stopping.is_set():
            for delivery in self._inbox.receive(timeout=self.TURN):
                self._take(delivery)
            self._look_after()
        self._desk.close()
        self._state_file.save_last(self.running.chunk)
        self._acknowledged.tell_gone()

    def stop(self) -> None:
        """Wake the loop so that it ends at once."""
        super().stop()
        self._inbox.wake()

    def answer_state(self) -> bytes:
        """Return the tracker's state at the last chunk boundary as a ``StateAnswer`` in JSON, with its radio model."""
        return self.running.answer()

    def _take(self, delivery: Delivery[Message]) -> None:
        message, trace = delivery.message, delivery.trace
        if isinstance(message, RadioScan | MotionBatch):
            self._watch.phone_spoke(time.monotonic())
            if message.device in self._erased:
                return
            if message.late:
                self._counted["phone's data marked late"] += 1
            elif isinstance(message, RadioScan):
                self._look_for_a_double(message)
                self.chunker.add_scan(message, trace.id)
            else:
                self.chunker.add_motion(message, trace.id)
        elif isinstance(message, DetectionFrame):
            if message.camera not in self._cameras:
                self._counted["camera of another area"] += 1
                return
            self._frame_at = time.monotonic()
            self._watch.camera_spoke(message.camera, self._frame_at)
            for closed in self.chunker.add_frame(message, trace.id):
                self._consume(closed, trace)
        elif isinstance(message, Erasure):
            self._erase(message, trace)
        elif isinstance(message, RadioModelUpdate):
            self._consider(message, trace)
        elif isinstance(message, SetupTold) and self._followed.take(message):
            self._look_at(self._followed.site)

    def _look_at(self, site: Site) -> None:
        """Begin anew where cameras or access points of this area are set up otherwise than those it runs with."""
        if _watched_by(site, self.area) != _watched_by(self.site, self.area):
            self.begin_anew(site)

    def _consider(self, update: RadioModelUpdate, trace: Trace) -> None:
        """Let a radio model go live with the next chunk, or say why it does not."""
        if not isinstance(self.running.tracker, Retuning):
            self._counted["radio model for a tracker that takes none"] += 1
            return
        try:
            if self.running.radio.accept(update):
                self.chunker.add_model(update, trace.id)
            elif self.running.radio.older(update):
                self._counted["radio model older than the one in use"] += 1
        except RadioModelError as error:
            self._counted["radio model that does not fit the site"] += 1
            log.warning("a radio model is refused", version=update.version, reason=str(error))

    def _erase(self, erasure: Erasure, trace: Trace) -> None:
        """Forget a device; what the tracker knows goes with the next chunk. Told again, nothing of it is left."""
        if erasure.device in self._erased:
            return
        self._erased.add(erasure.device)
        self._two_places.forget(erasure.device)
        self._recent.clear()
        self._desk.forget()
        self.chunker.add_erasure(erasure, trace.id)
        if self._blank and self.running.chunk < 0:
            # Nobody knows anybody yet, and nothing lies there that could not be read.
            self._acknowledged.tell(erasure.device)

    def _look_for_a_double(self, scan: RadioScan) -> None:
        """Count a device that is heard in two places; the tracker gets its scans all the same and is not sure."""
        if self._two_places.contradicts(scan):
            self._counted["phone in two places at once"] += 1
            if self._two_places.worth_telling(scan.device, scan.t):
                log.warning("a device is heard in two places at once", device=scan.device)

    def _consume(self, closed: Closed, trace: Trace) -> None:
        """Step the tracker; tell first what it consumed, then what came of it."""
        chunk = closed.chunk
        began = time.perf_counter()
        frame = self.running.step(chunk)
        STEP.observe(time.perf_counter() - began)
        self._marks.publish(
            ChunkMark(
                t=frame.t,
                area=self.area,
                chunk=chunk.index,
                t_start=chunk.t_start,
                t_end=chunk.t_end,
                consumed=list(closed.consumed),
            )
        )
        self._tracks.publish(frame, origin=trace.origin)
        revision = self.running.tracker.revision()
        if revision is not None:
            self._revisions.publish(revision, origin=trace.origin)
        self._recent.add(chunk)
        now = time.time()
        FROM_DETECTION.observe(max(now - trace.sent, 0.0))
        FROM_CAPTURE.observe(max(now - trace.origin, 0.0))
        CHUNKS.inc()
        if chunk.models:
            self._tell_radio()
        if chunk.erasures or chunk.models:
            self._state_file.save_soon()
        for erasure in chunk.erasures:
            self._acknowledged.await_gone(erasure.device, functools.partial(self._state_file.holds, chunk.index))
        if any(frame.device):
            self._watch.phone_known(time.monotonic())
        self._people = sum(state != "unseen" for state in frame.state)
        TRACKS.set(self._people)

    def _tell_radio(self) -> None:
        """Tell which radio model is in use from now on."""
        update = self.running.radio.update
        self._desk.view = self.view
        if update is not None:
            RADIO_VERSION.set(update.version)
            RADIO_SINCE.set(update.t)
            what = "as the site file says" if update.model is None else "learned"
            log.info("radio model in use", version=update.version, model=what, told=update.t, reason=update.reason)

    def _forget_without_a_frame(self) -> None:
        closed = self.chunker.close_for_erasures()
        if closed is not None:
            now = time.time()
            self._consume(closed, Trace("", now, now))

    def _look_after(self) -> None:
        """Count what was not used, tell what is wrong, save the state when it is time."""
        if time.monotonic() - self._frame_at >= self.QUIET:
            self._forget_without_a_frame()
        known = Count(self.chunker.dropped)
        known.update(self.running.tracker.ignored())
        self._counted.update(known - self._known)
        self._known = known
        for reason, count in (self._counted - self._exported).items():
            DROPPED.labels(reason).inc(count)
        self._exported = Count(self._counted)
        tracker = self.running.tracker
        complaints = tracker.complaints() if isinstance(tracker, Complaining) else []
        self._watch.look({**self._counted, **_lost_on_the_bus()}, complaints, self._people, time.monotonic())
        self._state_file.save_if_due(self.running.chunk)
        self._acknowledged.tell_gone()

    # -- across restarts ---------------------------------------------------------------------------------------------

    def _restore(self) -> None:
        try:
            saved_bytes = self._state_file.read()
            if saved_bytes is None:
                self._blank = True
                return
            self.running.restore(saved_bytes, self._radio_file)
        except (OSError, msgspec.DecodeError, TrackerStateError) as error:
            log.warning("starting without the saved state", reason=str(error))
            return
        self._tell_radio()
        chunk = self.running.chunk
        self._state_file.restored(chunk)
        self._known = Count(self.running.tracker.ignored())
        self.chunker.resume_after(chunk)
        log.info("state restored", chunk=chunk)


def _view_of(settings: FusionSettings, site: Site, area: str) -> AreaView:
    try:
        return trained_view(site, area, settings.radio_model)
    except RadioModelError as error:
        raise SettingsError(f"radio_model: {error}; set by --radio-model or ATRIUM_RADIO_MODEL") from error


def _watched_by(site: Site, area: str) -> tuple[list[Camera], list[AccessPoint]]:
    floor = site.area(area).floor
    return site.cameras_of(area), [point for point in site.access_points if point.floor == floor]


def _lost_on_the_bus() -> Count[str]:
    """Return what did not reach this process's inbox, by reason."""
    lost: Count[str] = Count()
    for metric in BUS_DROPPED.collect():
        for sample in metric.samples:
            if sample.name.endswith("_total"):
                lost[sample.labels["reason"]] += int(sample.value)
    return lost


def _area_of(settings: FusionSettings, site: Site) -> str:
    known = [area.id for area in site.areas]
    if settings.area in known:
        return settings.area
    if not settings.area and len(known) == 1:
        return known[0]
    found = f"{settings.area!r} is no area of the site" if settings.area else "the site has several areas"
    raise SettingsError(f"area: {found}; allowed: {', '.join(known)}; set it by --area or ATRIUM_AREA")
