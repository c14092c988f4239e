"""A camera that learns, as a process on a real router: it adopts settings while it runs, and tries others aside."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from conftest import unused_port
from mjpeg_server import MjpegServer
from waiting import wait_until

from shared.bus import Bus
from shared.keys import Keys
from shared.messages import CameraAlignment, CameraStatus, DetectionFrame, DetectorSettings
from shared.site import load_site
from shared.site.geometry_digest import geometry_digest

KEYS = Keys("test")
RATE = 10.0
SECONDS = 12.0
DEADLINE = 30.0
PATIENCE = 120.0
"""A trial gives way to whatever else this machine does."""


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Textured ground; from 4 s on a white figure walks up and down."""
    path = tmp_path_factory.mktemp("film") / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (320, 240))
    texture = np.random.default_rng(3).integers(60, 120, (30, 40, 3), np.uint8)
    scene = cv2.resize(texture, (320, 240), interpolation=cv2.INTER_CUBIC)
    for number in range(round(SECONDS * RATE)):
        image = np.asarray(scene.copy(), np.uint8)
        if number >= 40:
            left = 150 + round(90.0 * np.sin(0.05 * (number - 40)))
            cv2.rectangle(image, (left, 90), (left + 12, 140), (240, 240, 240), -1)
        writer.write(image)
    writer.release()
    return path


class Running:
    """One camera process, and what it publishes."""

    def __init__(self, endpoint: str, folder: Path, source: dict[str, object], *arguments: str) -> None:
        site = {
            "format": "atrium-site/1",
            "site": "test",
            "floors": [{"id": "ground", "outline": [[-20, -5], [20, -5], [20, 40], [-20, 40]]}],
            "areas": [{"id": "hall", "floor": "ground"}],
            "cameras": [
                {
                    "id": "door",
                    "area": "hall",
                    "source": source,
                    "geometry": {
                        "kind": "pose",
                        "image_size": [640, 480],
                        "position": [0, 0, 5],
                        "look_at": [0, 12, 0],
                        "horizontal_fov": 60,
                    },
                }
            ],
        }
        file = folder / "site.yaml"
        file.write_text(yaml.safe_dump(site))
        self.calibration = geometry_digest(load_site(file).camera("door").geometry)
        self.bus = Bus([endpoint])
        self.inbox = self.bus.inbox()
        self.frames: list[DetectionFrame] = []
        self.status: CameraStatus | None = None
        self.inbox.subscribe(KEYS.camera_status(), CameraStatus, cached=True)
        self.inbox.subscribe(KEYS.detections(), DetectionFrame)
        self.settings = self.bus.publisher(KEYS.detector_settings("door"), DetectorSettings, cached=True)
        self.alignment = self.bus.publisher(KEYS.alignment("door"), CameraAlignment, cached=True)
        command = [sys.executable, "-m", "services.camera", "--site-file", str(file), "--camera", "door"]
        command += ["--bus", json.dumps([endpoint]), "--health-port", str(unused_port()), *arguments]
        self.command = command
        self.process = self.start()

    def start(self) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(self.command, stderr=subprocess.DEVNULL, env=os.environ)

    def look(self) -> CameraStatus | None:
        for delivery in self.inbox.receive(0.05):
            if isinstance(delivery.message, DetectionFrame):
                self.frames.append(delivery.message)
            elif isinstance(delivery.message, CameraStatus):
                self.status = delivery.message
        return self.status

    def until(self, condition: Callable[[], object], what: str) -> None:
        wait_until(lambda: self.look() is not None and condition(), DEADLINE, what)

    def adopt(self, version: int, **options: float) -> None:
        self.settings.publish(DetectorSettings(t=time.time(), camera="door", version=version, options=options))

    def align(self, version: int, *homography: float) -> None:
        wanted = CameraAlignment(
            t=time.time(),
            camera="door",
            version=version,
            homography=homography,  # type: ignore[arg-type]
            geometry=self.calibration,
        )
        self.alignment.publish(wanted)

    def problems(self) -> dict[str, str]:
        told = list(self.bus.ask(KEYS.health("camera", "door"), 2.0))
        return dict(json.loads(told[0][1])) if told else {}

    def ask(self, **question: object) -> dict[str, object]:
        told = list(self.bus.ask(KEYS.redetect("door"), PATIENCE, json.dumps(question).encode()))
        return dict(json.loads(told[0][1]))

    def close(self) -> None:
        self.bus.close()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def start(zenoh_router: str, tmp_path: Path) -> Iterator[Callable[..., Running]]:
    running: list[Running] = []

    def begin(source: dict[str, object], *arguments: str) -> Running:
        running.append(Running(zenoh_router, tmp_path, source, *arguments))
        return running[-1]

    yield begin
    for one in running:
        one.close()


def test_settings_are_adopted_live_refused_with_a_reason_and_known_after_a_restart(
    start: Callable[..., Running], video: Path
) -> None:
    camera = start({"file": str(video), "loop": True})
    camera.until(lambda: camera.status and camera.status.state == "ok", "pictures")
    camera.adopt(3, learning_rate=0.05, sensitivity=20.0)
    camera.until(lambda: camera.status and camera.status.settings_version == 3, "version 3")
    camera.adopt(4, learning_rate=-1.0)
    camera.until(lambda: "version 4 is refused" in camera.problems().get("detector settings", ""), "a refusal")
    assert "learning_rate" in camera.problems()["detector settings"]
    camera.adopt(5)  # as configured
    camera.until(lambda: camera.status and camera.status.settings_version == 5, "version 5")
    assert camera.problems() == {}
    camera.align(2, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0)
    camera.until(lambda: "version 2 is refused" in camera.problems().get("alignment", ""), "a refused alignment")
    camera.align(2, 1e300, 0.0, 0.0, 0.0, 1e300, 0.0, 0.0, 0.0, 1.0)
    camera.until(lambda: "nine finite numbers" in camera.problems().get("alignment", ""), "a refused overflow")
    camera.align(2, 1.0, 0.0, 500.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    camera.until(lambda: "at most 10 m" in camera.problems().get("alignment", ""), "a refused shift")
    camera.align(3, 1.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    camera.until(lambda: camera.problems() == {}, "an alignment that can be used")
    camera.process.kill()
    camera.process.wait()
    camera.status = None
    camera.process = camera.start()
    camera.until(lambda: camera.status and camera.status.settings_version == 5, "the cached version")


def test_other_options_are_tried_on_the_last_pictures_while_the_camera_goes_on(
    start: Callable[..., Running], video: Path
) -> None:
    camera = start({"file": str(video)}, "--pace", "fast", "--ring-rate", "10", "--wait-for-subscriber")
    camera.until(lambda: camera.status and camera.status.state == "ended", "the end")
    assert "learning_rate" in str(camera.ask(options={"learning_rate": 99.0})["error"])
    same = camera.ask()
    frames = same["frames"]
    assert isinstance(frames, list)
    live = {round(frame.t, 3): frame for frame in camera.frames}
    assert len(frames) > 60
    # JPEG once more is all that differs from what was published.
    counts = [(len(frame["x"]), len(live[round(frame["t"], 3)].x)) for frame in frames]
    assert sum(a == b for a, b in counts) > 0.9 * len(counts)
    assert dict(same["options"])["learning_rate"] == 0.01  # type: ignore[call-overload]
    assert same["rate"] == pytest.approx(RATE, rel=0.02)
    deaf = camera.ask(options={"sensitivity": 200.0, "learning_rate": 5.0}, since=same["since"])
    assert deaf["since"] == same["since"]
    assert [f["t"] for f in deaf["frames"]] == [f["t"] for f in frames]  # type: ignore[attr-defined]
    assert sum(len(f["x"]) for f in deaf["frames"]) < sum(len(f["x"]) for f in frames)  # type: ignore[attr-defined]


def children(process: int) -> list[int]:
    tasks = Path(f"/proc/{process}/task")
    return [int(child) for task in tasks.iterdir() for child in (task / "children").read_text().split()]


def test_live_pictures_never_wait_for_a_trial(start: Callable[..., Running], video: Path) -> None:
    camera = start({"file": str(video), "loop": True}, "--pace", "fast", "--ring-rate", "10")
    camera.until(lambda: len(camera.frames) > 100, "pictures")
    answers: list[dict[str, object]] = []

    def ask() -> None:
        while not answers or "too few" in str(answers[-1].get("error")) or "5 s or more" in str(answers[-1]):
            answers.append(camera.ask())

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    camera.until(lambda: children(camera.process.pid), "a trial")
    [trial] = children(camera.process.pid)
    os.kill(trial, signal.SIGSTOP)
    try:
        camera.until(lambda: os.getpriority(os.PRIO_PROCESS, trial) == 19, "the lowest priority")
        seen = len(camera.frames)
        camera.until(lambda: len(camera.frames) > seen + 50, "pictures while a trial stands still")
        assert asking.is_alive()
    finally:
        os.kill(trial, signal.SIGKILL)
    wait_until(lambda: not asking.is_alive(), DEADLINE, "the answer")
    assert "the trial failed" in str(answers[-1]["error"])


def test_without_pictures_it_says_so(start: Callable[..., Running], video: Path) -> None:
    camera = start({"file": str(video), "loop": True}, "--ring-megabytes", "0")
    camera.until(lambda: camera.status and camera.status.state == "ok", "pictures")
    assert "ring_megabytes" in str(camera.ask()["error"])


def test_a_covered_camera_is_degraded_and_says_why(start: Callable[..., Running], tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    texture = np.random.default_rng(3).integers(40, 200, (30, 40, 3), np.uint8)
    scene = cv2.resize(texture, (160, 120), interpolation=cv2.INTER_CUBIC)
    for number in range(75):
        cv2.imwrite(str(folder / f"{number}.png"), scene if number < 30 else np.full_like(scene, 50))
    source = {"folder": str(folder), "frames_per_s": 0.5}
    camera = start(source, "--pace", "fast", "--ring-rate", "0.5", "--wait-for-subscriber")
    camera.until(lambda: camera.status and camera.status.state == "degraded", "the verdict")
    assert camera.status is not None
    assert "covered" in camera.status.reason
    assert "covered" in camera.problems()["view"]
    assert "covered" in str(camera.ask()["error"])  # there is nothing to be learned from


def test_a_camera_that_knows_the_empty_scene_finds_who_stands_there_at_its_start(
    start: Callable[..., Running], tmp_path: Path, free_port: int
) -> None:
    texture = np.random.default_rng(3).integers(40, 160, (30, 40, 3), np.uint8)
    scene = np.asarray(cv2.resize(texture, (320, 240), interpolation=cv2.INTER_CUBIC), np.uint8)
    stood = scene.copy()
    cv2.rectangle(stood, (150, 90), (162, 140), (240, 240, 240), -1)
    path = tmp_path / "scene.png"
    cv2.imwrite(str(path), scene)
    covered = np.full_like(scene, 255)
    server = MjpegServer(free_port, lambda number: covered if 80 <= number < 90 else stood)
    try:
        camera = start({"url": f"http://127.0.0.1:{free_port}/stream.mjpeg"}, "--scene-file", str(path))
        camera.until(lambda: len(camera.frames) >= 5, "detections")
        assert all(len(frame.x) == 1 for frame in camera.frames)
        # A hand before the lens: the background is lost, and does not take who stands there for furniture afterwards.
        camera.until(lambda: not camera.frames[-1].x, "a covered lens")
        camera.until(lambda: camera.frames[-1].x, "the figure")
        covered_for = len(camera.frames)
        camera.until(lambda: len(camera.frames) >= covered_for + 10, "more detections")
        assert {len(frame.x) for frame in camera.frames[covered_for:]} == {1}
    finally:
        server.close()
