"""The learning page as an operator sees it: real router, api and dashboard processes, a stand-in for learning."""

import base64
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import msgspec
import pytest
from api_in_process import running
from browser import Button, open_browser
from conftest import unused_port
from learning_double import Double, busy, fresh, learning
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys as Key
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.select import Select
from waiting import wait_until

from services.api.settings import READ_SCOPES
from shared.bus import Bus, router
from shared.learning_report import LearningReport
from shared.site import load_site

pytestmark = pytest.mark.paced

KEYS = json.dumps([{"name": "office", "key": "the-key-of-the-office", "scopes": [*READ_SCOPES, "learning-admin"]}])


@dataclass
class System:
    dashboard: str
    double: Double
    busy: LearningReport


@pytest.fixture(scope="module")
def system(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    site_file = project / "deploy/sites/hall/site.yaml"
    site = load_site(site_file)
    endpoint, port = f"tcp/127.0.0.1:{unused_port()}", unused_port()
    session = router(endpoint)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")}
    environment.pop("PYTEST_CURRENT_TEST", None)  # NiceGUI behaves differently under it
    with (
        Bus([endpoint]) as bus,
        learning(bus, site, fresh(site)) as double,
        running(site, project, endpoint, unused_port(), api_keys=KEYS) as api,
        (tmp_path_factory.mktemp("learning") / "dashboard.log").open("ab") as log,
    ):
        environment |= {
            "PYTHONPATH": str(project),
            "ATRIUM_SITE_FILE": str(site_file),
            "ATRIUM_PROFILE": "demo",
            "ATRIUM_BUS": json.dumps([endpoint]),
            "ATRIUM_DASHBOARD_PORT": str(port),
            "ATRIUM_API_URL": api,
            "ATRIUM_API_KEY": "the-key-of-the-office",
        }
        command = [sys.executable, "-m", "services.dashboard"]
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        full = busy(site)
        double.maps, double.model = full.maps, full.model
        try:
            wait_until(lambda: _answers(f"http://127.0.0.1:{port}"), 40, "the dashboard")
            yield System(f"http://127.0.0.1:{port}", double, full.report)
        finally:
            process.terminate()
            process.wait(10)
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with open_browser(tmp_path_factory.mktemp("browser"), 1300, 1000) as opened:
        yield opened


def test_before_anybody_walked_the_page_says_so(system: System, browser: WebDriver, tmp_path: Path) -> None:
    browser.get(system.dashboard)
    wait_until(lambda: _found(browser, "a[href='/learning']"), 30, "the way to the page").click()
    _shows(browser, "Nobody with a phone has walked yet.")
    _shows(browser, "Nothing was decided yet")
    assert _charts(browser) == 0
    _picture(browser, tmp_path / "empty.png")


def test_what_is_learned_is_told_in_words_tables_charts_and_maps(
    system: System, browser: WebDriver, tmp_path: Path
) -> None:
    system.double.report = system.busy
    browser.get(f"{system.dashboard}/learning")
    _shows(browser, "12 % better on held-out walks")
    for words in ("ap-3", "was something put in front of it?", "explains withheld readings better", "1.35", "Phone "):
        _shows(browser, words)
    wait_until(lambda: _charts(browser) == 3, 20, "three charts")
    wait_until(lambda: "Where people walked" in _title(browser), 20, "a map")
    wait_until(lambda: _found(browser, "time[datetime]"), 10, "times in the reader's own zone")
    _picture(browser, tmp_path / "learning.png")
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]  # type: ignore[attr-defined]
    assert errors == []
    assert _hosts(browser) == {"127.0.0.1"}
    assert "the-key-of-the-office" not in browser.page_source


def test_on_a_phone_nothing_is_wider_than_the_screen(system: System, browser: WebDriver, tmp_path: Path) -> None:
    system.double.report = system.busy
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)  # type: ignore[attr-defined]
    browser.get(f"{system.dashboard}/learning")
    _shows(browser, "12 % better on held-out walks")
    wait_until(lambda: _charts(browser) == 3 and _found(browser, ".slot svg[role=img]"), 20, "charts and a map")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    _picture(browser, tmp_path / "phone.png")
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})  # type: ignore[attr-defined]


def test_a_roll_back_is_asked_for_confirmed_by_keyboard_and_told(system: System, browser: WebDriver) -> None:
    system.double.report = system.busy
    browser.get(f"{system.dashboard}/learning")
    Button(browser, "Roll back…").send_keys(Key.ENTER)
    _shows(browser, "The radio model of hall returns to the version before.")
    before = len(system.double.commands)
    Button(browser, "Cancel").send_keys(Key.ENTER)
    wait_until(lambda: not _found(browser, ".question"), 10, "the question to go")
    assert [c for c in system.double.commands[before:] if c.do != "map"] == []
    Button(browser, "Roll back…").click()
    Button(browser, "Roll back").click()
    _shows(browser, "area hall is back at radio model 2, as version 4")
    order = [command for command in system.double.commands if command.do == "rollback"][-1]
    assert (order.kind, order.subject, order.by) == ("radio", "hall", "office")
    Button(browser, "Freeze…").click()
    Button(browser, "Freeze").click()
    _shows(browser, "Frozen by hand")
    Button(browser, "Unfreeze…").click()
    Button(browser, "Unfreeze").click()
    wait_until(lambda: not system.double.report.frozen, 10, "learning to be unfrozen")


def test_a_map_is_chosen_by_keyboard_and_what_goes_wrong_is_told(system: System, browser: WebDriver) -> None:
    browser.get(f"{system.dashboard}/learning")
    wait_until(lambda: _found(browser, ".slot svg[role=img]"), 20, "a map")
    kind = Select(browser.find_element(By.XPATH, "//label[contains(., 'Map')]/select"))
    kind.select_by_visible_text("Radio of one access point")
    wait_until(lambda: "expected to hear of ap-1" in _title(browser), 10, "the radio of ap-1")
    Select(browser.find_element(By.XPATH, "//label[contains(., 'Access point')]/select")).select_by_visible_text("ap-2")
    wait_until(lambda: "expected to hear of ap-2" in _title(browser), 10, "the radio of ap-2")
    system.double.report = msgspec.structs.replace(system.busy, history="no list")  # type: ignore[arg-type]
    _shows(browser, "in a way this version does not understand")
    assert "12 % better on held-out walks" in _text(browser)


def _title(browser: WebDriver) -> str:
    return str(browser.execute_script("return document.querySelector('.slot svg[role=img] title')?.textContent"))


def _text(browser: WebDriver) -> str:
    return str(browser.execute_script("return document.body.innerText"))


def _shows(browser: WebDriver, words: str) -> None:
    wait_until(lambda: words in _text(browser), 20, words)


def _found(browser: WebDriver, selector: str) -> Any:
    return next(iter(browser.find_elements(By.CSS_SELECTOR, selector)), None)


def _charts(browser: WebDriver) -> int:
    script = "return [...document.querySelectorAll('.chart canvas')].filter((one) => one.checkVisibility()).length"
    return int(browser.execute_script(script))


def _picture(browser: WebDriver, path: Path) -> None:
    """The whole page, however long."""
    size = browser.execute_script(
        "return [document.documentElement.clientWidth, document.documentElement.scrollHeight]"
    )
    shot = {"captureBeyondViewport": True, "clip": {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1}}

    path.write_bytes(base64.b64decode(browser.execute_cdp_cmd("Page.captureScreenshot", shot)["data"]))  # type: ignore[attr-defined]


def _hosts(browser: WebDriver) -> set[str | None]:
    """The hosts the page asked for anything; what the browser asks of itself (chrome://) does not count."""
    hosts = set()
    for entry in browser.get_log("performance"):  # type: ignore[attr-defined]
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
