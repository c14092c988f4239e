"""The dashboard's pages as staff use them, in a real browser, before a double of the API."""

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_double import DEVICES, KEY, Double
from browser import Button, open_browser
from dashboard_process import dashboard
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys as Key
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.select import Select
from waiting import wait_until
from zone_drawing import click_plan, move_to, on_screen, open_zones

from shared.zones import ZoneDefinition

pytestmark = pytest.mark.paced

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def system(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Double]]:
    with dashboard(project, tmp_path_factory.mktemp("dashboard")) as running:
        yield running


@pytest.fixture(scope="module")
def downloads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def browser(downloads: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with open_browser(tmp_path_factory.mktemp("browser")) as opened:
        allowed = {"behavior": "allow", "downloadPath": str(downloads)}
        opened.execute_cdp_cmd("Browser.setDownloadBehavior", allowed)
        yield opened


def test_an_area_is_drawn_given_a_rule_and_saved(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "New area").click()
    click_plan(browser, (14.02, 8.98), (17.0, 9.0), (17.0, 6.0), (14.0, 6.0), (14.0, 9.0))
    name = wait_until(lambda: _found(browser, "#zone-name"), 20, "the form")
    name.send_keys("Café corner")
    Select(browser.find_element(By.ID, "rule-0-kind")).select_by_visible_text("Too many people are inside")
    limit = browser.find_element(By.ID, "rule-0-limit")
    limit.clear()
    limit.send_keys("25")
    browser.save_screenshot(str(tmp_path / "drawn.png"))
    Button(browser, "Save").click()
    kept = _kept(double, "cafe-corner", "the zone at the API")
    assert kept["points"] == [(14.0, 9.0), (17.0, 9.0), (17.0, 6.0), (14.0, 6.0)]  # on the grid, corners closed
    assert [(rule["kind"], rule["limit"]) for rule in kept["rules"]] == [("crowd", 25.0)]
    wait_until(lambda: "is saved and holds" in _text(browser), 20, "the word that it is saved")
    assert _severe(browser) == []


def test_corners_are_dragged_inserted_deleted_and_undone(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "Entrance").click()
    _drag(browser, (7.0, 2.5), (6.0, 3.0))
    assert _points(browser)[3] == [6.0, 3.0]
    _drag(browser, (10.0, 0.0), (10.0, 1.0))
    assert len(_points(browser)) == 5
    canvas = browser.find_element(By.ID, "zones-canvas")
    canvas.send_keys(Key.DELETE)  # the corner just dragged is the chosen one
    assert len(_points(browser)) == 4
    for _ in range(3):
        canvas.send_keys(Key.CONTROL + "z")
    assert _points(browser) == [[7, 0], [13, 0], [13, 2.5], [7, 2.5]]
    assert not Button(browser, "Save").is_enabled()
    canvas.send_keys(Key.CONTROL + "y")
    Button(browser, "Save").click()
    wait_until(lambda: double.zones["entrance"]["points"][3] == (6.0, 3.0), 20, "the moved corner at the API")


def test_a_line_is_drawn_by_keyboard_alone(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "New line").send_keys(Key.ENTER)
    canvas = browser.switch_to.active_element
    assert canvas.get_attribute("id") == "zones-canvas"
    keys = (Key.SHIFT + Key.ARROW_LEFT, Key.NULL + Key.ENTER, Key.SHIFT + 2 * Key.ARROW_RIGHT, Key.NULL + Key.ENTER)
    for pressed in keys:
        canvas.send_keys(pressed)
    wait_until(lambda: browser.switch_to.active_element.get_attribute("id") == "zone-name", 20, "the form in focus")
    browser.switch_to.active_element.send_keys("Door")
    Select(browser.find_element(By.ID, "rule-0-direction")).select_by_visible_text("Forward, as the arrow points")
    Button(browser, "Save").send_keys(Key.ENTER)
    kept = _kept(double, "door", "the line at the API")
    (x0, y0), (x1, y1) = kept["points"]
    assert (kept["shape"], round(x1 - x0, 3), y0 == y1) == ("line", 2.0, True)
    assert kept["rules"][0]["direction"] == "forward"


def test_an_exhibit_is_set_by_keyboard_moved_undone_and_never_overwrites_what_somebody_else_did(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "New exhibit").send_keys(Key.ENTER)
    browser.switch_to.active_element.send_keys(Key.ENTER)
    wait_until(lambda: browser.switch_to.active_element.get_attribute("id") == "zone-name", 20, "the form in focus")
    browser.switch_to.active_element.send_keys("A vase")
    browser.find_element(By.ID, "zone-facing").send_keys("90")
    browser.save_screenshot(str(tmp_path / "exhibit.png"))
    Button(browser, "Save").send_keys(Key.ENTER)
    wait_until(lambda: "a-vase" in double.exhibits, 20, "the exhibit at the API")
    kept = double.exhibits["a-vase"]
    assert (kept["floor"], kept["reach"], kept["facing"]) == ("ground", 8, 90)
    wait_until(lambda: "is saved and holds" in _text(browser), 20, "the word that it is saved")
    canvas = browser.find_element(By.ID, "zones-canvas")
    canvas.send_keys("n" + 2 * Key.ARROW_UP)
    assert _points(browser)[0][1] == pytest.approx(kept["y"] + 0.2)
    canvas.send_keys(Key.CONTROL + "z")
    canvas.send_keys(Key.CONTROL + "y")
    double.keep_exhibit(kept | {"reach": 3.0})
    Button(browser, "Save").click()
    Button(browser, "Show theirs").click()
    reach = "return document.getElementById('zone-reach')?.value"
    wait_until(lambda: browser.execute_script(reach) == "3", 20, "theirs")
    Button(browser, "Delete exhibit…").click()
    Button(browser, "Delete").click()
    wait_until(lambda: "a-vase" not in double.exhibits, 20, "the end of the exhibit")
    assert _severe(browser)[1:] == []  # the one conflict


def test_what_the_api_refuses_is_told_beside_the_field_and_nothing_is_lost(
    system: tuple[str, Double], browser: WebDriver
) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "Around the model").click()
    Button(browser, "Add a rule").click()
    double.refuse = {"status": 422, "title": "Invalid", "detail": "kind: not here", "field": "rules[0].kind"}
    Button(browser, "Save").click()
    problem = wait_until(lambda: _shown(browser, "[data-for='rules[0].kind']"), 20, "the problem at the rule")
    assert problem.text == "Kind: not here."
    assert browser.find_element(By.ID, "rule-0-kind").get_attribute("aria-invalid") == "true"
    double.refuse = {"status": 503, "title": "Away", "detail": "the database is away"}
    Button(browser, "Save").click()
    wait_until(lambda: "The database is away." in _text(browser), 20, "a problem of no field")
    Button(browser, "Save").click()
    wait_until(lambda: len(double.zones["model-corner"]["rules"]) == 1, 20, "the rule at the API")


def test_a_limit_that_means_nothing_is_told_before_anything_is_sent(
    system: tuple[str, Double], browser: WebDriver
) -> None:
    url, double = system
    open_zones(url, browser)
    Button(browser, "Around the model").click()
    Button(browser, "Add a rule").click()
    number = len(browser.find_elements(By.CSS_SELECTOR, ".rule")) - 1
    Select(browser.find_element(By.ID, f"rule-{number}-kind")).select_by_value("speed")
    browser.find_element(By.ID, f"rule-{number}-limit").clear()
    before = [line for line in double.asked if line.startswith("PUT")]
    Button(browser, "Save").click()
    wait_until(lambda: _shown(browser, f"[data-for='rules[{number}].limit']"), 20, "the problem at the limit")
    assert [line for line in double.asked if line.startswith("PUT")] == before
    Button(browser, "Discard changes").click()


def test_a_crossed_outline_cannot_be_saved(system: tuple[str, Double], browser: WebDriver) -> None:
    url, _ = system
    open_zones(url, browser)
    Button(browser, "Around the model").click()
    _drag(browser, (7.5, 6.0), (13.0, 8.0))
    wait_until(lambda: "The outline crosses itself" in _text(browser), 20, "the words")
    assert not Button(browser, "Save").is_enabled()
    Button(browser, "Discard changes").click()


def test_an_alert_arrives_by_itself_and_is_acknowledged_once(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, double = system
    browser.get(f"{url}/alerts")
    wait_until(lambda: "Nothing of that kind" in _empty(browser), 20, "an empty inbox")
    alert = double.raise_alert(kind="crowd", value=23.0, limit=20.0, device=None)
    wait_until(lambda: len(_alerts(browser)) == 1, 10, "the alert")
    assert "23 people in Entrance, allowed: 20" in _alerts(browser)[0]
    Button(browser, "Acknowledge").send_keys(Key.ENTER)
    browser.switch_to.active_element.send_keys("A school class <b>")
    double.raise_alert(kind="exit")
    wait_until(lambda: len(_alerts(browser)) == 2, 10, "another alert while somebody writes")
    browser.save_screenshot(str(tmp_path / "inbox.png"))
    form = browser.find_element(By.CSS_SELECTOR, "form.acknowledge")
    form.find_element(By.CSS_SELECTOR, "button[type=submit]").click()
    wait_until(lambda: alert["acknowledged"] is not None, 20, "the acknowledgement at the API")
    assert alert["acknowledged"]["note"] == "A school class <b>"
    wait_until(lambda: len(_alerts(browser)) == 1, 20, "the open ones only")
    Select(browser.find_element(By.ID, "inbox-state")).select_by_value("all")
    wait_until(lambda: len(_alerts(browser)) == 2, 20, "all of them")
    assert "A school class <b>" in _alerts(browser)[1]
    Select(browser.find_element(By.ID, "inbox-kind")).select_by_value("exit")
    wait_until(lambda: len(_alerts(browser)) == 1 and "left Entrance" in _alerts(browser)[0], 20, "the filter")
    browser.find_element(By.LINK_TEXT, "Where?").click()
    middle = "const c = document.getElementById('atrium-canvas'); return [c.clientWidth / 2, c.clientHeight / 2]"
    there = "return window.atrium?.floor ? atrium.toScreen(10, 1.2) : null"
    wait_until(lambda: browser.execute_script(there) == browser.execute_script(middle), 20, "the place on the map")


def test_all_alerts_shown_are_acknowledged_at_once_and_no_others(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, double = system
    shown = [double.raise_alert(kind="speed", value=3.0) for _ in range(3)]
    other = double.raise_alert(kind="speed", value=3.0, device=DEVICES[2])
    browser.get(f"{url}/alerts")
    wait_until(lambda: _alerts(browser), 20, "the inbox")
    Select(browser.find_element(By.ID, "inbox-kind")).select_by_value("speed")
    browser.find_element(By.ID, "inbox-device").send_keys("1b07" + Key.ENTER)
    Button(browser, "Acknowledge all 3 shown…").click()
    browser.find_element(By.CSS_SELECTOR, "#inbox-ask textarea").send_keys("a school run")
    browser.save_screenshot(str(tmp_path / "all.png"))
    Button(browser, "Acknowledge all").click()
    wait_until(lambda: "3 alerts were acknowledged." in _text(browser), 10, "the word")
    assert [alert["acknowledged"]["note"] for alert in shown] == ["a school run"] * 3
    assert other["acknowledged"] is None


def test_the_keyboard_passes_the_live_alerts_while_more_arrive(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    for _ in range(3):
        double.raise_alert()
    browser.get(url)
    rows = "return document.querySelectorAll('#alerts button').length"
    wait_until(lambda: browser.execute_script(rows) >= 3, 20, "alerts beside the map")
    wait_until(lambda: browser.execute_script("return document.querySelector('#phones button') !== null"), 20, "phones")
    browser.execute_script("document.querySelector('#alerts button').focus()")
    browser.switch_to.active_element.send_keys(Key.ARROW_DOWN)
    chosen = browser.switch_to.active_element
    before = browser.execute_script(rows)
    double.raise_alert(kind="exit")
    wait_until(lambda: browser.execute_script(rows) == before + 1, 10, "another alert")
    assert browser.switch_to.active_element == chosen
    chosen.send_keys(Key.TAB)  # the list is one stop
    assert browser.execute_script("return document.activeElement.closest('#phones') !== null")
    mark = "return document.querySelector(arguments[0]).style.cssText"
    on_map = browser.execute_script(mark, "#alerts .swatch.shaped")
    browser.get(f"{url}/alerts")
    wait_until(lambda: _alerts(browser), 20, "the inbox")
    assert browser.execute_script(mark, "#inbox-rows .swatch.shaped") == on_map  # one phone, one look


def test_who_may_only_look_is_told_so_and_has_no_dead_buttons(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    double.raise_alert()
    double.scopes, before = [], double.scopes
    try:
        browser.get(f"{url}/alerts")
        wait_until(lambda: _alerts(browser), 20, "an alert")
        assert "lacks the scope acknowledge" in browser.find_element(By.ID, "inbox-lacking").text
        assert not browser.find_elements(By.CSS_SELECTOR, "#inbox-rows button")
        open_zones(url, browser)
        assert "lacks the scope zones-admin" in browser.find_element(By.ID, "zones-hint").text
        assert not browser.find_element(By.ID, "zones-area").is_displayed()
        browser.find_element(By.CSS_SELECTOR, "#zones-list button").click()
        wait_until(lambda: _found(browser, "#zone-name"), 20, "the form")
        assert not browser.find_elements(By.CSS_SELECTOR, "#zones-form .save")
    finally:
        double.scopes = before


def test_the_heat_map_is_drawn_and_saved_as_picture_and_numbers(
    system: tuple[str, Double], browser: WebDriver, downloads: Path, tmp_path: Path
) -> None:
    url, double = system
    _severe(browser)  # what other tests had refused
    browser.get(f"{url}/visits")
    canvas = wait_until(lambda: _shown(browser, "#heat-picture"), 20, "the heat map")
    wait_until(lambda: not _found(browser, ".card[aria-busy=true]"), 20, "the other pictures")
    assert "stayed longest around" in str(canvas.get_attribute("aria-label"))
    hot, striped, nobody = browser.execute_script(_HEAT_PIXELS)
    assert sum(hot) < 300  # the darkest of the scale
    assert striped  # cells of fewer than five are neither empty nor of the scale
    assert nobody == [255, 255, 255]
    asked = next(line for line in double.asked if line.startswith("GET /v1/heatmap"))
    assert "floor=ground" in asked
    assert "cell=0.5" in asked
    (tmp_path / "visits.png").write_bytes(_whole_page(browser))
    browser.find_element(By.ID, "heat-png").click()
    assert _file(downloads, "heat-*.png").read_bytes()[:8] == PNG
    browser.find_element(By.ID, "heat-csv").click()
    lines = _file(downloads, "heat-*.csv").read_text().splitlines()
    assert lines[0] == "x_m,y_m,person_seconds,people"
    assert len(lines) == 1 + 40 * 24
    assert any(line.endswith(",,") for line in lines)  # what is not told is told to nobody
    for words in ("fewer than 5 people", "412", "Around the model"):
        assert words in _text(browser)
    Select(browser.find_element(By.ID, "visits-at")).select_by_value("exhibits")
    wait_until(lambda: "The model" in browser.find_element(By.ID, "dwell-table").text, 10, "stays at the exhibit")
    assert _severe(browser) == []


def test_health_is_told_in_plain_words(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    browser.get(f"{url}/health")
    wait_until(lambda: "All is well." in _text(browser), 20, "the verdict")
    double.problems = ["the gateway service is not running: phones cannot report"]
    wait_until(lambda: "1 thing is wrong" in _text(browser), 10, "the change")
    assert "The gateway service is not running: phones cannot report" in _text(browser)
    double.problems = []


def test_a_person_is_chosen_by_click_or_key_and_explained(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, _ = system
    browser.get(url)
    ready = "return (window.atrium?.tracks() ?? []).length === 4"
    wait_until(lambda: browser.execute_script(ready), 20, "people on the map")
    canvas = browser.find_element(By.ID, "atrium-canvas")
    device = DEVICES[0]
    find = "return atrium.tracks().find((one) => one.device === arguments[0]).screen"

    def clicked() -> str:
        x, y = browser.execute_script(find, device)  # who walks on meanwhile is clicked again
        move_to(browser, canvas, x, y).click().perform()
        panel = browser.find_element(By.ID, "atrium-evidence")
        return panel.text if str(device) in panel.text else ""

    wait_until(clicked, 10, "the evidence")
    panel = browser.find_element(By.ID, "atrium-evidence")
    wait_until(lambda: "Phone 20e4, 5 %" in panel.text, 20, "the runner-up")
    for words in (
        "93 %",
        "7, 9",
        "within 0.6 m",
        "A camera sees this person now.",
        "hall-east",
        "without a break",
        "They tell of this person too",
    ):
        assert words in panel.text
    browser.save_screenshot(str(tmp_path / "evidence.png"))
    canvas.send_keys(Key.ESCAPE)
    assert not panel.is_displayed()
    canvas.send_keys("nn")
    wait_until(lambda: "Phone 20e4" in panel.text, 20, "the second person by keyboard")


def test_a_zone_or_exhibit_that_staff_drew_appears_on_the_live_map_by_itself(
    system: tuple[str, Double], browser: WebDriver
) -> None:
    url, double = system
    browser.get(url)
    wait_until(lambda: browser.execute_script("return window.atrium?.floor === 'ground'"), 20, "the map")
    # The floor is known a moment before it is painted.
    painted = """return atrium.connected && (() => {""" + _PIXEL + """})().endsWith(",255")"""
    wait_until(lambda: browser.execute_script(painted, 18.5, 1.2), 20, "the floor")
    before = browser.execute_script(_PIXEL, 18.5, 1.2)
    off = 3.0 / browser.execute_script("return atrium.scale")  # where the pixel is looked at
    double.keep_exhibit({"id": "stone", "floor": "ground", "x": 18.5 + off, "y": 1.2 - off})
    wait_until(lambda: browser.execute_script(_PIXEL, 18.5, 1.2) != before, 10, "the exhibit")
    del double.exhibits["stone"]
    wait_until(lambda: browser.execute_script(_PIXEL, 18.5, 1.2) == before, 10, "the exhibit to go")
    corner = [(17.5, 0.4), (19.5, 0.4), (19.5, 2.0), (17.5, 2.0)]
    double.keep(ZoneDefinition(id="corner", floor="ground", points=corner))
    wait_until(lambda: browser.execute_script(_PIXEL, 18.5, 1.2) != before, 10, "the zone")
    del double.zones["corner"]
    wait_until(lambda: browser.execute_script(_PIXEL, 18.5, 1.2) == before, 10, "the zone to go")


def test_a_visitor_who_asks_is_told_what_is_known(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    double.raise_alert()
    browser.get(f"{url}/privacy")
    wait_until(lambda: _found(browser, "#privacy-device"), 20, "the form").send_keys(str(DEVICES[0]) + Key.ENTER)
    wait_until(lambda: "Now: on floor ground" in _text(browser), 10, "the place")
    assert "Phone 1b07 entered Entrance" in _text(browser)
    told = {
        "privacy-erasures": ("Phone fee1", "history", "learning"),
        "privacy-kept": ("Where phones were", "2.5 days", "ATRIUM_HISTORY_PHONE_DAYS", "do not answer: learning"),
    }
    for part, words in told.items():
        text = wait_until(lambda: _answered(browser, f"#{part}"), 10, f"{part} to be filled")  # noqa: B023
        assert [word for word in words if word not in text] == []


def test_staff_erase_a_phone_by_its_id_typed_twice_and_see_the_stores_follow(
    system: tuple[str, Double], browser: WebDriver
) -> None:
    url, double = system
    browser.get(f"{url}/privacy")
    first = wait_until(lambda: _found(browser, "#erase-device"), 20, "the form")
    second, button = browser.find_element(By.ID, "erase-again"), browser.find_element(By.ID, "erase-button")
    first.send_keys(str(DEVICES[0]))
    second.send_keys(str(DEVICES[0])[:-1])
    assert not button.is_enabled()
    second.send_keys(str(DEVICES[0])[-1])
    wait_until(button.is_enabled, 20, "the button")
    button.click()
    wait_until(lambda: "It is gone from every store" in _text(browser), 10, "the stores' word")
    assert double.erased == [DEVICES[0]]


@pytest.mark.parametrize("path", ["/", "/alerts", "/visits", "/zones", "/health", "/privacy", "/administration"])
def test_on_a_phone_no_page_is_wider_than_the_screen(system: tuple[str, Double], browser: WebDriver, path: str) -> None:
    _be_phone(browser, 390)
    url, double = system
    # A name as long as the API takes it, without a place to break.
    double.keep(ZoneDefinition(id="long", name="W" * 200, floor="ground", points=[(1.0, 1.0), (4.0, 1.0), (4.0, 4.0)]))
    double.raise_alert(zone="long")
    try:
        browser.get(url + path)
        wait_until(lambda: _found(browser, "main"), 20, "the page")
        wait_until(lambda: "Live map" in _text(browser), 20, "its header")
        if path in ("/alerts", "/zones"):
            wait_until(lambda: "WWW" in _text(browser), 10, "the long name")
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    finally:
        del double.zones["long"], double.alerts[0]
        _be_no_phone(browser)


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("path", ["/privacy", "/health", "/administration", "/visits"])
def test_no_word_of_a_table_is_broken(
    system: tuple[str, Double], browser: WebDriver, path: str, width: int, tmp_path: Path
) -> None:
    url, double = system
    double.scopes, before = ["accounts", "webhooks", "audit"], double.scopes
    _be_phone(browser, width)
    try:
        browser.get(url + path)
        wait_until(lambda: browser.find_elements(By.CSS_SELECTOR, ".page td"), 20, "a table")
        (tmp_path / "tables.png").write_bytes(_whole_page(browser))
        assert browser.execute_script(_BROKEN_WORDS) == []
        assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    finally:
        double.scopes = before
        _be_no_phone(browser)


def test_a_time_beyond_all_dates_leaves_the_others_readable(system: tuple[str, Double], browser: WebDriver) -> None:
    url, double = system
    double.scopes, scopes = ["accounts"], double.scopes
    double.key_ends, ends = 1e300, double.key_ends
    try:
        browser.get(f"{url}/administration")
        row = wait_until(lambda: _found(browser, "#keys-part tbody tr"), 20, "the key")
        assert "never" in row.text
    finally:
        double.scopes, double.key_ends = scopes, ends


def test_many_zones_are_asked_in_longer_steps_and_listed_when_wished(
    system: tuple[str, Double], browser: WebDriver, downloads: Path, tmp_path: Path
) -> None:
    url, double = system
    before = dict(double.zones)
    for number in range(2000):
        double.keep(ZoneDefinition(id=f"z{number}", floor="ground", points=[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0)]))
    try:
        double.asked.clear()
        browser.get(f"{url}/visits")
        wait_until(lambda: _shown(browser, "#occupancy-picture"), 20, "today's picture")
        Select(browser.find_element(By.ID, "visits-period")).select_by_value("1")
        wait_until(lambda: not _found(browser, ".card[aria-busy=true]"), 20, "yesterday's answers")
        asked = "GET /v1/occupancy"
        assert sum(line.startswith(asked) for line in double.asked) >= 2
        for line in double.asked:
            if line.startswith(asked):
                query = httpx.QueryParams(line.partition("?")[2])
                steps = (float(query["until"]) - float(query["since"])) / int(query["step"])
                assert steps * len(double.zones) <= 50_000
        script = "return document.querySelectorAll('#dwell-table tbody tr').length"
        wait_until(lambda: browser.execute_script(script) == 100, 20, "the first stays")
        Button(browser, "Show all 150").click()
        assert browser.execute_script(script) == 150
        # A picture shows the foremost and stays one that can be looked at; what is saved is of all.
        (tmp_path / "many.png").write_bytes(_whole_page(browser))
        high = "return document.querySelector(arguments[0]).clientHeight"
        assert max(browser.execute_script(high, f"#{name}-picture") for name in ("occupancy", "dwell", "flows")) < 1200
        told = str(browser.find_element(By.ID, "occupancy-picture").get_attribute("aria-label"))
        assert told.count(" up to ") == 12
        assert "z1999" in told  # the fullest, not the first
        browser.find_element(By.ID, "occupancy-csv").click()
        lines = _file(downloads, "occupancy-*.csv").read_text().splitlines()[1:]
        assert len({line.split(",")[1] for line in lines}) == len(double.zones)
        browser.find_element(By.ID, "dwell-csv").click()
        assert len(_file(downloads, "dwell-*.csv").read_text().splitlines()) == 1 + 150
        browser.find_element(By.ID, "flows-csv").click()
        assert len(_file(downloads, "flows-*.csv").read_text().splitlines()) == 1 + 150**2
    finally:
        double.zones = before


def test_on_a_touch_screen_what_is_touched_is_large_enough(
    system: tuple[str, Double], browser: WebDriver, tmp_path: Path
) -> None:
    url, double = system
    double.raise_alert()
    double.scopes, before = [*double.scopes, "accounts"], double.scopes
    _be_phone(browser, 390)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    touched = {"/": "#atrium-layers input", "/alerts": ".alerts a", "/administration": "#keys-part .days input"}
    try:
        for path, selector in touched.items():
            browser.get(url + path)
            wait_until(lambda: _found(browser, selector), 20, "what is touched")  # noqa: B023
            (tmp_path / f"touch-{path[1:]}.png").write_bytes(_whole_page(browser))
            sizes = browser.execute_script(_SIZES, selector)
            assert min(min(size) for size in sizes) >= 24
    finally:
        double.scopes = before
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
        _be_no_phone(browser)


def test_the_key_of_the_api_never_reaches_the_browser(system: tuple[str, Double], browser: WebDriver) -> None:
    for path in ("/zones", "/ask/v1/zones", "/ask/v1/site"):
        assert KEY not in httpx.get(system[0] + path).text


# Words of letters alone that stand on more than one line, by the boxes their letters have.
_BROKEN_WORDS = """
const broken = [];
for (const cell of document.querySelectorAll(".page :is(td, th)")) {
  const texts = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
  for (let text = texts.nextNode(); text; text = texts.nextNode()) {
    for (const word of text.data.matchAll(/[A-Za-z]{2,16}/g)) {
      const range = document.createRange();
      range.setStart(text, word.index);
      range.setEnd(text, word.index + word[0].length);
      if (new Set([...range.getClientRects()].map(({ top }) => Math.round(top))).size > 1) broken.push(word[0]);
    }
  }
}
return broken;
"""
_SIZES = """
return [...document.querySelectorAll(arguments[0])].map((one) => one.getBoundingClientRect())
  .map(({ width, height }) => [width, height]);
"""
_PIXEL = """
const canvas = document.getElementById("atrium-canvas");
const [x, y] = atrium.toScreen(...arguments).map((value) => Math.round(value * canvas.width / canvas.clientWidth) + 3);
return canvas.getContext("2d").getImageData(x, y, 1, 1).data.join();
"""
_HEAT_PIXELS = """
const canvas = document.getElementById("heat-picture");
const context = canvas.getContext("2d");
const { data, width, height } = context.getImageData(0, 0, canvas.width, canvas.height);
const at = (x, y) => [...data.slice(4 * (y * width + x), 4 * (y * width + x) + 3)];
let darkest = [255, 255, 255];
let striped = false;
const sum = (rgb) => rgb.reduce((a, b) => a + b, 0);
for (let y = 0; y < height - 70; y += 2) for (let x = 0; x < width; x += 2) {
  const rgb = at(x, y);
  if (rgb[2] > rgb[0] && sum(rgb) < sum(darkest) && rgb[0] !== 74) darkest = rgb;
  striped ||= rgb.join() === "244,246,248";
}
return [darkest, striped, at(Math.round(width * 0.1), Math.round(height * 0.5))];
"""


def _points(browser: WebDriver) -> list[list[float]]:
    points: list[list[float]] = json.loads(browser.execute_script("return JSON.stringify(atriumZones.draft.points)"))
    return points


def _drag(browser: WebDriver, start: tuple[float, float], end: tuple[float, float]) -> None:
    canvas = browser.find_element(By.ID, "zones-canvas")
    (x0, y0), (x1, y1) = on_screen(browser, start), on_screen(browser, end)
    chain = move_to(browser, canvas, x0, y0).click_and_hold()
    chain.move_by_offset(round(x1 - x0) // 2, round(y1 - y0) // 2).perform()
    move_to(browser, canvas, x1, y1).release().perform()


def _kept(double: Double, zone: str, what: str) -> dict[str, Any]:
    wait_until(lambda: zone in double.zones, 5, what)
    return double.zones[zone]


def _file(folder: Path, pattern: str) -> Path:
    """Return the one file of that name, once there is something in it."""
    wait_until(lambda: [path for path in folder.glob(pattern) if path.stat().st_size], 10, pattern)
    return next(folder.glob(pattern))


def _found(browser: WebDriver, selector: str) -> Any:
    return next(iter(browser.find_elements(By.CSS_SELECTOR, selector)), None)


def _shown(browser: WebDriver, selector: str) -> Any:
    # In one go: between two questions the page may have built it anew.
    script = "return [...document.querySelectorAll(arguments[0])].find((one) => one.checkVisibility())"
    return browser.execute_script(script, selector)


def _answered(browser: WebDriver, selector: str) -> str:
    """What a part of the page says once it does not wait for an answer any more."""
    text = str(browser.execute_script("return document.querySelector(arguments[0]).innerText", selector))
    return "" if "Asking…" in text else text


def _text(browser: WebDriver) -> str:
    return str(browser.execute_script("return document.body.innerText"))


def _alerts(browser: WebDriver) -> list[str]:
    texts: list[str] = browser.execute_script(
        "return [...document.querySelectorAll('#inbox-rows li')].map((row) => row.innerText.replace(/\\s+/g, ' '))"
    )
    return texts


def _empty(browser: WebDriver) -> str:
    script = "const list = document.querySelector('#inbox-rows:empty'); return list ? list.dataset.empty : ''"
    return str(browser.execute_script(script))


def _severe(browser: WebDriver) -> list[Any]:
    log = browser.get_log("browser")  # type: ignore[attr-defined]
    return [entry for entry in log if entry["level"] == "SEVERE"]


def _be_phone(browser: WebDriver, width: int) -> None:
    size = {"width": width, "height": 844, "deviceScaleFactor": 2 if width < 860 else 1, "mobile": width < 860}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def _be_no_phone(browser: WebDriver) -> None:
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def _whole_page(browser: WebDriver) -> bytes:
    size = browser.execute_script(
        "return [document.documentElement.clientWidth, document.documentElement.scrollHeight]"
    )
    shot = {"captureBeyondViewport": True, "clip": {"x": 0, "y": 0, "width": size[0], "height": size[1], "scale": 1}}
    return base64.b64decode(browser.execute_cdp_cmd("Page.captureScreenshot", shot)["data"])
