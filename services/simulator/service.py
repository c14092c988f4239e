"""The site twin as a process: the world of a scenario, now, on the bus and at the real gateway.

Cameras whose detections are made publish them as a camera service would; cameras that are rendered are served over
HTTP, for a camera service to read; phones post to the gateway; the truth has its own key. A recorded file of people
may belong to a real camera's clip: its second zero is then the ``origin`` that this camera publishes, and a new
origin (a looping clip) begins the world anew.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import ClassVar

import cv2
import msgspec
import structlog
from prometheus_client import Counter, Histogram

from services.simulator.cameras.twin_camera import TwinCamera
from services.simulator.live_world import LiveWorld
from services.simulator.people import People, snapshot
from services.simulator.phones.phones import Phones
from services.simulator.scenario_file import RecordedPeople, RenderedView, Scenario
from services.simulator.scenario_loading import ScenarioError, load_scenario
from services.simulator.settings import SimulatorSettings
from services.simulator.video.rendering import HallRenderer
from services.simulator.video.video_light import VideoParameters
from services.simulator.video.video_server import FrameFeed, video_app
from services.simulator.world import World, cameras_of
from shared.http_server import serve
from shared.messages import CameraStatus, DetectionFrame
from shared.runner import Service
from shared.settings import SettingsError
from shared.site import Camera, Site
from shared.truth import GroundTruth, truth_key

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


class Simulator(Service[SimulatorSettings]):
    """Everything the site's people and their devices do."""

    name = "simulator"
    Settings: ClassVar[type[SimulatorSettings]] = SimulatorSettings

    @classmethod
    def check(cls, settings: SimulatorSettings, site: Site) -> None:
        """Refuse a scenario that is wrong or does not fit the site."""
        _load(settings)

    def run(self) -> None:
        """Simulate until stopped."""
        scenario, site = _load(self.settings)
        world = World(scenario, site, self.settings.seed)
        phones = Phones(
            world.phones,
            self.settings.gateway_url,
            self.settings.enrolment_key.get_secret_value(),
            world.seed,
            self._report_gateway,
        )
        names = ", ".join(carrier.person for carrier in world.carriers[:20]) or "nobody"
        log.info("people", scenario=scenario.scenario, count=len(world.people.persons), carrying_phones=names)
        phones.start()
        try:
            if isinstance(scenario.people, RecordedPeople) and scenario.people.camera is not None:
                self.health.ready.set()
                self._follow_clip(scenario, site, scenario.people.camera, phones)
            else:
                self._live(world, phones)
        finally:
            self.stopping.set()
            phones.stop()

    def _live(self, world: World, phones: Phones) -> None:
        live = LiveWorld(world, epoch := time.time(), report=self._report_world)
        feeds = {
            camera.id: (view.video, camera, FrameFeed())
            for view in world.scenario.views
            if isinstance(view, RenderedView)
            for camera in cameras_of(view.camera, world.site)
        }
        threads = [
            threading.Thread(target=self._render, args=(*feed, live, epoch), name=f"render {name}", daemon=True)
            for name, feed in feeds.items()
        ]
        threads.append(threading.Thread(target=self._play, args=(live, {}, phones, epoch, self.stopping), name="play"))
        for thread in threads:
            thread.start()
        self.health.ready.set()
        try:
            if feeds:
                served = {name: feed for name, (_, _, feed) in feeds.items()}
                threading.Thread(target=self._close, args=(served,), name="closing", daemon=True).start()
                serve(video_app(served), self.settings.video_host, self.settings.video_port, self.stopping)
            else:
                self.stopping.wait()
        finally:
            self.stopping.set()
            for thread in threads:
                thread.join(timeout=2.0)

    def _follow_clip(self, scenario: Scenario, site: Site, camera: str, phones: Phones) -> None:
        inbox = self.bus.inbox(capacity=100)
        inbox.subscribe(self.keys.camera_status(camera), CameraStatus, cached=True)
        origin: float | None = None
        ended = threading.Event()
        player: threading.Thread | None = None
        cameras: dict[str, TwinCamera] = {}
        self.health.degraded("clip", f"waiting for camera {camera} to tell when its clip began")
        while not self.stopping.is_set():
            for delivery in inbox.receive(timeout=0.5):
                status = delivery.message
                if not isinstance(status, CameraStatus) or status.origin is None or status.origin == origin:
                    continue
                origin = status.origin
                log.info("clip began", camera=camera, origin=origin)
                self.health.well("clip")
                ended.set()
                if player is not None:
                    player.join(timeout=2.0)
                ended = threading.Event()
                world = World(scenario, site, self.settings.seed)
                live = LiveWorld(world, origin, tied=True, report=self._report_world)
                player = threading.Thread(target=self._play, args=(live, cameras, phones, origin, ended), name="play")
                player.start()
        ended.set()
        if player is not None:
            player.join(timeout=2.0)

    def _play(
        self, live: LiveWorld, cameras: dict[str, TwinCamera], phones: Phones, epoch: float, ended: threading.Event
    ) -> None:
        """Publish and post what happens in the world, until ``ended``."""
        truth = self.bus.publisher(truth_key(self.keys), GroundTruth)
        phones.follow(epoch)
        for arrival in live.play(ended):
            message = arrival.message
            match message:
                case DetectionFrame():
                    camera = cameras.get(message.camera)
                    if camera is None:
                        camera = cameras[message.camera] = TwinCamera(self.bus, self.keys, message.camera)
                    camera.publish(msgspec.structs.replace(message, t=epoch + message.t), epoch)
                case GroundTruth():
                    if self.settings.truth:
                        enrolled = [phones.devices.get(person) for person in message.person]
                        truth.publish(msgspec.structs.replace(message, t=epoch + message.t, device=enrolled))
                case _:
                    phones.post(message)

    def _render(self, video: VideoParameters, camera: Camera, feed: FrameFeed, live: LiveWorld, epoch: float) -> None:
        """Render a camera's frames on time for as long as somebody watches."""
        world = live.world
        floor = world.site.floor(world.site.area(camera.area).floor)
        renderer = HallRenderer(
            floor, camera.geometry.build(), world.people.persons, world.seed, world.holds_phone, video
        )
        people: People = world.people
        period = 1.0 / video.frames_per_s
        rendered, skipped = RENDERED.labels(camera.id), LATE.labels(camera.id)
        number, shown = 0, 0.0
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
            shown = max(shown, live.world_time(t))  # a frame drawn while a late block came in would step back by a hair
            picture = renderer.frame(snapshot(people, shown, floor.id), t, number)
            good, jpeg = cv2.imencode(".jpg", picture, _JPEG)
            RENDER_TIME.observe(time.perf_counter() - begun)
            if good:
                feed.publish(jpeg.tobytes(), epoch + t)
                rendered.inc()

    def _close(self, feeds: Mapping[str, FrameFeed]) -> None:
        self.stopping.wait()
        for feed in feeds.values():
            feed.close()

    def _report_gateway(self, reason: str | None) -> None:
        self._tell("gateway", reason)

    def _report_world(self, reason: str | None) -> None:
        self._tell("world", reason)

    def _tell(self, topic: str, reason: str | None) -> None:
        if reason is None:
            self.health.well(topic)
        else:
            self.health.degraded(topic, reason)


def _load(settings: SimulatorSettings) -> tuple[Scenario, Site]:
    try:
        return load_scenario(settings.scenario_file(), settings.site_file)
    except ScenarioError as error:
        raise SettingsError(f"scenario: {error}") from error
