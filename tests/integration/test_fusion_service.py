"""Fusion as a real process on a real router: what it publishes, in which order, and what it survives."""

import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import unused_port
from fusion_world import SITE, World, frame
from health_page import get, metric
from waiting import wait_until

from services.fusion.area_view import AreaView
from services.fusion.evidence.tracker import AnonymousTracker
from services.fusion.replay import replay_tracks
from services.fusion.service import FusionService
from services.fusion.settings import FusionSettings
from shared.bus import Bus, Delivery, Inbox, Trace, router
from shared.keys import Keys
from shared.messages import (
    ChunkMark,
    DetectionFrame,
    Erasure,
    ErasureDone,
    Message,
    MotionBatch,
    RadioModelUpdate,
    RadioScan,
    Revision,
    TrackFrame,
    encode,
)
from shared.radio import PathLoss, RadioModel, ShadowingMap, pack_radio_model, write_radio_model
from shared.runner import Health
from shared.settings import SettingsError
from shared.site import load_site

KEYS = Keys("test-hall")
POINTS = [f"ap-{number}" for number in range(1, 7)]
DEADLINE = 20.0
Start = Callable[..., tuple["subprocess.Popen[str]", int]]


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    path.write_text(SITE)
    return path


@pytest.fixture
def start(project: Path, site_file: Path) -> Iterator[Start]:
    processes = []

    def launch(endpoint: str, *flags: str, wait: bool = True) -> tuple["subprocess.Popen[str]", int]:
        port = unused_port()
        command = [
            sys.executable,
            "-m",
            "services.fusion",
            "--site-file",
            str(site_file),
            "--bus",
            json.dumps([endpoint]),
        ]
        environment = {k: v for k, v in os.environ.items() if not k.startswith("ATRIUM_")}
        process = subprocess.Popen(
            [*command, "--health-port", str(port), *flags],
            stderr=subprocess.PIPE,
            text=True,
            cwd=project,
            env=environment,
        )
        processes.append(process)
        if wait:
            wait_until(
                lambda: get(port, "/readyz")[0] == 200 or process.poll() is not None, DEADLINE, "fusion to be ready"
            )
        return process, port

    yield launch
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


def radio_model() -> PathLoss:
    corners = [(0.3, 0.3), (12.0, 0.3), (23.7, 0.3), (23.7, 13.7), (12.0, 13.7), (0.3, 13.7)]
    positions = np.array([(x, y, 2.8) for x, y in corners])
    return PathLoss(tuple(POINTS), positions, np.full(6, -40.0), np.full(6, 2.2))


class Stage:
    """A camera and a phone that tell of one person walking, and an ear for what fusion makes of it."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.inbox = bus.inbox()
        self.inbox.subscribe(KEYS.chunks("hall"), ChunkMark)
        self.inbox.subscribe(KEYS.tracks("hall"), TrackFrame)
        self.sent: dict[str, Message] = {}
        self.heard: list[Delivery[Message]] = []
        self._west = bus.publisher(KEYS.detections("west"), DetectionFrame)
        self._east = bus.publisher(KEYS.detections("east"), DetectionFrame)
        self._radio = bus.publisher(KEYS.radio("phone"), RadioScan)
        self._motion = bus.publisher(KEYS.motion("phone"), MotionBatch)
        self._radio_model = radio_model()
        self._number = itertools.count()
        self.t0 = time.time()

    def play(self, frames: int) -> None:
        """Send frames of both cameras, and what a phone tells with every tenth of them."""
        for _ in range(frames):
            number = next(self._number)
            t = self.t0 + number / 10
            place = [(6.0 + 0.05 * (number % 200), 7.0)]
            if number % 10 == 5:
                rssi = self._radio_model.rssi(np.array(place))[0].tolist()
                scan = RadioScan(t=t, device="phone", seq=number, access_point=POINTS, rssi=rssi)
                self._note(self._radio.publish(scan), scan)
                batch = MotionBatch(
                    t=t, t_start=t - 1.0, device="phone", seq=number, activity="walking", step_t=[t], length=[0.5],
                    length_variance=[0.01], heading=[0.0], heading_variance=[0.05],
                )  # fmt: skip
                self._note(self._motion.publish(batch), batch)
            for name, publisher in (("west", self._west), ("east", self._east)):
                seen = frame(t, place, name, number)
                self._note(publisher.publish(seen, origin=time.time() - 0.05), seen)
            self._until_followed()

    def play_world(self, world: World) -> None:
        """Send all that one camera and everybody's phone tell in a made-up world."""
        radio = {str(number): self.bus.publisher(KEYS.radio(str(number)), RadioScan) for number in range(world.people)}
        scans = deque(world.scans())
        for seen in world.frames():
            while scans and scans[0].t + 0.5 <= seen.t:
                radio[scans[0].device].publish(scans[0])
                scans.popleft()
            self._west.publish(seen)
            self._until_followed()

    def _until_followed(self) -> None:
        """Wait until fusion has told anything: of frames sent in a burst it takes the newest only."""
        heard, deadline = len(self.tracks()), time.monotonic() + 0.2
        while len(self.tracks()) == heard and time.monotonic() < deadline:
            pass

    def _note(self, trace: Trace, message: Message) -> None:
        self.sent[trace.id] = message

    def listen(self) -> list[Delivery[Message]]:
        self.heard += self.inbox.receive(timeout=0.05)
        return self.heard

    def tracks(self) -> list[TrackFrame]:
        return [d.message for d in self.listen() if isinstance(d.message, TrackFrame)]

    def until_told(self, count: int) -> None:
        """Play on, no faster than fusion follows, until so many track frames were heard."""

        def told() -> bool:
            self.play(1)
            return len(self.tracks()) >= count

        wait_until(told, DEADLINE, f"{count} track frames")

    def complete(self) -> tuple[list[ChunkMark], dict[int, TrackFrame]]:
        """Return all marks in order and the tracks by chunk, once every mark has its tracks and the other way round."""

        def both() -> tuple[list[ChunkMark], dict[int, TrackFrame]] | None:
            messages = [d.message for d in self.listen()]
            marks = {one.chunk: one for one in messages if isinstance(one, ChunkMark)}
            tracks = {one.chunk: one for one in messages if isinstance(one, TrackFrame)}
            assert len(marks) + len(tracks) == len(messages)
            if marks.keys() != tracks.keys():
                return None
            return [marks[chunk] for chunk in sorted(marks)], dict(sorted(tracks.items()))

        found = wait_until(both, DEADLINE, "tracks for every mark")
        assert found is not None
        return found

    def consumed(self, marks: list[ChunkMark]) -> list[tuple[ChunkMark, list[Message]]]:
        """Return each mark with the messages it names."""
        return [(mark, [self.sent[name] for name in mark.consumed]) for mark in marks]

    def until_tracked(self, beyond: int = 0) -> TrackFrame:
        """Play on until a frame with a person comes that is newer than the first ``beyond`` frames heard."""

        def tracked() -> TrackFrame | None:
            self.play(1)
            frames = self.tracks()[beyond:]
            return frames[-1] if frames and frames[-1].track else None

        found = wait_until(tracked, DEADLINE, "a tracked person")
        assert found is not None
        return found


def test_marks_come_before_tracks_name_what_was_consumed_and_replay_to_the_byte(
    zenoh_router: str, start: Start, site_file: Path
) -> None:
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)  # listens before fusion begins: nothing of it is missed
        _, port = start(zenoh_router, "--area", "hall")
        stage.until_tracked()
        stage.until_told(75)
        marks, told = stage.complete()
        assert len(told) >= 75
        # Two keys may overtake each other on the bus; the trace numbers tell the order of publishing.
        published = {
            (type(d.message), d.message.chunk): int(d.trace.id.rsplit("-", 1)[1])
            for d in stage.heard
            if isinstance(d.message, ChunkMark | TrackFrame)
        }
        for chunk in told:
            assert published[ChunkMark, chunk] < published[TrackFrame, chunk]
        replayed = list(replay_tracks(stage.consumed(marks), load_site(site_file), "hall"))
        assert [tracks.chunk for tracks in replayed] == list(told)
        assert [encode(tracks) for tracks in replayed] == [encode(tracks) for tracks in told.values()]
        # The origin of the newest picture travels on, and latency is measured against it.
        newest = [d for d in stage.heard if isinstance(d.message, TrackFrame)][-1]
        assert newest.trace.sent - newest.trace.origin >= 0.05
        assert metric(port, "atrium_detection_to_track_seconds_count") >= 75
        assert metric(port, "atrium_capture_to_track_seconds_sum") > metric(
            port, "atrium_detection_to_track_seconds_sum"
        )


def test_a_recorder_that_joins_in_mid_run_gets_the_state_of_a_chunk_boundary(
    zenoh_router: str, start: Start, site_file: Path
) -> None:
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        start(zenoh_router, "--area", "hall")
        assert json.loads(dict(bus.ask(KEYS.fusion_state("hall")))[KEYS.fusion_state("hall")])["chunk"] == -1
        stage.until_tracked()
        ((_, state),) = bus.ask(KEYS.fusion_state("hall"))
        seen = len(stage.tracks())
        stage.until_told(seen + 25)
        marks, told = stage.complete()
        done = json.loads(state)["chunk"]
        assert done > 0
        later = [tracks for chunk, tracks in told.items() if chunk > done]
        assert len(later) >= 25
        replayed = list(replay_tracks(stage.consumed(marks), load_site(site_file), "hall", state))
        assert [tracks.chunk for tracks in replayed] == [tracks.chunk for tracks in later]
        assert [encode(tracks) for tracks in replayed] == [encode(tracks) for tracks in later]


def test_a_state_that_takes_long_to_encode_holds_no_track_up(
    zenoh_router: str, site_file: Path, tmp_path: Path
) -> None:
    encoding, go_on = threading.Event(), threading.Event()

    class Slow(AnonymousTracker):
        def snapshot(self) -> Callable[[], bytes]:
            encode = super().snapshot()

            def slowly() -> bytes:
                encoding.set()
                assert go_on.wait(DEADLINE)
                return encode()

            return slowly

    settings = FusionSettings.model_validate(
        {"site_file": site_file, "area": "hall", "bus": [zenoh_router], "state_folder": tmp_path, "state_every": 0.2}
    )
    site = load_site(site_file)
    with Bus([zenoh_router]) as bus, Bus([zenoh_router]) as own:
        service = FusionService(settings, site, own, Health())
        service.running.tracker = Slow(AreaView.of(site, "hall"))
        running = threading.Thread(target=service.run)
        running.start()
        try:
            assert service.health.ready.wait(DEADLINE)
            stage = Stage(bus)
            stage.until_tracked()
            assert encoding.wait(DEADLINE)
            asking = threading.Thread(target=lambda: list(bus.ask(KEYS.fusion_state("hall"), timeout=DEADLINE)))
            asking.start()
            for _ in range(3):  # neither what is being saved nor what is being answered is waited for
                stage.until_tracked(beyond=len(stage.tracks()))
            go_on.set()
            asking.join(DEADLINE)
        finally:
            go_on.set()
            service.stop()
            running.join(DEADLINE)
        assert not running.is_alive()
        assert json.loads((tmp_path / "fusion-hall.json").read_bytes())["chunk"] == stage.tracks()[-1].chunk


def test_ids_survive_a_restart(zenoh_router: str, start: Start, tmp_path: Path) -> None:
    flags = ("--area", "hall", "--state-folder", str(tmp_path / "state"))
    process, _ = start(zenoh_router, *flags)
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        before = stage.until_tracked()
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=5) == 0
        start(zenoh_router, *flags)
        after = stage.until_tracked(beyond=len(stage.tracks()))
        assert after.track == before.track


def test_ids_and_names_survive_a_kill(zenoh_router: str, start: Start, tmp_path: Path) -> None:
    state = tmp_path / "fusion-hall.json"
    flags = ("--area", "hall", "--state-folder", str(tmp_path), "--state-every", "0.2")
    process, _ = start(zenoh_router, *flags)
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        before = wait_until(lambda: named(stage), DEADLINE, "a named person")
        wait_until(lambda: saved_chunk(state) >= before.chunk, DEADLINE, "a saved state that knows the name")
        process.kill()
        process.wait()
        start(zenoh_router, *flags)
        # The first frame told by the new process: its phone has told nothing anew.
        seen = len(stage.tracks())
        after = stage.until_tracked(beyond=seen)
        assert after.chunk > before.chunk
        assert (after.track, after.device) == (before.track, ["phone"])


def test_a_withdrawal_needs_no_camera_and_reaches_a_service_that_was_down(
    zenoh_router: str, start: Start, tmp_path: Path
) -> None:
    state = tmp_path / "fusion-hall.json"
    flags = ("--area", "hall", "--state-folder", str(tmp_path), "--state-every", "0.2")
    process, _ = start(zenoh_router, *flags)
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)

        def known() -> bool:
            stage.play(1)
            return state.is_file() and b'"phone"' in state.read_bytes()

        wait_until(known, DEADLINE, "a state with the device")
        saved = state.read_bytes()
        process.kill()
        process.wait()
        done = bus.inbox()
        done.subscribe(KEYS.erased(), ErasureDone, cached=True)
        erasure = Erasure(t=time.time(), device="phone")
        trace = bus.publisher(KEYS.erasure("phone"), Erasure, cached=True).publish(erasure)
        # Told while fusion was down; it comes back, and no camera speaks.
        process, _ = start(zenoh_router, *flags)
        wait_until(lambda: b'"phone"' not in state.read_bytes(), DEADLINE, "a state without the device")

        def recorded() -> bool:
            return any(isinstance(d.message, ChunkMark) and d.message.consumed == [trace.id] for d in stage.listen())

        wait_until(recorded, DEADLINE, "its mark, for the replay")
        assert acknowledged(done) == [("phone", "fusion-hall")]
        process.kill()
        process.wait()
        state.write_bytes(saved)
        process, _ = start(zenoh_router, *flags[:-1], "3600")
        assert acknowledged(done) == [("phone", "fusion-hall")]
        assert b'"phone"' not in state.read_bytes(), "a state saved at once, though its time is far"
        process.kill()
        process.wait()
        state.unlink()
        start(zenoh_router, *flags)
        assert acknowledged(done) == [("phone", "fusion-hall")], "who knows nobody need not wait for a camera"


def acknowledged(inbox: Inbox) -> list[tuple[str, str]]:
    told = wait_until(lambda: inbox.receive(0.1), DEADLINE, "an erasure to be acknowledged")
    return [(done.message.device, done.message.service) for done in told if isinstance(done.message, ErasureDone)]


def named(stage: Stage) -> TrackFrame | None:
    stage.play(1)
    frames = stage.tracks()
    return frames[-1] if frames and frames[-1].device == ["phone"] else None


def saved_chunk(file: Path) -> int:
    return int(json.loads(file.read_bytes())["chunk"]) if file.is_file() else -1


def test_a_damaged_state_file_is_left_aside(zenoh_router: str, start: Start, tmp_path: Path) -> None:
    (tmp_path / "fusion-hall.json").write_text('{"chunk": 5, "tracker": "evidence", "state": {}}')
    process, _ = start(zenoh_router, "--area", "hall", "--state-folder", str(tmp_path))
    with Bus([zenoh_router]) as bus:
        Stage(bus).until_tracked()
    assert process.poll() is None


def test_a_router_that_dies_and_comes_back_costs_a_gap_and_nothing_else(start: Start) -> None:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    session = router(endpoint)
    process, port = start(endpoint, "--area", "hall")
    with Bus([endpoint]) as bus:
        stage = Stage(bus)
        before = stage.until_tracked()
        session.close()
        wait_until(lambda: get(port, "/readyz")[0] == 503, DEADLINE, "fusion to notice")
        session = router(endpoint)
        wait_until(lambda: get(port, "/readyz")[0] == 200 and bus.connected, DEADLINE, "the reconnection")
        after = stage.until_tracked(beyond=len(stage.tracks()))
        assert process.poll() is None
        assert after.track == before.track
        session.close()


def test_a_silent_camera_is_told_in_plain_words_and_well_again_when_it_speaks(zenoh_router: str, start: Start) -> None:
    _, port = start(zenoh_router, "--area", "hall", "--silent-after", "0.5")
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        wait_until(lambda: "no frames from camera west for" in get(port, "/readyz")[1], DEADLINE, "the complaint")

        def recovered() -> bool:
            stage.play(1)
            return "no frames" not in get(port, "/readyz")[1]

        wait_until(recovered, DEADLINE, "the recovery")


def test_a_candidate_model_is_scored_on_the_last_minutes(zenoh_router: str, start: Start, site_file: Path) -> None:
    _, port = start(zenoh_router, "--area", "hall")
    with Bus([zenoh_router]) as bus:

        def asked(question: bytes, timeout: float = DEADLINE) -> dict[str, Any]:
            ((_, answer),) = bus.ask(KEYS.rescore("hall"), timeout, question)
            told: dict[str, Any] = json.loads(answer)
            return told

        assert "20 or more" in asked(b"")["error"]
        assert asked(b'{"kind": "radio", "access_points": {"ap-1": {"power_1m": 9}}}')["error"] == (
            "access_points.ap-1.power_1m: found 9; allowed: -110 … 0"
        )
        stage = Stage(bus)
        stage.play_world(World(load_site(site_file), seed=5, seconds=36.0, rate=3.0, people=2))
        spoilt = {name: {"power_1m": -90 if index % 2 else -10} for index, name in enumerate(POINTS)}
        question = json.dumps({"kind": "radio", "access_points": spoilt}).encode()
        answers: list[dict[str, Any]] = []
        asking = [threading.Thread(target=lambda: answers.append(asked(question))) for _ in range(2)]
        for thread in asking:
            thread.start()
        heard = len(stage.tracks())
        stage.play(5)  # fusion goes on meanwhile
        assert len(stage.tracks()) > heard
        for thread in asking:
            thread.join(2 * DEADLINE)
        busy, told = sorted(answers, key=len)
        assert busy == {"error": "busy: another candidate is being tried; ask again later"}
        assert told["error"] is None
        assert told["devices"].keys() == {"0", "1"}
        assert told["active_named"] > 0.2
        assert told["gain"] == pytest.approx(told["candidate"] - told["active"])
        assert told["gain"] != 0.0
        assert get(port, "/healthz")[0] == 200


def test_a_trained_radio_model_is_what_the_tracker_sees(site_file: Path, tmp_path: Path, zenoh_router: str) -> None:
    site = load_site(site_file)
    untrained = AreaView.of(site, "hall")
    radio = dataclasses.replace(untrained.radio, power_1m=untrained.radio.power_1m - 5.0)
    grid = np.ones((len(POINTS), 2, 2))
    shadowing = ShadowingMap(radio.names, np.zeros(2), 1.0, grid, grid)
    file = tmp_path / "radio.json"
    write_radio_model(RadioModel("test-hall", radio, shadowing), file)
    settings = FusionSettings.model_validate({"site_file": site_file, "area": "hall", "radio_model": file})
    FusionService.check(settings, site)
    with Bus([zenoh_router]) as own:
        view = FusionService(settings, site, own, Health()).view
    assert view.radio.power_1m.tolist() == radio.power_1m.tolist()
    assert view.shadowing is not None
    assert view.shadowing.mean.tolist() == grid.tolist()
    gallery = FusionSettings.model_validate({"site_file": site_file, "area": "gallery", "radio_model": file})
    with pytest.raises(SettingsError, match=r"radio_model: .*other access points than the site's: lacks upstairs"):
        FusionService.check(gallery, site)


def learned(version: int, site: str = "test-hall", power: float = 1.0) -> RadioModelUpdate:
    radio = radio_model()
    radio = dataclasses.replace(radio, power_1m=radio.power_1m + power)
    flat = np.zeros((len(POINTS), 2, 2))
    model = RadioModel(site, radio, ShadowingMap(radio.names, np.zeros(2), 10.0, flat, flat + 4.0))
    return RadioModelUpdate(t=time.time(), area="hall", version=version, model=pack_radio_model(model))


def test_a_learned_radio_model_goes_live_and_survives_a_kill_without_learning(
    zenoh_router: str, start: Start, tmp_path: Path
) -> None:
    state = tmp_path / "fusion-hall.json"
    flags = ("--area", "hall", "--state-folder", str(tmp_path), "--state-every", "0.2")
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        with Bus([zenoh_router]) as learning:
            models = learning.publisher(KEYS.radio_model("hall"), RadioModelUpdate, cached=True)
            models.publish(learned(7))
            process, port = start(zenoh_router, *flags)  # what was told before it began is fetched

            def uses(version: int) -> bool:
                stage.play(1)
                return metric(port, "atrium_fusion_radio_version") == version

            wait_until(lambda: uses(7), DEADLINE, "the model told before")
            before = wait_until(lambda: named(stage), DEADLINE, "a named person")
            trace = models.publish(learned(8, power=-2.0))
            wait_until(lambda: uses(8), DEADLINE, "the model told live")
            after = named(stage)
            assert after is not None
            assert (after.track, after.device) == (before.track, ["phone"])
            marks = [d.message for d in stage.listen() if isinstance(d.message, ChunkMark)]
            assert sum(trace.id in mark.consumed for mark in marks) == 1
            wait_until(lambda: saved_chunk(state) >= after.chunk, DEADLINE, "a saved state under the new model")
            models.publish(learned(6))  # an older one: counted, not used
            wait_until(lambda: 'older than the one in use"} 1' in get(port, "/metrics")[1], DEADLINE, "its count")
            assert uses(8)
        process.kill()
        process.wait()
        (beside,) = tmp_path.glob("*.radio")
        assert json.loads(state.read_bytes())["radio"].startswith(beside.stem.rpartition(".")[2])
        assert json.loads(state.read_bytes())["model"] is None
        _, port = start(zenoh_router, *flags)
        assert metric(port, "atrium_fusion_radio_version") == 8
        again = stage.until_tracked(beyond=len(stage.tracks()))
        assert (again.track, again.device) == (before.track, ["phone"])
        ((_, answered),) = bus.ask(KEYS.fusion_state("hall"))
        assert json.loads(answered)["model"]["version"] == 8  # whole: a recorder's copy needs no other file


def test_a_model_of_another_museum_is_refused_in_plain_words_and_a_question_of_megabytes_read(
    zenoh_router: str, start: Start
) -> None:
    _, port = start(zenoh_router, "--area", "hall")
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        bus.publisher(KEYS.radio_model("hall"), RadioModelUpdate, cached=True).publish(learned(3, site="another"))

        def told() -> bool:
            stage.play(1)
            return "a learned radio model is of another site" in get(port, "/readyz")[1]

        wait_until(told, DEADLINE, "the words")
        assert metric(port, "atrium_fusion_radio_version") == 0
        seen = json.loads(encode(frame(1.0, [(6.0, 7.0)] * 20, camera="north")))
        question = json.dumps({"kind": "detections", "frames": {"north": [seen] * 4000}}).encode()
        assert len(question) > 4_000_000
        ((_, answered),) = bus.ask(KEYS.rescore("hall"), timeout=DEADLINE, payload=question)
        assert json.loads(answered)["error"] == "frames.north: no camera of area hall; allowed: east, west"


def test_revisions_are_published(zenoh_router: str, site_file: Path) -> None:
    class Reviser(AnonymousTracker):
        def revision(self) -> Revision | None:
            t = self.positions.t
            return Revision(t=t, area="hall", chunk=7, tracker=self.name, device=["d"], since=[t - 5.0])

    settings = FusionSettings.model_validate({"site_file": site_file, "area": "hall", "bus": [zenoh_router]})
    site = load_site(site_file)
    with Bus([zenoh_router]) as bus, Bus([zenoh_router]) as own:
        service = FusionService(settings, site, own, Health())
        service.running.tracker = Reviser(AreaView.of(site, "hall"))
        running = threading.Thread(target=service.run)
        running.start()
        try:
            assert service.health.ready.wait(DEADLINE)
            inbox = bus.inbox()
            inbox.subscribe(KEYS.revisions("hall"), Revision)
            stage = Stage(bus)

            def revised() -> list[Delivery[Message]]:
                stage.play(1)
                return inbox.receive(timeout=0.0)

            revision = wait_until(revised, DEADLINE, "a revision")[0].message
            assert isinstance(revision, Revision)
            assert (revision.area, revision.device) == ("hall", ["d"])
        finally:
            service.stop()
            running.join(DEADLINE)


def test_extreme_values_are_survived(zenoh_router: str, start: Start) -> None:
    process, port = start(zenoh_router, "--area", "hall")
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        before = stage.until_tracked()
        west = bus.publisher(KEYS.detections("west"), DetectionFrame)
        radio = bus.publisher(KEYS.radio("wild"), RadioScan)
        motion = bus.publisher(KEYS.motion("wild"), MotionBatch)
        for extreme in (1e308, -1e308, 0.0, 1e-308):
            west.publish(frame(stage.t0, [(extreme, extreme)]))
            west.publish(frame(extreme, [(1.0, 1.0)]))
            west.publish(frame(time.time(), [(extreme, 7.0)], sigma=abs(extreme) ** 0.5, confidence=0.0))
            radio.publish(RadioScan(t=time.time(), device="wild", seq=1, access_point=["ap-1"] * 2, rssi=[extreme] * 2))
            radio.publish(RadioScan(t=extreme, device="wild", seq=2))
            motion.publish(
                MotionBatch(
                    t=extreme,
                    t_start=-extreme,
                    device="wild",
                    seq=1,
                    activity="walking",
                    step_t=[extreme],
                    length=[extreme],
                    length_variance=[-extreme],
                    heading=[extreme],
                    heading_variance=[extreme],
                )
            )
        after = stage.until_tracked(beyond=len(stage.tracks()))
        assert after.chunk > before.chunk
        assert process.poll() is None
        assert metric(port, "atrium_fusion_dropped_total") > 0


def test_what_is_dropped_is_counted_by_reason(zenoh_router: str, start: Start) -> None:
    _, port = start(zenoh_router, "--area", "hall")
    with Bus([zenoh_router]) as bus:
        stage = Stage(bus)
        stage.until_tracked()
        west = bus.publisher(KEYS.detections("west"), DetectionFrame)
        east = bus.publisher(KEYS.detections("east"), DetectionFrame)
        radio = bus.publisher(KEYS.radio("phone"), RadioScan)
        reasons = (
            "time went backwards",
            "detection off the floor or without an extent",
            "radio without a known access point",
            "phone's data marked late",
        )

        def counted() -> bool:
            west.publish(frame(stage.t0 - 3600.0))
            # What a tracker cannot use, on the way in as well: a person off the floor, a stranger's access point.
            number = next(stage._number)
            t = stage.t0 + number / 10
            radio.publish(RadioScan(t=t - 0.05, device="phone", seq=number, access_point=["stranger"], rssi=[-50.0]))
            radio.publish(RadioScan(t=t, device="phone", seq=number, access_point=["ap"], rssi=[-50.0], late=True))
            for name, publisher in (("west", west), ("east", east)):
                publisher.publish(frame(t, [(6.0, 7.0), (999.0, 7.0)], name, number))
            text = get(port, "/metrics")[1]
            return all(f'atrium_fusion_dropped_total{{reason="{reason}"}}' in text for reason in reasons)

        wait_until(counted, DEADLINE, "the count")


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--area", "cellar"), "allowed: hall, gallery"),
        ((), "the site has several areas"),
        (("--area", "hall", "--tracker", "magic"), "allowed: anonymous, evidence"),
        (("--area", "hall", "--radio-model", "/nowhere/radio.json"), "radio_model: /nowhere/radio.json: No such file"),
    ],
)
def test_a_wrong_setting_is_one_clear_message(start: Start, flags: tuple[str, ...], words: str) -> None:
    process, _ = start("tcp/127.0.0.1:1", *flags, wait=False)
    _, error = process.communicate(timeout=DEADLINE)
    assert process.returncode == 2
    assert words in error
    assert "Traceback" not in error
