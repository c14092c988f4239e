"""The camera process: pictures in, detections on the floor out, and always a word on how the camera is doing."""

from __future__ import annotations

import time
from typing import ClassVar

import cv2
import numpy as np
import structlog
from numpy.typing import NDArray
from prometheus_client import Counter, Gauge, Histogram

from services.camera.detector import DetectorError, check_detector
from services.camera.empty_scene import EmptyScene
from services.camera.frame_ring import FrameRing
from services.camera.frames import Frame, Source, SourceError
from services.camera.keeping_up import KeepingUp
from services.camera.learned_version import LearnedVersion
from services.camera.pipeline import Pipeline, to_message
from services.camera.projection import GroundDetections, aligned
from services.camera.redetect_desk import RedetectDesk
from services.camera.scene_file import SceneFile
from services.camera.scene_watch import SceneWatch, same_place
from services.camera.settings import CameraSettings
from services.camera.sources import open_source
from services.camera.status import StatusBoard
from services.camera.still_desk import StillDesk
from shared.bus import Bus
from shared.camera_limits import alignment_problem, calibration_problem
from shared.messages import CameraAlignment, CameraStatus, DetectionFrame, DetectorSettings
from shared.runner import Health, Service
from shared.settings import SettingsError
from shared.setup_told import FollowedSite, SetupTold
from shared.site import Camera, Site
from shared.site.footprint import footprint
from shared.site.geometry_digest import geometry_digest

__all__ = ["CameraService"]

FIRST_DELAY = 0.5
LONGEST_DELAY = 30.0
"""Seconds before a failed source is tried again: the first time, doubling up to the longest."""

FRAMES = Counter("atrium_camera_frames_total", "Frames processed", ["camera"])
OVERTAKEN = Counter("atrium_camera_overtaken_total", "Frames dropped for newer ones", ["camera"])
DETECTIONS = Counter("atrium_camera_detections_total", "People detected, frame by frame", ["camera"])
FAILURES = Counter("atrium_camera_source_failures_total", "Times the source failed", ["camera"])
DETECT_SECONDS = Histogram(
    "atrium_camera_detect_seconds",
    "Time to find the people of one frame on the floor",
    ["camera"],
    buckets=(0.002, 0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.1, 0.2, 0.5),
)
SETTINGS_VERSION = Gauge(
    "atrium_camera_settings_version", "Learned detector settings in use; 0: configured", ["camera"]
)
RING_BYTES = Gauge("atrium_camera_ring_bytes", "Memory of the last minutes' small pictures", ["camera"])

log = structlog.get_logger(__name__)


class CameraService(Service[CameraSettings]):
    """Runs one camera of the site."""

    name: ClassVar[str] = "camera"
    Settings = CameraSettings

    def __init__(self, settings: CameraSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        self._camera = site.camera(settings.camera)
        self._floor = site.area(self._camera.area).floor
        self._followed = FollowedSite(settings.site_file, site, health)
        self._pipeline = Pipeline(self._camera, settings.detector, settings.detector_options)
        self._source: Source = open_source(self._camera, settings.pace)
        self._detections = bus.publisher(self.keys.detections(self._camera.id), DetectionFrame, newest=True)
        publisher = bus.publisher(self.keys.camera_status(self._camera.id), CameraStatus, cached=True)
        self._status = StatusBoard(publisher, self._camera.id)
        self._models = bus.inbox()
        self._ring = FrameRing(settings.ring_megabytes, settings.ring_minutes, settings.ring_rate)
        self._scene = EmptyScene()
        self._scene_file = SceneFile(settings.scene_file)
        self._watch = SceneWatch()
        self._keeping_up = KeepingUp()
        self._doubted = ""
        """What was wrong with the view when the last picture was looked at."""
        self._desk = RedetectDesk(
            lambda: self._camera,
            self._floor,
            settings.detector,
            settings.detector_options,
            self._ring,
            lambda: self._scene.picture,
            lambda: (self._alignment, self._aligned.used),
            lambda: self._pipeline.learned_sizes,
            lambda: self._watch.verdict or self._pipeline.doubt,
            settings.redetect_patience,
        )
        self._stills = StillDesk(
            self._camera.id,
            settings.allow_stills,
            settings.still_minutes,
            trouble=lambda: health.problems().get("source", ""),
        )
        self._alignment = np.eye(3)
        self._aligned, self._adopted = LearnedVersion("alignment"), LearnedVersion("detector settings")
        self._alignments = bus.inbox(100)
        self._alignments.subscribe(self.keys.alignment(self._camera.id), CameraAlignment, cached=True)
        self._lost = False
        """Whether the background was lost, and not begun with the empty scene since."""
        self._seq = 0
        self._overtaken = 0
        self._delay = FIRST_DELAY

    @classmethod
    def check(cls, settings: CameraSettings, site: Site) -> None:
        """Refuse a camera that is not in the site and a detector that cannot be used."""
        known = [camera.id for camera in site.cameras]
        if settings.camera not in known:
            raise SettingsError(
                f"camera: {settings.camera!r} is no camera of {settings.site_file}; "
                f"allowed: {', '.join(known) or 'none'}; set it by --camera or ATRIUM_CAMERA"
            )
        try:
            check_detector(settings.detector, settings.detector_options)
        except DetectorError as error:
            raise SettingsError(str(error)) from error

    @property
    def instance(self) -> str:
        """The camera's id: there is one process per camera."""
        return self.settings.instance or self.settings.camera

    def run(self) -> None:
        """Process frames; reopen a source that failed, later and later; stay when it has ended."""
        cv2.setNumThreads(self.settings.opencv_threads)
        self._measure_view()
        self._models.subscribe(self.keys.detector_settings(self._camera.id), DetectorSettings, cached=True)
        self._models.subscribe(self.keys.setup(), SetupTold, cached=True)
        self.bus.answer_questions(self.keys.redetect(self._camera.id), self._desk.take)
        self.bus.answer_questions(self.keys.still(self._camera.id), self._stills.take)
        RING_BYTES.labels(self._camera.id).set_function(lambda: self._ring.held_bytes)
        self.health.ready.set()
        self._wait_for_listeners()
        while not self.stopping.is_set():
            first_frame = None
            try:
                for frame in self._source.frames(self.stopping):
                    first_frame = first_frame or time.monotonic()
                    self._take(frame)
            except SourceError as error:
                if first_frame is not None and time.monotonic() - first_frame > self._delay:
                    self._delay = FIRST_DELAY  # it worked for a while: this is a new failure
                self._fail(error)
                continue
            if not self.stopping.is_set():
                log.info("the source has ended", source=str(self._camera.source), frames=self._seq)
                self._rest("ended")

    def stop(self) -> None:
        """Stop, with whatever is being tried; the pictures are gone at once."""
        super().stop()
        self._desk.close()
        self._stills.close()
        self._ring.clear()

    def _wait_for_listeners(self) -> None:
        """Frames sent before the bus is reached are lost: a recording would miss its beginning."""
        while not self.bus.connected and not self.stopping.wait(0.05):
            pass
        if self.settings.wait_for_subscriber:
            log.info("waiting for a subscriber", key=self.keys.detections(self._camera.id))
            while not self._detections.matched and not self.stopping.wait(0.05):
                self._status.refresh()

    def _take(self, frame: Frame) -> None:
        camera = self._camera.id
        self._stills.offer(frame.image, frame.t)
        self._listen()
        if frame.seq == 0:
            self._status.begin_pass(frame.pass_origin)
            self._keeping_up.reset()
            if not self._source.live:
                # The first picture does not follow the last one: who stands there now did not walk in.
                self._pipeline.reset()
                self._ring.clear()
                self._scene.forget()
            elif self._seq == 0 and (known := self._scene_file.load()) is not None:
                self._scene.begin(known)
                self._begin_empty(frame)
        was_ready = self._pipeline.state == "ready"
        with DETECT_SECONDS.labels(camera).time():
            found = aligned(self._pipeline.process(frame.image, frame.t), self._learned_alignment())
        # A hand before the lens, a jump of the light: once the scene is back, who stands there is no furniture.
        self._lost = self._pipeline.state == "learning" and (self._lost or was_ready) and not self._begin_empty(frame)
        message = to_message(camera, self._floor, self._seq, frame.t, found)
        self._detections.publish(message, origin=frame.arrived)
        self._seq += 1
        FRAMES.labels(camera).inc()
        DETECTIONS.labels(camera).inc(len(message.x))
        OVERTAKEN.labels(camera).inc(self._source.overtaken - self._overtaken)
        self._overtaken = self._source.overtaken
        self._status.count(self._overtaken)
        self._keeping_up.take(time.monotonic(), self._overtaken)
        self._remember(frame, found)
        self._report()

    def _remember(self, frame: Frame, found: GroundDetections) -> None:
        """Keep what learning may ask for, as long as the camera looks where it looked."""
        self._watch.take(frame.image, frame.t)
        if self._watch.verdict != self._doubted:
            self._doubted = self._watch.verdict
            self._pipeline.forget_sizes(paused=bool(self._doubted))
            if self._doubted:
                self._ring.clear()
                self._scene.forget()
        if not self._doubted:
            self._ring.offer(frame.image, frame.t)
            if self._scene.take(frame.image, found.boxes, frame.t) and self._source.live:
                self._scene_file.save(self._scene, frame.t)

    def _begin_empty(self, frame: Frame) -> bool:
        """Let the background begin with the scene without people, if the camera looks at that; whether it does."""
        empty = self._scene.picture
        if empty is None:
            return False
        if not same_place(empty, frame.image):
            if self._seq == 0:
                log.warning("the empty scene kept from before is of another place and is learned anew")
                self._scene.forget()
            return False
        height, width = frame.image.shape[:2]
        self._pipeline.prime(np.asarray(cv2.resize(empty, (width, height), interpolation=cv2.INTER_AREA), np.uint8))
        return True

    def _listen(self) -> None:
        """Take in what learning and whoever sets the site up have told."""
        for delivery in self._models.receive(0.0):
            if isinstance(delivery.message, DetectorSettings):
                self._adopt(delivery.message)
            elif isinstance(delivery.message, SetupTold) and self._followed.take(delivery.message):
                self._recalibrate(self._followed.site.camera(self._camera.id))

    def _recalibrate(self, camera: Camera) -> None:
        """Go on with what was set up of this camera; a correction learned before was one of the calibration before."""
        if (camera.geometry, camera.area_of_interest) == (self._camera.geometry, self._camera.area_of_interest):
            return
        anew = camera.geometry != self._camera.geometry
        self._camera = camera
        self._pipeline.recalibrate(camera)
        if anew:
            self._alignment = np.eye(3)
        self._measure_view()
        log.info("calibrated anew", camera=camera.id, geometry=self._calibration)

    def _measure_view(self) -> None:
        """Find out which part of the floor is watched, and tell which calibration is in use."""
        outline = self.site.floor(self._floor).plan().outline
        self._watched = footprint(self._camera.geometry.build(), self._camera.area_of_interest, outline)
        self._calibration = geometry_digest(self._camera.geometry)
        self._status.calibrated(self._calibration)

    def _adopt(self, settings: DetectorSettings) -> None:
        """Let the running detector work with what was learned; what it cannot is told and changes nothing."""
        if self._adopted.is_newer_than(settings.version):
            return
        try:
            self._pipeline.adopt(settings.options)
        except DetectorError as error:
            self.health.degraded("detector settings", f"version {settings.version} is refused: {error}")
            return
        self.health.well("detector settings")
        self._adopted.use(settings.version)
        self._status.adopted(settings.version)
        SETTINGS_VERSION.labels(self._camera.id).set(settings.version)
        log.info("detector settings", version=settings.version, options=settings.options, reason=settings.reason)

    def _learned_alignment(self) -> NDArray[np.float64]:
        """Return the correction of the calibration that is in use, the newest heard."""
        for delivery in self._alignments.receive(0.0):
            told = delivery.message
            if not isinstance(told, CameraAlignment) or self._aligned.is_newer_than(told.version):
                continue
            reason = alignment_problem(told.homography, self._watched)
            if reason := reason or calibration_problem(told.homography, told.geometry, self._calibration):
                self.health.degraded("alignment", f"version {told.version} is refused: {reason}")
                continue
            homography = np.array(told.homography).reshape(3, 3)
            self.health.well("alignment")
            if not np.array_equal(homography, self._alignment):
                self._watch.forget()  # what the camera shows now is what it is aligned to
            self._alignment = homography
            self._aligned.use(told.version)
            log.info("alignment", version=told.version, reason=told.reason)
        return self._alignment

    def _report(self) -> None:
        self.health.well("source")
        doubts = {
            "picture size": self._pipeline.doubt,
            "view": self._watch.verdict,
            "speed": self._keeping_up.doubt,
        }
        for topic, doubt in doubts.items():
            if doubt:
                self.health.degraded(topic, doubt)
            else:
                self.health.well(topic)
        doubt = "; ".join(filter(None, doubts.values()))
        if doubt:
            self._status.change("degraded", doubt)
        else:
            learning = self._pipeline.state == "learning"
            self._status.change("ok", "learning the background: people may be missed" if learning else "")
        self._status.refresh()

    def _fail(self, error: SourceError) -> None:
        FAILURES.labels(self._camera.id).inc()
        self.health.degraded("source", str(error))
        if not error.retry:
            self._rest("degraded", str(error))
            return
        self._status.change("degraded", str(error))
        log.info("trying again", source=str(self._camera.source), in_seconds=self._delay)
        again = time.monotonic() + self._delay
        self._delay = min(2.0 * self._delay, LONGEST_DELAY)
        while not self.stopping.wait(min(max(again - time.monotonic(), 0.0), 1.0)) and time.monotonic() < again:
            self._listen()
            self._status.refresh()

    def _rest(self, state: str, reason: str = "") -> None:
        """Stay alive and tell how things are until the process is stopped."""
        self._status.change("ended" if state == "ended" else "degraded", reason)
        while not self.stopping.wait(1.0):
            self._listen()
            self._status.refresh()
