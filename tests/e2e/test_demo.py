"""The main job as a newcomer meets it: ``atrium demo`` and a browser."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from browser import open_browser
from waiting import wait_until

pytestmark = pytest.mark.alone

KEY = {"Authorization": "Bearer demo-api-key"}


@dataclass
class RunningDemo:
    process: subprocess.Popen[str]
    folder: Path
    urls: dict[str, str]

    def api(self, path: str) -> dict:
        return httpx.get(self.urls["API"] + path, headers=KEY, timeout=5).raise_for_status().json()


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningDemo]:
    folder = tmp_path_factory.mktemp("demo")
    command = [sys.executable, "-m", "services.cli", "demo", "--site", "hall", "--free-ports", "--record", "hall.mcap"]
    environment = {**os.environ, "COLUMNS": "200", "PYTHONUNBUFFERED": "1"}
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    output: list[str] = []
    urls: dict[str, str] = {}
    for line in process.stdout:
        output.append(line)
        if found := re.search(r"(live map|API|phones post)\s+(http://[\d.:]+)", line):
            urls[found[1]] = found[2]
        if "Ctrl-C" in line:
            break
    if len(urls) < 3:
        process.kill()
        pytest.fail("the demo did not start:\n" + "".join(output))
    yield RunningDemo(process, folder, urls)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def test_people_move_on_the_map_in_a_real_browser(demo: RunningDemo, tmp_path: Path) -> None:
    with open_browser(tmp_path) as browser:
        browser.get(demo.urls["live map"])

        def drawn() -> dict[int, tuple[float, float]]:
            state = browser.execute_script("return window.atrium ? JSON.stringify(window.atrium.tracks()) : '[]'")
            return {track["track"]: (track["x"], track["y"]) for track in json.loads(state)}

        first = wait_until(lambda: len(seen := drawn()) >= 3 and seen, 60, "three people on the map")

        def moved() -> bool:
            now = drawn()
            return any(track in now and now[track] != place for track, place in first.items())

        wait_until(moved, 20, "somebody to move")
        browser.save_screenshot(str(tmp_path / "map.png"))
        assert (tmp_path / "map.png").stat().st_size > 20_000
        errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        assert not errors, errors


def test_phones_get_located_and_zones_tell(demo: RunningDemo) -> None:
    def located() -> list[dict]:
        return [position for position in demo.api("/v1/positions")["positions"] if position["age"] < 2.0]

    positions = wait_until(located, 90, "a phone to be located")
    assert all(0 <= p["x"] <= 20 and 0 <= p["y"] <= 12 and 0 < p["probability"] <= 1 for p in positions)
    alerts = wait_until(lambda: demo.api("/v1/alerts")["alerts"], 90, "somebody to enter or leave a zone")
    assert alerts[0]["kind"] in ("enter", "exit")
    assert alerts[0]["zone"] in ("entrance", "model-corner")


def test_a_phone_enrols_posts_and_reads_only_its_own_position(demo: RunningDemo) -> None:
    gateway = demo.urls["phones post"]
    body = {"enrolment_key": "demo-enrolment-key", "consent": True}
    mine = httpx.post(f"{gateway}/v1/devices", json=body).raise_for_status().json()
    token = {"Authorization": f"Bearer {mine['token']}"}
    answer = httpx.get(f"{gateway}/v1/devices/{mine['device']}/position", headers=token)
    assert answer.status_code == 404
    assert "not located" in answer.text
    for position in demo.api("/v1/positions")["positions"]:
        assert httpx.get(f"{gateway}/v1/devices/{position['device']}/position", headers=token).status_code == 403


def test_a_phone_that_barely_spoke_is_nobody_and_can_leave(demo: RunningDemo) -> None:
    gateway = demo.urls["phones post"]
    body = {"enrolment_key": "demo-enrolment-key", "consent": True}
    mine = httpx.post(f"{gateway}/v1/devices", json=body).raise_for_status().json()
    token = {"Authorization": f"Bearer {mine['token']}"}
    now = time.time()
    reading = {"t": now, "address": ["02:a7:00:00:00:01", "02:a7:00:00:00:02"], "rssi": [-35, -75]}
    batch = {"seq": 0, "sent": now, "radio": [reading]}
    answer = httpx.post(f"{gateway}/v1/devices/{mine['device']}/batches", json=batch, headers=token)
    assert answer.status_code == 200, answer.text
    seen = [p for p in demo.api("/v1/positions")["positions"] if p["device"] == mine["device"]]
    assert not seen
    assert httpx.delete(f"{gateway}/v1/devices/{mine['device']}", headers=token).status_code == 204


def test_ctrl_c_stops_everything_and_the_recording_replays_to_the_same_bytes(demo: RunningDemo) -> None:
    demo.process.send_signal(signal.SIGINT)
    rest, _ = demo.process.communicate(timeout=30)
    assert demo.process.returncode == 0, rest
    assert "all services stopped" in rest
    for url in demo.urls.values():
        with pytest.raises(httpx.TransportError):
            httpx.get(url, timeout=1)
    recording = demo.folder / "hall.mcap"
    verified = subprocess.run(
        [sys.executable, "-m", "services.cli", "replay", "--verify", str(recording)], capture_output=True, text=True
    )
    assert verified.returncode == 0, verified.stdout + verified.stderr
    assert "identical to the byte" in verified.stdout
