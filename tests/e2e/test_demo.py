"""The main job as a newcomer meets it: ``atrium demo`` and a browser."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from browser import Button, open_browser
from waiting import wait_until
from zone_drawing import click_plan, open_zones

from services.api.alerts.signature import signed_headers

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
    environment = {
        **os.environ,
        "COLUMNS": "200",
        "PYTHONUNBUFFERED": "1",
        "ATRIUM_WEBHOOK_NETWORKS": '["127.0.0.0/8"]',
    }
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


@contextmanager
def receiver() -> Iterator[tuple[str, list[tuple[dict[str, str], bytes]]]]:
    """Whoever is sent alerts: its URL, and what it has taken."""
    taken: list[tuple[dict[str, str], bytes]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            taken.append(({name.lower(): value for name, value in self.headers.items()}, body))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/alerts", taken
        server.shutdown()


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
    for position in positions:  # whom no camera sees may be believed just outside the door
        spare = 3.0 if position["state"] == "unseen" else 0.3
        assert -spare <= position["x"] <= 20 + spare, position
        assert -spare <= position["y"] <= 12 + spare, position
        assert 0 < position["probability"] <= 1, position
    alerts = wait_until(lambda: demo.api("/v1/alerts")["alerts"], 90, "somebody to enter or leave a zone")
    assert alerts[0]["kind"] in ("enter", "exit")
    assert alerts[0]["zone"] in ("entrance", "model-corner")


def test_whoever_crosses_a_line_that_staff_draw_is_told_to_the_inbox_and_the_webhook(
    demo: RunningDemo, tmp_path: Path
) -> None:
    with receiver() as (url, taken), open_browser(tmp_path) as browser:
        made = httpx.post(
            f"{demo.urls['API']}/v1/webhooks", json={"url": url, "name": "Guard", "kinds": ["cross"]}, headers=KEY
        )
        assert made.is_success, made.text
        open_zones(demo.urls["live map"], browser)
        Button(browser, "New line").click()
        click_plan(browser, (10.0, 1.0), (10.0, 11.0))
        browser.switch_to.active_element.send_keys("Half way")
        Button(browser, "Save").click()
        wait_until(
            lambda: [z for z in demo.api("/v1/zones")["zones"] if z["id"] == "half-way"], 10, "the line at the API"
        )
        headers, body = wait_until(lambda: taken and taken[0], 90, "the webhook")
        alert = json.loads(body)["alert"]
        assert (alert["zone"], alert["kind"]) == ("half-way", "cross")
        assert abs(alert["x"] - 10.0) < 0.5
        assert alert["direction"] in ("forward", "backward")
        again = signed_headers(made.json()["secret"], headers["webhook-id"], int(headers["webhook-timestamp"]), body)
        assert headers["webhook-signature"] == again["webhook-signature"]
        assert alert["id"] in {one["id"] for one in demo.api("/v1/alerts?zone=half-way")["alerts"]}
        browser.get(f"{demo.urls['live map']}/alerts")
        wait_until(lambda: "Half way" in browser.find_element("tag name", "main").text, 20, "the alert in the inbox")
        browser.save_screenshot(str(tmp_path / "inbox.png"))


def test_what_happened_can_be_asked_for(demo: RunningDemo) -> None:
    def walked() -> list[dict]:
        device = demo.api("/v1/positions")["positions"][0]["device"]
        path = f"/v1/trajectories/{device}?since={time.time() - 300.0}&until={time.time()}"
        return demo.api(path)["t"]

    assert len(wait_until(walked, 90, "the path of a phone")) > 1


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
