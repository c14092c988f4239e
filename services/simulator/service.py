"""The site twin as a process: walkers or a recorded clip's people, their phones, rendered cameras, and the truth.

Walkers live on the wall clock from the moment the service starts. Recorded trajectories belong to a camera's clip:
their second zero is the ``origin`` that this camera publishes, and a new origin (a looping clip) is a new pass.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal
from urllib.parse import urlsplit

import cv2
import structlog
from prometheus_client import Counter, Histogram

from services.simulator.people import People
from services.simulator.phone import EmulatedPhone
from services.simulator.phones import Phones
from services.simulator.radio_world import RadioParameters, RadioWorld
from services.simulator.rendering import HallRenderer
from services.simulator.settings import SimulatorSettings
from services.simulator.trajectories import Trajectories, TrajectoryError
from services.simulator.video_server import FrameFeed, video_app
from services.simulator.walkers import Walkers
from shared.http_server import serve
from shared.messages import CameraStatus
from shared.truth import GroundTruth, truth_key
from shared.runner import Service
from shared.settings import SettingsError
from shared.site import Camera, Floor, Site

__all__ = ["Simulator"]

log = structlog.get_logger(__name__)

RENDERED = Counter("atrium_simulator_frames_total", "Rendered frames", ["camera"])
LATE = Counter(
    "atrium_simulator_frames_skipped_total", "Frames not rendered because the machine fell behind", ["camera"]
)
RENDER_TIME = Histogram(
    "atrium_simulator_render_seconds",
    "Time to render and encode a frame",
    buckets=(0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2),
)

_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 85]
_TRUTH_PERIOD = 0.1


class Simulator(Service[SimulatorSettings]):
    """Everything the site's people and their devices do."""

    name = "simulator"
    Settings: ClassVar[type[SimulatorSettings]] = SimulatorSettings

    @classmethod
    def check(cls, settings: SimulatorSettings, site: Site) -> None:
        """Refuse a trajectory file that cannot be read, and cameras, floors and people that do not exist."""
        _floor(settings, site)
        if settings.trajectories is not None:
            _clip_camera(settings, site)
        people = _people(settings, site)
        unknown = [person for person in settings.explicit_phones() or [] if person not in people.persons]
        if unknown:
            raise SettingsError(
                f"phones: there is nobody called {', '.join(unknown)}; people are {', '.join(people.persons)}"
            )

    def run(self) -> None:
        """Simulate until stopped."""
        settings = self.settings
        people = _people(settings, self.site)
        floor = _floor(settings, self.site)
        carriers = _carriers(settings, people)
        radio = RadioParameters(
            shadowing_sigma=settings.radio_shadowing,
            shadowing_length=settings.radio_shadowing_length,
            noise_sigma=settings.radio_noise,
        )
        world = RadioWorld(self.site, settings.seed, radio)
        started = time.time()
        phones = Phones(
            [
                EmulatedPhone(
                    self.site,
                    world,
                    person,
                    floor.id,
                    settings.seed,
                    _carrying(settings, number),
                    settings.scan_interval,
                    started,
                )
                for number, person in enumerate(carriers)
            ],
            settings.gateway_url,
            settings.enrolment_key.get_secret_value(),
            settings.seed,
            self._report_gateway,
        )
        log.info("people", count=len(people.persons), carrying_phones=", ".join(carriers) or "nobody")
        threads: list[threading.Thread] = []
        feeds: dict[str, FrameFeed] = {}
        phones.start()
        try:
            if isinstance(people, Trajectories):
                self.health.ready.set()
                self._follow_clip(people, floor, phones)
                return
            cameras = _rendered_cameras(self.site, floor)
            renderers = {camera.id: self._renderer(camera, floor, people, carriers) for camera in cameras}
            epoch = time.time()
            phones.follow(people, epoch)
            feeds = {camera: FrameFeed() for camera in renderers}
            for camera, renderer in renderers.items():
                work = (camera, renderer, people, epoch, feeds[camera])
                threads.append(threading.Thread(target=self._render, args=work, name=f"render {camera}", daemon=True))
            truth = (people, floor, phones, epoch, self.stopping)
            threads.append(threading.Thread(target=self._tell_truth, args=truth, name="truth", daemon=True))
            for thread in threads:
                thread.start()
            self.health.ready.set()
            if feeds:
                closing = threading.Thread(target=self._close, args=(feeds,), name="closing", daemon=True)
                closing.start()
                serve(video_app(feeds), settings.video_host, settings.video_port, self.stopping)
            else:
                self.stopping.wait()
        finally:
            self.stopping.set()
            phones.stop()
            for thread in threads:
                thread.join(timeout=1.0)

    def _follow_clip(self, people: Trajectories, floor: Floor, phones: Phones) -> None:
        camera = _clip_camera(self.settings, self.site)
        inbox = self.bus.inbox(capacity=100)
        inbox.subscribe(self.keys.camera_status(camera.id), CameraStatus, cached=True)
        origin: float | None = None
        ended = threading.Event()
        teller: threading.Thread | None = None
        self.health.degraded("clip", f"waiting for camera {camera.id} to tell when its clip began")
        while not self.stopping.is_set():
            for delivery in inbox.receive(timeout=0.5):
                status = delivery.message
                if not isinstance(status, CameraStatus) or status.origin is None or status.origin == origin:
                    continue
                origin = status.origin
                log.info("clip began", camera=camera.id, origin=origin)
                self.health.well("clip")
                ended.set()
                if teller is not None:
                    teller.join(timeout=2.0)
                ended = threading.Event()
                phones.follow(people, origin)
                teller = threading.Thread(
                    target=self._tell_truth, args=(people, floor, phones, origin, ended), name="truth", daemon=True
                )
                teller.start()
        ended.set()

    def _tell_truth(self, people: People, floor: Floor, phones: Phones, epoch: float, ended: threading.Event) -> None:
        """Publish where everybody is, at the table's or the walkers' own instants, until ``ended``."""
        if not self.settings.truth:
            return
        publisher = self.bus.publisher(truth_key(self.keys), GroundTruth)
        told = -1.0
        while not ended.wait(_TRUTH_PERIOD) and not self.stopping.is_set():
            now = time.time() - epoch
            devices = phones.devices
            for t in people.instants(told, now).tolist():
                there = people.snapshot(t)
                publisher.publish(
                    GroundTruth(
                        t=epoch + t,
                        person=list(there.person),
                        floor=[floor.id] * len(there.person),
                        x=there.position[:, 0].tolist(),
                        y=there.position[:, 1].tolist(),
                        device=[devices.get(person) for person in there.person],
                    )
                )
                told = t

    def _renderer(self, camera: Camera, floor: Floor, people: People, carriers: Sequence[str]) -> HallRenderer:
        carrying = {p for n, p in enumerate(carriers) if _carrying(self.settings, n) == "hand"}
        return HallRenderer(
            floor, camera.geometry.build(), people.persons, self.settings.seed, lambda person: person in carrying
        )

    def _render(self, camera: str, renderer: HallRenderer, people: People, epoch: float, feed: FrameFeed) -> None:
        """Render a camera's frames on time for as long as somebody watches."""
        period = 1.0 / self.settings.frames_per_s
        rendered, skipped = RENDERED.labels(camera), LATE.labels(camera)
        number = 0
        while not self.stopping.is_set():
            feed.someone_watches.wait(0.5)
            if not feed.someone_watches.is_set():
                number = 0
                continue
            now = time.time() - epoch
            due = int(now / period)
            if number and due > number + 1:
                skipped.inc(due - number - 1)
            number = max(due, number + 1)
            if self.stopping.wait(max(0.0, number * period - (time.time() - epoch))):
                return
            t = number * period
            begun = time.perf_counter()
            picture = renderer.frame(people.snapshot(t), t, number)
            good, jpeg = cv2.imencode(".jpg", picture, _JPEG)
            RENDER_TIME.observe(time.perf_counter() - begun)
            if good:
                feed.publish(jpeg.tobytes(), epoch + t)
                rendered.inc()

    def _close(self, feeds: dict[str, FrameFeed]) -> None:
        self.stopping.wait()
        for feed in feeds.values():
            feed.close()

    def _report_gateway(self, reason: str | None) -> None:
        if reason is None:
            self.health.well("gateway")
        else:
            self.health.degraded("gateway", reason)


def _people(settings: SimulatorSettings, site: Site) -> Walkers | Trajectories:
    if settings.trajectories is None:
        floor = _floor(settings, site)
        try:
            return Walkers(floor.plan(), settings.people, settings.seed)
        except ValueError as error:
            raise SettingsError(f"walkers: floor {floor.id}: {error}") from error
    path = settings.site_file.parent / settings.trajectories
    try:
        return Trajectories.from_mot(path) if settings.trajectory_format == "mot" else Trajectories.from_csv(path)
    except TrajectoryError as error:
        raise SettingsError(f"trajectories: {error}") from error


def _floor(settings: SimulatorSettings, site: Site) -> Floor:
    if settings.trajectories is not None and site.cameras:
        return site.floor(site.area(_clip_camera(settings, site).area).floor)
    if not settings.walkers:
        return site.floors[0]
    for area in site.areas:
        if area.id == settings.walkers:
            return site.floor(area.floor)
    for floor in site.floors:
        if floor.id == settings.walkers:
            return floor
    known = ", ".join([*(area.id for area in site.areas), *(floor.id for floor in site.floors)])
    raise SettingsError(f"walkers: {settings.walkers!r} is no area or floor of the site file; it has: {known}")


def _clip_camera(settings: SimulatorSettings, site: Site) -> Camera:
    if not site.cameras:
        raise SettingsError("trajectories: the site has no camera whose clip they could follow")
    if not settings.trajectory_camera:
        return site.cameras[0]
    try:
        return site.camera(settings.trajectory_camera)
    except KeyError as error:
        raise SettingsError(f"trajectory_camera: {error.args[0]}") from error


def _rendered_cameras(site: Site, floor: Floor) -> list[Camera]:
    """Return the cameras of this floor whose pictures the site file expects from here, by the path of their URL."""
    return [
        camera
        for camera in site.cameras
        if site.area(camera.area).floor == floor.id
        and camera.source.url is not None
        and Path(urlsplit(camera.source.url).path) == Path(f"/cameras/{camera.id}.mjpeg")
    ]


def _carriers(settings: SimulatorSettings, people: Walkers | Trajectories) -> list[str]:
    """Return who carries phones: those named, else those with the most time in the table, else the first visitors."""
    named = settings.explicit_phones()
    if named is not None:
        return named
    count = int(settings.phones)
    return people.longest_present(count) if isinstance(people, Trajectories) else list(people.persons[:count])


def _carrying(settings: SimulatorSettings, number: int) -> Literal["hand", "pocket"]:
    if settings.carrying == "mixed":
        return "hand" if number % 3 else "pocket"
    return settings.carrying
