"""The simulator as a process beside the real gateway: phones arrive on the bus, truth tells who carries what."""

import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from conftest import unused_port
from service_process import process
from waiting import wait_until

from shared.bus import Bus, Inbox
from shared.keys import Keys
from shared.messages import CameraStatus, MotionBatch, RadioScan
from shared.site import load_site
from shared.truth import GroundTruth, truth_key

pytestmark = pytest.mark.alone

FOLLOWING_A_CLIP = """
format: atrium-scenario/1
scenario: clip
site: {site}
seeds: {{train: 1, test: 2}}
people: {{kind: recorded, file: {table}, camera: hall-east}}
phones: [{{count: 1}}]
"""


def collect(inbox: Inbox, into: list[object]) -> list[object]:
    into += [delivery.message for delivery in inbox.receive(timeout=0.05)]
    return into


def test_visitors_are_seen_heard_and_known_to_the_truth(zenoh_router: str, tmp_path: Path, project: Path) -> None:
    site_file = project / "deploy/sites/hall/site.yaml"
    site, keys = load_site(site_file), Keys("hall")
    gateway_port, video_port = unused_port(), unused_port()
    simulator = {
        "ATRIUM_GATEWAY_URL": f"http://127.0.0.1:{gateway_port}",
        "ATRIUM_VIDEO_PORT": str(video_port),
    }
    with Bus([zenoh_router]) as bus:
        inbox = bus.inbox()
        for key, kind in ((truth_key(keys), GroundTruth), (keys.radio(), RadioScan), (keys.motion(), MotionBatch)):
            inbox.subscribe(key, kind)
        with (
            process("services.gateway", tmp_path, zenoh_router, site_file, ATRIUM_GATEWAY_PORT=str(gateway_port)),
            process("services.simulator", tmp_path, zenoh_router, site_file, **simulator) as health,
        ):
            messages: list[object] = []
            known = {point.id for point in site.access_points}

            def enough() -> bool:
                collect(inbox, messages)
                carried = {d for m in messages if isinstance(m, GroundTruth) for d in m.device if d}
                scanning = {m.device for m in messages if isinstance(m, RadioScan)}
                walking = {m.device for m in messages if isinstance(m, MotionBatch) and m.step_t}
                return len(carried & scanning & walking) >= 2

            wait_until(enough, 45, "two visitors with phones that scan and step")
            scans = [m for m in messages if isinstance(m, RadioScan)]
            assert {name for scan in scans for name in scan.access_point} <= known
            # Clocks that are a day wrong have been aligned: scans carry the true time.
            assert np.median([abs(time.time() - scan.t) for scan in scans[-6:]]) < 3.0
            truth = [m for m in messages if isinstance(m, GroundTruth)]
            places = np.array([xy for m in truth for xy in zip(m.x, m.y, strict=True)])
            assert site.floor("ground").plan().walkable(places).all()
            assert np.allclose(np.diff([m.t for m in truth]), 0.1, atol=1e-3)

            capture = cv2.VideoCapture(f"http://127.0.0.1:{video_port}/cameras/hall-east.mjpeg")
            try:
                good, picture = capture.read()
                assert good
                assert picture.shape == (720, 960, 3)
            finally:
                capture.release()
            metrics = httpx.get(health + "/metrics").text
            assert 'atrium_simulator_batches_total{result="accepted"}' in metrics
            assert 'atrium_simulator_batches_total{result="refused"}' not in metrics


def test_phones_and_truth_follow_the_clip_of_a_camera_and_start_again_with_it(
    zenoh_router: str, tmp_path: Path, project: Path
) -> None:
    site_file = project / "deploy/sites/hall/site.yaml"
    table = tmp_path / "walk.csv"
    rows = [f"{t:.2f},{person},{3 + 0.5 * t + person:.3f},2.0" for t in np.arange(0.0, 8.0, 0.2) for person in (1, 2)]
    table.write_text("t,id,x,y\n" + "\n".join(rows) + "\n")
    keys = Keys("hall")
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(FOLLOWING_A_CLIP.format(site=site_file, table=table))
    simulator = {
        "ATRIUM_SCENARIO": str(scenario),
        "ATRIUM_GATEWAY_URL": f"http://127.0.0.1:{unused_port()}",
    }
    with Bus([zenoh_router]) as bus:
        inbox = bus.inbox()
        inbox.subscribe(truth_key(keys), GroundTruth)
        camera = bus.publisher(keys.camera_status("hall-east"), CameraStatus, cached=True)
        with process("services.simulator", tmp_path, zenoh_router, site_file, **simulator) as health:
            assert "hall-east" in httpx.get(health + "/readyz").json()["problems"]["clip"]
            messages: list[object] = []
            for _ in range(2):
                messages.clear()
                origin = time.time()
                camera.publish(CameraStatus(t=origin, camera="hall-east", state="ok", origin=origin))
                wait_until(lambda: len(collect(inbox, messages)) >= 8, 15, "the truth of this pass")
                pass_ = [m for m in messages if isinstance(m, GroundTruth) and m.t >= origin]
                elapsed = np.array([m.t for m in pass_]) - origin
                np.testing.assert_allclose(elapsed, 0.2 * np.arange(len(pass_)), atol=1e-3)
                assert pass_[0].person == ["1", "2"]
                np.testing.assert_allclose(pass_[3].x, [4.3, 5.3], atol=1e-6)


def test_a_missing_trajectory_file_ends_the_process_with_one_line(tmp_path: Path, project: Path) -> None:
    site_file = project / "deploy/sites/hall/site.yaml"
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(FOLLOWING_A_CLIP.format(site=site_file, table=tmp_path / "none.csv"))
    ended = subprocess.run(
        [sys.executable, "-m", "services.simulator", "--site-file", str(site_file), "--profile", "demo"],
        env={**os.environ, "ATRIUM_SCENARIO": str(scenario)},
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "none.csv: cannot be read" in ended.stderr


def test_pets_people_with_phones_are_the_six_longest_in_view(project: Path, data_folder: Path) -> None:
    from services.simulator.crowd.trajectories import Trajectories

    people = Trajectories.from_mot(data_folder / "pets09-s2l1" / "gt" / "gt.txt", "ground")
    assert people.longest_present(6) == ["1", "9", "13", "11", "12", "2"]
