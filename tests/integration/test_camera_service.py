"""The camera as a process on a real router: every frame published, honest status, failures survived."""

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import yaml
from conftest import unused_port
from mjpeg_server import MjpegServer
from numpy.typing import NDArray
from waiting import wait_until

from shared.bus import Bus
from shared.keys import Keys
from shared.messages import CameraAlignment, CameraStatus, DetectionFrame
from shared.setup_told import SetupTold
from shared.site import load_site
from shared.site.geometry_digest import geometry_digest
from shared.site.setup_file import SetUp

KEYS = Keys("test")
COUNT = 40
DEADLINE = 30.0


def picture(number: int) -> NDArray[np.uint8]:
    """Textured ground, empty at first; then a white figure walks through."""
    texture = np.random.default_rng(3).integers(60, 120, (30, 40, 3), np.uint8)
    image = cv2.resize(texture, (320, 240), interpolation=cv2.INTER_CUBIC)
    if number >= COUNT // 2:
        left = 60 + 8 * (number - COUNT // 2)
        cv2.rectangle(image, (left, 90), (left + 12, 140), (240, 240, 240), -1)
    return np.asarray(image, np.uint8)


@pytest.fixture
def site_file(tmp_path: Path) -> Callable[..., Path]:
    def write(**source: object) -> Path:
        path = tmp_path / "site.yaml"
        outline = [[-20, -5], [20, -5], [20, 40], [-20, 40]]
        geometry = {
            "kind": "pose",
            "image_size": [640, 480],
            "position": [0, 0, 5],
            "look_at": [0, 12, 0],
            "horizontal_fov": 60,
        }
        camera = {"id": "door", "area": "hall", "source": source, "geometry": geometry}
        site = {
            "format": "atrium-site/1",
            "site": "test",
            "floors": [{"id": "ground", "outline": outline}],
            "areas": [{"id": "hall", "floor": "ground"}],
            "cameras": [camera],
        }
        path.write_text(yaml.safe_dump(site))
        return path

    return write


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (320, 240))
    for number in range(COUNT):
        writer.write(picture(number))
    writer.release()
    return path


class Watcher:
    """Starts camera processes and listens to what they publish."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.bus = Bus([endpoint])
        self.inbox = self.bus.inbox()
        self.frames: list[DetectionFrame] = []
        self.statuses: list[CameraStatus] = []
        self.processes: list[subprocess.Popen[str]] = []
        self.health_port = unused_port()
        self.inbox.subscribe(KEYS.camera_status(), CameraStatus, cached=True)

    def listen(self) -> None:
        self.inbox.subscribe(KEYS.detections(), DetectionFrame)

    def start(self, site: Path, *arguments: str, camera: str = "door") -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "services.camera", "--site-file", str(site), "--camera", camera]
        command += ["--bus", json.dumps([self.endpoint]), "--health-port", str(self.health_port), *arguments]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ)
        self.processes.append(process)
        return process

    def look(self) -> None:
        for delivery in self.inbox.receive(0.05):
            if isinstance(delivery.message, DetectionFrame):
                self.frames.append(delivery.message)
            elif isinstance(delivery.message, CameraStatus):
                self.statuses.append(delivery.message)

    def until(self, condition: Callable[[], object], what: str) -> None:
        def looked() -> object:
            self.look()
            return condition()

        wait_until(looked, DEADLINE, what)

    def until_state(self, state: str) -> CameraStatus:
        self.until(lambda: self.statuses and self.statuses[-1].state == state, f"state {state}")
        return self.statuses[-1]

    def problems(self) -> dict[str, str]:
        return dict(json.loads(self.get("/healthz"))["problems"])

    def get(self, path: str) -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.health_port}{path}", timeout=5.0) as answer:
            return str(answer.read().decode())


@pytest.fixture
def watcher(zenoh_router: str) -> Iterator[Watcher]:
    watcher = Watcher(zenoh_router)
    yield watcher
    watcher.bus.close()
    for process in watcher.processes:
        process.kill()
        process.wait()
        if process.stderr is not None:
            process.stderr.close()


def test_every_frame_is_published_also_the_empty_ones_and_the_end_is_told(
    watcher: Watcher, site_file: Callable[..., Path], video: Path
) -> None:
    watcher.listen()
    process = watcher.start(site_file(file=str(video)), "--pace", "fast", "--wait-for-subscriber")
    ended = watcher.until_state("ended")
    watcher.until(lambda: len(watcher.frames) == COUNT, "all frames")
    assert [frame.seq for frame in watcher.frames] == list(range(COUNT))
    assert {frame.floor for frame in watcher.frames} == {"ground"}
    assert any(not frame.x for frame in watcher.frames[: COUNT // 2])
    assert all(len(frame.x) == 1 for frame in watcher.frames[COUNT // 2 + 2 :])
    t = [frame.t for frame in watcher.frames]
    assert np.diff(t) == pytest.approx(1 / 20, abs=1e-6)
    assert ended.origin == t[0]
    assert ended.frames == COUNT
    assert [status.state for status in watcher.statuses][-2:] == ["ok", "ended"]
    # The process stays, healthy, and stops when it is told to.
    assert json.loads(watcher.get("/readyz")) == {"ready": True, "problems": {}}
    metrics = watcher.get("/metrics")
    assert f'atrium_camera_frames_total{{camera="door"}} {float(COUNT)}' in metrics
    assert f'atrium_camera_detect_seconds_count{{camera="door"}} {float(COUNT)}' in metrics
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=5.0) == 0


@pytest.mark.alone  # every frame is wanted, as quickly as they go: a crowded bus drops some
def test_nothing_is_played_before_somebody_subscribes_when_asked_to_wait(
    watcher: Watcher, site_file: Callable[..., Path], video: Path
) -> None:
    watcher.start(site_file(file=str(video)), "--pace", "fast", "--wait-for-subscriber")
    watcher.until(lambda: len(watcher.statuses) >= 2, "the second, refreshed status")
    assert {status.state for status in watcher.statuses} == {"starting"}
    assert watcher.statuses[-1].origin is None
    watcher.listen()
    watcher.until(lambda: len(watcher.frames) == COUNT, "all frames")


@pytest.mark.alone  # likewise
def test_a_camera_that_learns_its_background_says_so_and_a_new_pass_learns_it_anew(
    watcher: Watcher, site_file: Callable[..., Path], tmp_path: Path
) -> None:
    """The figure of the pass before's end must leave no hole where it stood, nor a ghost: passes are alike."""
    path = tmp_path / "slow.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (320, 240))
    for number in range(COUNT):
        writer.write(picture(number))
    writer.release()
    watcher.listen()
    watcher.start(site_file(file=str(path), loop=True), "--pace", "fast")
    watcher.until(lambda: len(watcher.frames) >= 3 * COUNT, "three passes")
    passes = [watcher.frames[start : start + COUNT] for start in range(0, 3 * COUNT, COUNT)]
    assert [frame.x for frame in passes[1]] == [frame.x for frame in passes[0]]
    assert [frame.x for frame in passes[2]] == [frame.x for frame in passes[0]]
    told = [(status.state, "learning" in status.reason) for status in watcher.statuses if status.state == "ok"]
    assert ("ok", True) in told
    assert ("ok", False) in told


def test_a_learned_correction_is_applied_also_after_a_restart_and_can_be_taken_back(
    watcher: Watcher, site_file: Callable[..., Path], video: Path
) -> None:
    shift = (1.0, 0.0, 0.0, 0.0, 1.0, 9.5, 0.0, 0.0, 1.0)  # people walk 8 to 12 m before the camera
    unit = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    publisher = watcher.bus.publisher(KEYS.alignment("door"), CameraAlignment, cached=True)
    site = site_file(file=str(video), loop=True)
    filed = geometry_digest(load_site(site).camera("door").geometry)
    learned = CameraAlignment(t=1.0, camera="door", version=1, homography=shift, geometry=filed)
    publisher.publish(learned)
    watcher.listen()
    watcher.start(site, "--wait-for-subscriber")
    watcher.until(lambda: any(y > 15.0 for frame in watcher.frames for y in frame.y), "people moved by 9.5 m")
    publisher.publish(CameraAlignment(t=2.0, camera="door", version=2, homography=unit))
    watcher.until(lambda: any(y < 15.0 for frame in watcher.frames[-10:] for y in frame.y), "people where they were")
    publisher.publish(learned)  # older: no news
    seen = len(watcher.frames)
    watcher.until(lambda: sum(bool(frame.x) for frame in watcher.frames[seen:]) > 5, "more people")
    assert all(y < 15.0 for frame in watcher.frames[seen:] for y in frame.y)

    # Corrected once more, then calibrated anew: the correction was one of the calibration before.
    publisher.publish(msgspec.structs.replace(learned, t=3.0, version=3))
    watcher.until(lambda: any(y > 15.0 for frame in watcher.frames[-10:] for y in frame.y), "people moved again")
    corners = np.array([[60, 460], [590, 440], [320, 300], [150, 250], [500, 240]], float)
    places = load_site(site).camera("door").geometry.build().to_ground(corners) - [0.0, 4.0]
    points = {"kind": "points", "image_size": [640, 480], "image": corners.tolist(), "plan": places.tolist()}
    setup = SetUp.model_validate({"site": "test", "version": 1, "cameras": {"door": {"geometry": points}}})
    told = SetupTold(t=4.0, version=1, setup=setup.model_dump_json())
    watcher.bus.publisher(KEYS.setup(), SetupTold, cached=True).publish(told)
    calibrated = geometry_digest(setup.cameras["door"].geometry or pytest.fail("no geometry"))
    watcher.until(lambda: watcher.statuses[-1].geometry == calibrated, "the calibration in use")
    seen = len(watcher.frames)
    watcher.until(lambda: sum(bool(frame.x) for frame in watcher.frames[seen:]) > 5, "people as calibrated now")
    assert all(3.0 < y < 9.0 for frame in watcher.frames[seen:] for y in frame.y), "4 m nearer, and not 9.5 m off"
    publisher.publish(msgspec.structs.replace(learned, t=5.0, version=4))
    watcher.until(lambda: "another calibration" in watcher.problems().get("alignment", ""), "a correction left out")
    assert all(y < 9.0 for frame in watcher.frames[seen:] for y in frame.y)


def test_an_unreachable_stream_is_degraded_until_it_comes_and_again_when_it_dies(
    watcher: Watcher, site_file: Callable[..., Path], free_port: int
) -> None:
    watcher.listen()
    process = watcher.start(site_file(url=f"http://viewer:topsecret@127.0.0.1:{free_port}/stream.mjpeg"))
    bad = watcher.until_state("degraded")
    assert f"nobody listens on port {free_port}" in bad.reason
    assert "source" in json.loads(watcher.get("/healthz"))["problems"]
    server = MjpegServer(free_port, lambda number: picture(0))
    first = watcher.until_state("ok")
    watcher.until(lambda: len(watcher.frames) >= 5, "frames")
    server.close()
    watcher.until_state("degraded")
    server = MjpegServer(free_port, lambda number: picture(0))
    second = watcher.until_state("ok")
    assert second.origin > (first.origin or 0.0)  # type: ignore[operator]
    assert json.loads(watcher.get("/healthz"))["problems"] == {}
    server.close()
    assert process.poll() is None
    process.terminate()
    assert process.wait(timeout=5.0) == 0
    assert "topsecret" not in process.communicate()[1]
    assert not any("topsecret" in status.reason for status in watcher.statuses)


@pytest.mark.parametrize("content", [None, b"this is no video"])
def test_a_missing_or_corrupt_file_is_one_clear_message_and_no_crash(
    watcher: Watcher, site_file: Callable[..., Path], tmp_path: Path, content: bytes | None, video: Path
) -> None:
    path = tmp_path / "broken.avi"
    if content is not None:
        path.write_bytes(content)
    watcher.listen()
    process = watcher.start(site_file(file=str(path)), "--pace", "fast")
    status = watcher.until_state("degraded")
    assert str(path) in status.reason
    path.write_bytes(video.read_bytes())  # somebody repairs it
    watcher.until_state("ended")
    assert process.poll() is None
    process.terminate()
    log = process.communicate(timeout=5.0)[1]
    assert log.count("degraded") == 1
    assert "Traceback" not in log


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--camera", "window"], "'window' is no camera"),
        (["--detector", "magic"], "'magic' is unknown"),
        (["--detector-options", '{"learning_rate": -1}'], "detector_options.learning_rate"),
        (["--pace", "slow"], "pace"),
    ],
)
def test_wrong_settings_are_refused_before_anything_opens(
    watcher: Watcher, site_file: Callable[..., Path], arguments: list[str], told: str
) -> None:
    process = watcher.start(site_file(device=0), *arguments)
    _, log = process.communicate(timeout=DEADLINE)
    assert process.returncode == 2
    assert told in log
    if "window" in arguments:
        assert "allowed: door" in log


def test_pictures_of_other_proportions_than_the_calibration_are_told(
    watcher: Watcher, site_file: Callable[..., Path], tmp_path: Path
) -> None:
    folder = tmp_path / "wide"
    folder.mkdir()
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), np.zeros((90, 160, 3), np.uint8))
    watcher.start(site_file(folder=str(folder), frames_per_s=5, loop=True), "--pace", "source")
    assert "160 x 90" in watcher.until_state("degraded").reason
