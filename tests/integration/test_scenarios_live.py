"""A scenario through the whole system: its faults arrive, and somebody is recognised all the same."""

import time
from collections import defaultdict
from pathlib import Path

import httpx
import numpy as np
import pytest
from conftest import unused_port
from service_process import process
from waiting import wait_until

from shared.bus import Bus, Delivery
from shared.keys import Keys
from shared.messages import CameraStatus, DetectionFrame, MotionBatch, RadioScan, TrackFrame
from shared.truth import GroundTruth, truth_key

pytestmark = pytest.mark.alone

SITE = """
format: atrium-site/1
site: workshop
floors:
  - id: ground
    outline: [[0, 0], [14, 0], [14, 9], [0, 9]]
    obstacles: [{id: bench, polygon: [[6, 4], [8, 4], [8, 5], [6, 5]]}]
  - {id: attic, level: 1, outline: [[0, 0], [14, 0], [14, 9], [0, 9]]}
areas: [{id: shop, floor: ground}, {id: store, floor: attic}]
cameras:
  - id: west
    area: shop
    source: {device: 0}
    geometry: {kind: pose, image_size: [960, 720], position: [4, -2, 8], look_at: [4, 4.5, 0], horizontal_fov: 80}
  - id: east
    area: shop
    source: {device: 1}
    geometry: {kind: pose, image_size: [960, 720], position: [10, 11, 8], look_at: [10, 4.5, 0], horizontal_fov: 80}
access_points:
  - {id: ap-1, floor: ground, position: [0.3, 0.3, 2.6], addresses: ["02:a7:0a:00:00:01"]}
  - {id: ap-2, floor: ground, position: [13.7, 0.3, 2.6], addresses: ["02:a7:0a:00:00:02"]}
  - {id: ap-3, floor: ground, position: [13.7, 8.7, 2.6], addresses: ["02:a7:0a:00:00:03"]}
  - {id: ap-4, floor: ground, position: [0.3, 8.7, 2.6], addresses: ["02:a7:0a:00:00:04"]}
  - {id: ap-5, floor: ground, position: [7.0, 0.3, 2.6], addresses: ["02:a7:0a:00:00:05"]}
  - {id: ap-6, floor: ground, position: [7.0, 8.7, 2.6], addresses: ["02:a7:0a:00:00:06"]}
"""
SCENARIO = """
format: atrium-scenario/1
scenario: workshop
site: site.yaml
seeds: {train: 3, test: 4}
people:
  kind: walkers
  walkers:
    pool: 4
    present: [4, 4]
    dwell: [1, 3]
    speed: [0.8, 1.3]
    groups: 0
    doors: [{id: gate, floor: ground, position: [0, 7]}]
views: [{level: detections, frames_per_s: 10}]
phones: [{name: worker, count: 3, inertial_rate: 50}]
faults:
  - {kind: frames-late, camera: east, share: 0.2, delay: [0.2, 0.5]}
  - {kind: duplicate-batches, phone: 0, share: 0.5}
  - {kind: phone-gone, phone: 1, start: 4, end: 10}
"""


def test_a_scenario_with_faults_runs_through_the_whole_system(zenoh_router: str, tmp_path: Path) -> None:
    site_file = tmp_path / "site.yaml"
    site_file.write_text(SITE)
    (tmp_path / "scenario.yaml").write_text(SCENARIO)
    keys, port = Keys("workshop"), unused_port()
    gateway = {"ATRIUM_GATEWAY_PORT": str(port)}
    simulator = {"ATRIUM_GATEWAY_URL": f"http://127.0.0.1:{port}"}
    with Bus([zenoh_router]) as bus:
        inbox = bus.inbox()
        for key, kind in (
            (keys.detections(), DetectionFrame),
            (keys.camera_status(), CameraStatus),
            (keys.radio(), RadioScan),
            (keys.motion(), MotionBatch),
            (keys.tracks(), TrackFrame),
            (truth_key(keys), GroundTruth),
        ):
            inbox.subscribe(key, kind)
        with (
            process("services.gateway", tmp_path, zenoh_router, site_file, **gateway),
            process("services.fusion", tmp_path, zenoh_router, site_file, ATRIUM_AREA="shop"),
            process("services.fusion", tmp_path, zenoh_router, site_file, ATRIUM_AREA="store") as attic,
            process("services.simulator", tmp_path, zenoh_router, site_file, **simulator) as health,
        ):
            heard: defaultdict[type, list[Delivery]] = defaultdict(list)
            began = time.time()

            def named() -> set[str]:
                for delivery in inbox.receive(timeout=0.05):
                    heard[type(delivery.message)].append(delivery)
                carried = {device for d in heard[GroundTruth] for device in d.message.device if device}
                recognised = {device for d in heard[TrackFrame] for device in d.message.device if device}
                return carried & recognised if time.time() > began + 18.0 else set()  # all faults are over

            wait_until(named, 35, "somebody whose phone is recognised")
            metrics = httpx.get(health + "/metrics").text
            assert "nobody is tracked" in httpx.get(attic + "/healthz").json()["problems"]["cameras"]
            assert len(bus.present(keys.alive("camera"))) == 2

        frames = [delivery.message for delivery in heard[DetectionFrame]]
        by_camera = {camera: [f.t for f in frames if f.camera == camera] for camera in ("west", "east")}
        assert all(len(times) > 100 for times in by_camera.values())
        assert (np.diff(by_camera["west"]) > 0.0).all()
        late = (np.diff(by_camera["east"]) < 0.0).mean()
        assert 0.05 < late < 0.4
        assert any(f.x for f in frames)
        states = {d.message.camera: d.message for d in heard[CameraStatus]}
        assert states.keys() == {"west", "east"}
        assert states["west"].state == "ok"
        assert 8.0 < states["west"].frames_per_s < 12.0

        # Told twice by the phone, told once by the gateway.
        told = [(d.message.device, d.message.seq, d.message.t) for d in heard[MotionBatch]]
        assert len(set(told)) == len(told)
        assert 'atrium_simulator_batches_total{result="refused"}' not in metrics
        silences = {}
        for device in {d.message.device for d in heard[RadioScan]}:
            times = sorted(d.message.t for d in heard[RadioScan] if d.message.device == device)
            silences[device] = float(np.diff(times).max())
        assert len(silences) == 3
        assert sorted(silences.values())[2] > 5.0  # the one that was gone for six seconds
        assert sorted(silences.values())[1] < 4.0

        # Tracks are where people really are.
        truth = {round(d.message.t, 1): np.column_stack([d.message.x, d.message.y]) for d in heard[GroundTruth]}
        apart = [
            np.hypot(*(truth[round(d.message.t, 1)] - (x, y)).T).min()
            for d in heard[TrackFrame][50:]
            if round(d.message.t, 1) in truth
            for x, y in zip(d.message.x, d.message.y, strict=True)
        ]
        assert len(apart) > 100
        assert np.median(apart) < 0.5
        assert all(d.message.area == "shop" for d in heard[TrackFrame])
