"""The live map as an operator sees it: real router, real api and dashboard processes, a real browser."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import yaml
from browser import open_browser
from conftest import unused_port
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys as Key
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.select import Select
from waiting import wait_until
from walking_people import DEVICES, UNSEEN, walking

from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Alert, CameraStatus

pytestmark = pytest.mark.paced

API_KEY = "demo-api-key"
PASSWORD = "a password for the test"


@dataclass
class System:
    """Everything that runs, and the bus to speak on."""

    dashboard: str
    password_dashboard: str
    api_url: str
    bus: Bus
    keys: Keys
    start_api: Callable[[], subprocess.Popen[bytes]]
    start_dashboard: Callable[[], subprocess.Popen[bytes]]
    api: subprocess.Popen[bytes]
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)


@pytest.fixture(scope="module")
def system(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp("dashboard")
    site_file = folder / "site.yaml"
    site_file.write_text(yaml.safe_dump(_two_floors(project), allow_unicode=True))
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    api_port, port, password_port = unused_port(), unused_port(), unused_port()
    common = {"ATRIUM_SITE_FILE": str(site_file), "ATRIUM_PROFILE": "demo", "ATRIUM_BUS": json.dumps([endpoint])}

    def start(module: str, **settings: str) -> subprocess.Popen[bytes]:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")}
        environment.pop("PYTEST_CURRENT_TEST", None)  # NiceGUI behaves differently under it
        log = (folder / f"{module}-{settings.get('ATRIUM_DASHBOARD_PORT', '')}.log").open("ab")
        command = [sys.executable, "-m", f"services.{module}"]
        return subprocess.Popen(command, env={**environment, **common, **settings}, stdout=log, stderr=log, cwd=folder)

    def start_api() -> subprocess.Popen[bytes]:
        return start("api", ATRIUM_API_PORT=str(api_port))

    def start_dashboard(listen: int, password: str) -> subprocess.Popen[bytes]:
        return start(
            "dashboard",
            ATRIUM_DASHBOARD_PORT=str(listen),
            ATRIUM_API_URL=f"http://127.0.0.1:{api_port}",
            ATRIUM_DASHBOARD_PASSWORD=password,
        )

    session = router(endpoint)
    with Bus([endpoint]) as bus:
        running = System(
            dashboard=f"http://127.0.0.1:{port}",
            password_dashboard=f"http://127.0.0.1:{password_port}",
            api_url=f"http://127.0.0.1:{api_port}",
            bus=bus,
            keys=Keys("hall"),
            start_api=start_api,
            start_dashboard=lambda: start_dashboard(port, ""),
            api=start_api(),
            processes={"dashboard": start_dashboard(port, ""), "locked": start_dashboard(password_port, PASSWORD)},
        )
        with walking(bus, running.keys):
            for address in (running.dashboard, running.password_dashboard):
                wait_until(lambda url=address: _answers(url + "/login"), 30, f"the dashboard at {address}")
            yield running
        for process in (running.api, *running.processes.values()):
            if process.poll() is None:
                process.terminate()
                process.wait(10)
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="module")
def page(system: System, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with open_browser(tmp_path_factory.mktemp("browser")) as browser:
        browser.get(system.dashboard)
        wait_until(lambda: len(_tracks(browser)) >= len(DEVICES), 30, "people on the map")
        yield browser


def test_people_move_on_the_map_and_nothing_comes_from_elsewhere(page: WebDriver, tmp_path: Path) -> None:
    first = _tracks(page)
    wait_until(lambda: _walked(first, _tracks(page)) > 0.5, 15, "people to walk half a metre")
    frames = page.execute_script("return atrium.frames")
    wait_until(lambda: page.execute_script("return atrium.frames") >= frames + 20, 15, "twenty more frames")
    page.save_screenshot(str(tmp_path / "map.png"))
    errors = [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"]
    assert errors == []
    assert _hosts(page) == {"127.0.0.1"}


def test_whom_no_camera_sees_is_drawn_as_a_guess_and_counted_as_no_second_person(
    page: WebDriver, tmp_path: Path
) -> None:
    (guess,) = [person for person in _tracks(page).values() if person["state"] == "unseen"]
    assert guess["device"] == UNSEEN
    assert guess["accuracy"] == pytest.approx(0.949, abs=0.01)
    status = page.find_element(By.ID, "atrium-status")
    wait_until(lambda: "6 people, 2 with a located phone, 1 phone out of view" in status.text, 10, "the count")
    phones = page.find_element(By.ID, "phones")
    wait_until(lambda: "out of view, within 2 m" in phones.text, 10, "the words")
    page.save_screenshot(str(tmp_path / "unseen.png"))


def test_identities_have_colours_that_stay(page: WebDriver) -> None:
    def looks() -> dict[str | None, list[str]]:
        return {device: page.execute_script("return atrium.lookOf(arguments[0])", device) for device in DEVICES}

    before = looks()
    assert len(set(map(str, before.values()))) == 4  # three devices, and everybody else: grey and round
    assert before[None][1] is None

    # What is painted is what is said: the pixel in the middle of each dot has the colour of its identity.
    def painted() -> bool:
        seen = page.execute_script(_READ_DOTS)
        return bool(seen) and all(_near(pixel, before[device][0]) for device, pixel in seen)

    wait_until(painted, 10, "every dot in its colour")
    page.refresh()
    wait_until(lambda: len(_tracks(page)) >= len(DEVICES), 30, "people on the map again")
    assert looks() == before


def test_alerts_phones_and_cameras_are_told_in_words(system: System, page: WebDriver, tmp_path: Path) -> None:
    alerts = system.bus.publisher(system.keys.alert("entrance"), Alert, cached=True, history=10)
    for kind, device in (("enter", DEVICES[0]), ("exit", None)):
        alerts.publish(
            Alert(
                t=time.time(),
                id=f"a-{kind}",
                zone="entrance",
                kind=kind,  # type: ignore[arg-type]
                area="hall",
                track=1,
                floor="ground",
                x=9.0,
                y=1.0,
                device=device,
            )
        )
    status = system.bus.publisher(system.keys.camera_status("hall-east"), CameraStatus, cached=True)
    status.publish(
        CameraStatus(t=time.time(), camera="hall-east", state="degraded", reason="no picture for 8 s, trying again")
    )
    rows = wait_until(lambda: len(found := _rows(page, "alerts")) >= 2 and found, 15, "two alerts")
    assert "Somebody left Entrance" in rows[0]
    assert "Phone 1b07 entered Entrance" in rows[1]
    wait_until(lambda: "No picture for 8 s" in " ".join(_rows(page, "cameras")), 15, "the camera's reason")
    phones = wait_until(lambda: len(found := _rows(page, "phones")) == 3 and found, 15, "three phones")
    assert "1b07" in " ".join(phones)
    page.save_screenshot(str(tmp_path / "lists.png"))


def test_another_floor_can_be_chosen(page: WebDriver, tmp_path: Path) -> None:
    select = Select(page.find_element(By.ID, "atrium-floor"))
    assert [option.text for option in select.options] == ["Gallery", "Ground floor"]
    select.select_by_visible_text("Gallery")
    wait_until(lambda: page.execute_script("return atrium.floor") == "gallery", 20, "the other floor")
    canvas = page.find_element(By.ID, "atrium-canvas")
    wait_until(lambda: "Gallery with 1 person" in str(canvas.get_attribute("aria-label")), 20, "its people")
    page.save_screenshot(str(tmp_path / "gallery.png"))
    select.select_by_visible_text("Ground floor")


def test_the_map_is_moved_by_keyboard_and_buttons(page: WebDriver) -> None:
    def scale() -> float:
        return float(page.execute_script("return atrium.scale"))

    canvas = page.find_element(By.ID, "atrium-canvas")
    page.find_element(By.ID, "zoom-fit").click()
    whole = scale()
    canvas.send_keys("+")
    assert scale() == pytest.approx(1.25 * whole)
    place = page.execute_script("return atrium.toScreen(10, 6)")
    canvas.send_keys(Key.ARROW_LEFT)
    assert page.execute_script("return atrium.toScreen(10, 6)")[0] == pytest.approx(place[0] + 60)
    page.find_element(By.ID, "zoom-out").click()
    canvas.send_keys("0")
    assert scale() == pytest.approx(whole)


def test_staff_are_let_in_and_out_and_keys_issued_on_the_administration_page(
    system: System, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    with open_browser(tmp_path_factory.mktemp("office")) as browser:
        browser.get(f"{system.dashboard}/administration")

        def text(name: str) -> str:
            return str(browser.execute_script("return document.getElementById(arguments[0])?.innerText ?? ''", name))

        def fill(part: str, *values: str) -> None:
            form, fields = (
                browser.find_element(By.CSS_SELECTOR, f"#{part}-part form"),
                "input:not([type=checkbox]), select",
            )
            for field, value in zip(form.find_elements(By.CSS_SELECTOR, fields), values, strict=False):
                field.send_keys(value)
            form.find_element(By.TAG_NAME, "button").click()

        wait_until(lambda: "Nobody of the staff" in text("users-part"), 20, "the page")
        fill("users", "Maria K", "curator", "correct horse battery")
        wait_until(lambda: text("users-said") == "Maria K may sign in.", 10, "the word")
        browser.find_element(By.CSS_SELECTOR, "#keys-part [value=positions]").click()
        fill("keys", "guide-app", "30")
        wait_until(lambda: "told this once: atrium-" in text("keys-said"), 10, "the secret")
        assert "guide-app" in text("keys-part")
        fill("webhooks", "Inside", "https://127.0.0.1/alarm")
        wait_until(lambda: text("webhooks-said"), 10, "why it is refused")
        assert "Alerts are sent nowhere." in text("webhooks-part")
        browser.save_screenshot(str(tmp_path / "administration.png"))
        browser.find_element(By.CSS_SELECTOR, "[aria-label='Take Maria K out']").click()
        browser.find_element(By.CSS_SELECTOR, "#administration-ask .primary").click()
        wait_until(lambda: text("users-said") == "Maria K is gone.", 10, "the end")
        browser.find_element(By.CSS_SELECTOR, "#audit-part form button").click()
        wait_until(lambda: "/v1/users/Maria" in text("audit-part"), 10, "the log of it")
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", _PHONE)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
        browser.save_screenshot(str(tmp_path / "administration-phone.png"))


def test_the_key_of_the_api_never_reaches_the_browser(system: System, page: WebDriver) -> None:
    assert API_KEY not in page.page_source
    assert API_KEY not in httpx.get(system.dashboard).text
    with httpx.stream("GET", system.dashboard + "/live", timeout=10) as live:
        seen = b""
        for chunk in live.iter_bytes():
            seen += chunk
            if seen.count(b"event: tracks") > 5:
                break
    assert API_KEY.encode() not in seen


def test_a_password_keeps_strangers_out(system: System, tmp_path: Path) -> None:
    with open_browser(tmp_path) as browser:
        browser.get(system.password_dashboard)
        assert urlsplit(browser.current_url).path == "/login"
        browser.find_element(By.ID, "password").send_keys("a guess" + Key.ENTER)
        wait_until(lambda: "not the password" in browser.page_source, 10, "the refusal")
        browser.save_screenshot(str(tmp_path / "sign-in.png"))
        browser.find_element(By.ID, "password").send_keys(PASSWORD + Key.ENTER)
        wait_until(lambda: _tracks(browser), 30, "the map behind the door")
        browser.find_element(By.XPATH, "//button[text()='Sign out']").click()
        wait_until(lambda: urlsplit(browser.current_url).path == "/login", 10, "the door")
        _a_viewer_looks_and_changes_nothing(system, browser, tmp_path)


def _a_viewer_looks_and_changes_nothing(system: System, browser: WebDriver, tmp_path: Path) -> None:
    staff = {"name": "maria", "role": "viewer", "password": "correct horse battery"}
    httpx.post(f"{system.api_url}/v1/users", json=staff, headers={"X-API-Key": API_KEY}).raise_for_status()
    browser.find_element(By.ID, "name").send_keys(staff["name"])
    browser.find_element(By.ID, "password").send_keys(staff["password"] + Key.ENTER)
    wait_until(lambda: _tracks(browser), 30, "the map of one of the staff")
    assert "maria (viewer)" in browser.find_element(By.CSS_SELECTOR, ".atrium-header").text
    browser.save_screenshot(str(tmp_path / "viewer-map.png"))
    for page, words in (("zones", "zones-hint"), ("alerts", "inbox-lacking"), ("access-points", "points-lacking")):
        browser.get(f"{system.password_dashboard}/{page}")
        told = wait_until(lambda told=words: browser.find_elements(By.ID, told), 20, "the page")[0]
        wait_until(lambda told=told: "signed in as maria (viewer)" in told.text, 20, "what a viewer may not do")
        browser.save_screenshot(str(tmp_path / f"viewer-{page}.png"))
    browser.get(f"{system.password_dashboard}/learning")
    wait_until(lambda: "Decisions" in browser.page_source, 20, "the learning page")
    assert not [one for one in browser.find_elements(By.CSS_SELECTOR, ".orders button") if one.is_displayed()]
    httpx.delete(f"{system.api_url}/v1/users/maria", headers={"X-API-Key": API_KEY}).raise_for_status()
    wait_until(lambda: urlsplit(browser.current_url).path == "/login", 30, "the door, for who was taken out")


def test_pages_of_other_origins_hear_nothing(system: System) -> None:
    address = f"{system.dashboard}/_nicegui_ws/socket.io/?EIO=4&transport=polling"
    for origin, status in (("https://elsewhere.example", 400), (system.dashboard, 200)):
        answer = httpx.get(address, headers={"Origin": origin})
        allowed = answer.headers.get("access-control-allow-origin")
        assert (answer.status_code, allowed) == (status, origin if status == 200 else None)


def test_the_page_says_that_the_api_is_gone_and_recovers_by_itself(
    system: System, page: WebDriver, tmp_path: Path
) -> None:
    banner = page.find_element(By.ID, "atrium-banner")
    assert not banner.is_displayed()
    system.api.kill()
    system.api.wait(5)
    wait_until(lambda: "Not connected to the API" in banner.text, 15, "the banner")
    wait_until(lambda: not _tracks(page), 10, "old positions to vanish")
    page.save_screenshot(str(tmp_path / "not-connected.png"))
    system.api = system.start_api()
    wait_until(lambda: not banner.is_displayed() and len(_tracks(page)) >= len(DEVICES), 40, "the map to come back")


def test_the_dashboard_stops_in_time_and_the_open_page_survives_its_restart(system: System, page: WebDriver) -> None:
    Select(page.find_element(By.ID, "atrium-floor")).select_by_visible_text("Gallery")
    process = system.processes["dashboard"]
    process.send_signal(signal.SIGTERM)
    assert process.wait(5) == 0
    banner = page.find_element(By.ID, "atrium-banner")
    wait_until(lambda: "the dashboard does not answer" in banner.text, 15, "the banner")
    page.execute_script("window.thisIsTheOldPage = true")
    system.processes["dashboard"] = system.start_dashboard()

    def back() -> bool:
        ready = "return document.readyState === 'complete' && !window.thisIsTheOldPage && window.atrium !== undefined"
        return bool(page.execute_script(ready)) and len(_tracks(page)) >= len(DEVICES)

    wait_until(back, 60, "the page to come back by itself")
    assert page.execute_script("return atrium.floor") == "gallery"


def _two_floors(project: Path) -> dict[str, Any]:
    site: dict[str, Any] = yaml.safe_load((project / "deploy/sites/hall/site.yaml").read_text())
    gallery = {"id": "gallery", "name": "Gallery", "level": 1, "outline": [[0, 0], [14, 0], [14, 9], [6, 12], [0, 12]]}
    site["floors"].append(gallery)
    site["areas"].append({"id": "gallery", "floor": "gallery"})
    return site


_PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
_READ_DOTS = """
const canvas = document.getElementById("atrium-canvas");
const ratio = canvas.width / canvas.clientWidth;
const context = canvas.getContext("2d");
return atrium.tracks().filter((one) => one.floor === atrium.floor && one.state === "confirmed").map((one) => [
  one.device, [...context.getImageData(one.screen[0] * ratio, one.screen[1] * ratio, 1, 1).data].slice(0, 3),
]);
"""


def _near(pixel: list[int], colour: str) -> bool:
    wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return all(abs(a - b) <= 12 for a, b in zip(pixel, wanted, strict=True))


def _tracks(browser: WebDriver) -> dict[str, Any]:
    state = browser.execute_script("return window.atrium ? JSON.stringify(atrium.tracks()) : '[]'")
    return {track["key"]: track for track in json.loads(state)}


def _walked(before: dict[str, Any], after: dict[str, Any]) -> float:
    both = before.keys() & after.keys()
    return min((math.dist(*((w[k]["x"], w[k]["y"]) for w in (before, after))) for k in both), default=0.0)


def _rows(browser: WebDriver, name: str) -> list[str]:
    texts: list[str] = browser.execute_script(
        "const rows = document.querySelectorAll(`#${arguments[0]} li`);"
        "return [...rows].map((row) => row.innerText.replace(/\\s+/g, ' '))",
        name,
    )
    return texts


def _hosts(browser: WebDriver) -> set[str | None]:
    """The hosts the page asked for anything; what the browser asks of itself (chrome://) does not count."""
    hosts = set()
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            parameters = message["params"]
            url = urlsplit(parameters.get("url") or parameters["request"]["url"])
            if url.scheme in ("http", "https", "ws", "wss"):
                hosts.add(url.hostname)
    return hosts


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=2).status_code in (200, 303)
    except httpx.HTTPError:
        return False
