"""A camera calibrated by clicks on a real frame: camera, api and dashboard processes, a real browser, no double."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import yaml
from browser import open_browser
from conftest import unused_port
from numpy.typing import NDArray
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys as Key
from selenium.webdriver.remote.webdriver import WebDriver
from service_process import process
from waiting import wait_until

from shared.bus import Bus, router
from shared.keys import Keys as BusKeys
from shared.messages import CameraStatus
from shared.site import load_site
from shared.site.setup_file import setup_path

pytestmark = pytest.mark.paced

FRAME = 143
"""Of the clip, counted from 1: eight people stand all over it. A click counts where it is, whatever is shown there."""
RATE = 7.0
SLOW_TRIALS = """
const real = window.fetch;
window.slowed = { begun: 0, now: 0, most: 0, last: null, full: false };
window.fetch = async (path, options) => {
  if (!String(path).endsWith("calibration/try")) return real(path, options);
  if (slowed.full) return new Response('{"detail": "4 fits of cameras wait already"}', { status: 429 });
  slowed.begun += 1;
  slowed.most = Math.max(slowed.most, ++slowed.now);
  try {
    await new Promise((resolve) => setTimeout(resolve, 700));
    return await real(path, options);
  } finally {
    slowed.now -= 1;
    slowed.last = JSON.parse(options.body).pairs[2].pixel[0];
  }
};
"""
"""For the page: trials that take as long as those of a busy machine, and how many ran at once."""
SIZE = (480, 360)
LABELLED = (768, 576)


@dataclass
class System:
    dashboard: str
    site_file: Path
    folder: Path
    api: str
    bus: Bus


@dataclass
class Feet:
    """Where people of the clip stand: ``pixels`` (n, 2) of the small picture, ``plan`` (n, 2) metres, ``frame``."""

    pixels: NDArray[np.float64]
    plan: NDArray[np.float64]
    frame: NDArray[np.float64]


@pytest.fixture(scope="module")
def feet(data_folder: Path) -> Feet:
    truth = np.loadtxt(data_folder / "pets09-s2l1" / "gt" / "gt.txt", delimiter=",")
    left, top, width, height = truth[:, 2:6].T
    pixels = np.column_stack([left + width / 2, top + height]) - 1.0  # the labels count pixels from 1
    inside = ((pixels >= 0) & (pixels < LABELLED)).all(axis=1)
    small = (pixels + 0.5) * np.divide(SIZE, LABELLED) - 0.5
    return Feet(small[inside], truth[inside, 7:9], truth[inside, 0])


@pytest.fixture(scope="module")
def system(project: Path, data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp("setup")
    # A newcomer's site: the camera hangs somewhere over there and looks about that way.
    site = yaml.safe_load((project / "deploy/sites/pets09/site.yaml").read_text(encoding="utf-8"))
    (camera,) = site["cameras"]
    clip = data_folder / "pets09-s2l1" / "video_480x360.avi"
    camera["source"] = {"file": str(clip), "frames_per_s": RATE, "loop": True}
    camera["geometry"] = {
        "kind": "pose",
        "image_size": list(SIZE),
        "position": [-20, -20, 5],
        "look_at": [-5, 0, 0],
        "horizontal_fov": 60,
    }
    del camera["area_of_interest"]
    site_file = folder / "site.yaml"
    site_file.write_text(yaml.safe_dump(site))
    endpoint, port, api = f"tcp/127.0.0.1:{unused_port()}", unused_port(), unused_port()
    session = router(endpoint)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")}
    environment.pop("PYTEST_CURRENT_TEST", None)  # NiceGUI behaves differently under it
    environment |= {
        "ATRIUM_SITE_FILE": str(site_file),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": json.dumps([endpoint]),
        "ATRIUM_DASHBOARD_PORT": str(port),
        "ATRIUM_API_URL": f"http://127.0.0.1:{api}",
        "PYTHONPATH": str(project),
    }
    with (
        process("services.camera", folder, endpoint, site_file, ATRIUM_CAMERA="view1", ATRIUM_ALLOW_STILLS="true"),
        process("services.fusion", folder, endpoint, site_file, ATRIUM_STATE_FOLDER=str(folder)),
        process("services.api", folder, endpoint, site_file, ATRIUM_API_PORT=str(api)),
        (folder / "dashboard.log").open("ab") as log,
    ):
        command = [sys.executable, "-m", "services.dashboard"]
        dashboard = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
        try:
            wait_until(lambda: _answers(f"http://127.0.0.1:{port}"), 40, "the dashboard")
            with Bus([endpoint]) as bus:
                yield System(f"http://127.0.0.1:{port}", site_file, folder, f"http://127.0.0.1:{api}", bus)
        finally:
            dashboard.terminate()
            dashboard.wait(10)
    session.close()  # type: ignore[no-untyped-call]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with open_browser(tmp_path_factory.mktemp("browser"), 1500, 1100) as opened:
        yield opened


def test_clicks_on_a_real_frame_calibrate_the_camera_within_ten_centimetres(
    system: System, browser: WebDriver, feet: Feet, tmp_path: Path
) -> None:
    browser.get(system.dashboard)
    wait_until(lambda: _found(browser, "a[href='/camera-setup']"), 30, "the way to the page").click()
    _says(browser, "Take a picture to begin")
    browser.find_element(By.ID, "setup-still").click()
    _says(browser, "in your browser only")
    shown = feet.frame == FRAME
    for pixel, place in zip(feet.pixels[shown], feet.plan[shown], strict=True):
        _click(browser, "image", pixel)
        _says(browser, "Now the same place on the plan")
        _click(browser, "plan", place)
    count = int(shown.sum())
    # A click on the plan is good to a few centimetres; what was measured is typed.
    for row, place in enumerate(feet.plan[shown], start=1):
        for name, value in zip("xy", place, strict=True):
            _type(browser, f"Pair {row}, {name}", round(float(value), 2))
    told = wait_until(lambda: _trial(browser, count), 20, "residuals of all pairs")
    assert all(pair["used"] for pair in told["pairs"])
    assert told["median_metres"] < 0.1
    assert told["grid"]
    browser.save_screenshot(str(tmp_path / "calibrated.png"))

    # One click goes wrong: it is found and named, and what is fitted stays as good.
    wrong = feet.pixels[shown][2] + [60.0, -25.0]
    _type(browser, "Pair 3, u", round(float(wrong[0]), 1))
    _type(browser, "Pair 3, v", round(float(wrong[1]), 1))
    told = wait_until(lambda: _trial(browser, count, left_out=2), 20, "the wrong click to be found")
    assert told["median_metres"] < 0.1
    _told(browser, "Pair 3 is taken for a wrong click")
    assert "wrong click?" in browser.find_element(By.ID, "setup-pairs").text

    # Who is faster than the API computes does not fill the queue that all share, and is told of the last change.
    browser.execute_script(SLOW_TRIALS)
    for number, u in enumerate(np.linspace(wrong[0] - 20.0, wrong[0], 3).round(1), start=1):
        _type(browser, "Pair 3, u", float(u))
        wait_until(lambda number=number: _slowed(browser)["begun"] >= number, 20, "a trial")  # type: ignore[misc]
    wait_until(lambda: _slowed(browser)["last"] == round(float(wrong[0]), 1), 20, "a trial of the last change")
    told = wait_until(lambda: _trial(browser, count, left_out=2), 20, "the wrong click to be found again")
    assert _slowed(browser)["most"] == 1
    # And of a queue that others have filled: it is tried again.
    browser.execute_script("slowed.full = true")
    _type(browser, "Pair 3, v", round(float(wrong[1]), 1) - 1.0)
    _told(browser, "It is tried again in a moment.")
    browser.execute_script("slowed.full = false")
    wait_until(lambda: _trial(browser, count, left_out=2), 20, "what was tried again")

    # The area of interest, by the keyboard too.
    browser.find_element(By.CSS_SELECTOR, "input[value=interest]").click()
    corners = [(5, 355), (5, 90), (475, 70), (475, 355)]
    for corner in corners[:3]:
        _click(browser, "image", corner)
    canvas = browser.find_element(By.ID, "setup-image")
    browser.execute_script("arguments[0].focus()", canvas)
    x, y = browser.execute_script("return cameraSetup.image.screenOf(arguments[0])", corners[3])
    size = canvas.size
    _move_cross(canvas, x - size["width"] / 2, y - size["height"] / 2)
    wait_until(lambda: "4 corners" in browser.find_element(By.ID, "setup-interest").text, 10, "the fourth corner")
    browser.find_element(By.ID, "setup-save").click()
    _says(browser, "Saved: camera view1, fusion of crossing and learning take it up within seconds")
    _says(browser, "The camera uses it now")

    # What every process reads at its next start.
    saved = load_site(system.site_file).camera("view1")
    camera = saved.geometry.build()
    off = np.linalg.norm(camera.to_ground(feet.pixels) - feet.plan, axis=1)
    assert camera.image_size == SIZE
    assert len(saved.geometry.image) == count - 1  # type: ignore[union-attr]
    assert np.median(off) < 0.1, "people all over the clip, most of whom nobody clicked"
    assert saved.area_of_interest is not None
    assert np.allclose(saved.area_of_interest, corners, atol=2.0)
    assert "by: demo" in setup_path(system.site_file).read_text(encoding="utf-8")
    browser.refresh()
    _says(browser, "by demo. Take a picture")
    assert len(browser.find_elements(By.CSS_SELECTOR, "#setup-pairs tr")) == count - 1
    severe = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]  # type: ignore[attr-defined]
    assert severe == []
    audit = httpx.get(f"{system.api}/v1/audit", headers={"X-API-Key": "demo-api-key"}, timeout=10).json()
    deeds = {(deed["action"], deed["subject"].rpartition("/")[2]) for deed in audit["entries"]}
    assert {("GET", "still"), ("POST", "calibration")} <= deeds


def test_positions_become_right_without_any_start(system: System, feet: Feet) -> None:
    """The calibration saved above goes on to fusion and the API; fails if any of camera, fusion and API holds on."""
    inbox = system.bus.inbox()
    inbox.subscribe(BusKeys(load_site(system.site_file).site).camera_status("view1"), CameraStatus, cached=True)
    origin: list[float] = []

    def off() -> list[float]:
        """Metres from each track of the API to whoever stands nearest to it in the frame it was seen in."""
        for delivery in inbox.receive(0.2):
            assert isinstance(delivery.message, CameraStatus)
            origin[:] = [] if delivery.message.origin is None else [delivery.message.origin]
        told = httpx.get(f"{system.api}/v1/tracks", headers={"X-API-Key": "demo-api-key"}, timeout=10).json()
        distances = []
        for track in told["tracks"]:
            there = feet.plan[feet.frame == round((track["t"] - origin[0]) * RATE) + 1] if origin else feet.plan[:0]
            distances += [float(np.linalg.norm(there - [track["x"], track["y"]], axis=1).min())] if len(there) else []
        return distances

    seen: list[float] = []

    def right() -> bool:
        seen[:] = (seen + off())[-60:]
        return len(seen) == 60 and float(np.median(seen)) < 0.4

    wait_until(right, 60, f"tracks where people stand: {seen}")
    site = httpx.get(f"{system.api}/v1/site", headers={"X-API-Key": "demo-api-key"}, timeout=10).json()
    hangs = load_site(system.site_file).camera("view1").geometry.build().position
    assert np.allclose(site["cameras"][0]["position"], hangs, atol=0.01)


def test_four_corners_of_a_known_rectangle_are_enough_and_nonsense_is_told_in_words(
    system: System, browser: WebDriver, data_folder: Path
) -> None:
    browser.get(f"{system.dashboard}/camera-setup")
    _says(browser, "Take a picture to begin")
    browser.execute_script("cameraSetup.state.pairs.length = 0")
    browser.find_element(By.ID, "setup-still").click()
    _says(browser, "in your browser only")
    browser.execute_script("document.querySelectorAll('details')[0].open = true")
    form = browser.find_element(By.ID, "setup-rectangle")
    for name, value in {"x": -12, "y": -8, "angle": 0, "width": 8, "depth": 6}.items():
        field = form.find_element(By.NAME, name)
        field.clear()
        field.send_keys(str(value))
    form.find_element(By.TAG_NAME, "button").click()
    _says(browser, "click its corners")
    corners = np.array([[-12, -8], [-4, -8], [-4, -2], [-12, -2]], float)
    known = load_site(_pets(system, data_folder)).cameras[0].geometry.build()
    pixels = (known.to_image(np.column_stack([corners, np.zeros(4)])) + 0.5) * np.divide(SIZE, LABELLED) - 0.5
    for corner in pixels:
        _click(browser, "image", corner)
    told = wait_until(lambda: _trial(browser, 4), 20, "a camera of four corners")
    assert told["median_metres"] < 0.1
    _told(browser, "With 4 pairs a wrong click bends everything unseen")
    for label, value in (("2, x", -12.0), ("2, y", -2.0), ("4, x", -4.0), ("4, y", -8.0)):
        _type(browser, f"Pair {label}", value)
    _told(browser, "mirrored")


def test_an_access_point_is_dragged_where_it_hangs(system: System, browser: WebDriver) -> None:
    browser.get(f"{system.dashboard}/access-points")
    _says(browser, "Drag an access point", "points-say")
    start = browser.execute_script("return accessPoints.plan.screenOf([-6, 8])")
    end = browser.execute_script("return accessPoints.plan.screenOf([-2, 4])")
    canvas = browser.find_element(By.ID, "points-plan")
    left, top = _corner(canvas)
    actions = ActionChains(browser, duration=50).move_to_element_with_offset(canvas, start[0] - left, start[1] - top)
    actions.click_and_hold().move_by_offset(round(end[0] - start[0]), round(end[1] - start[1])).release().perform()
    _type(browser, "ap-5, z", 3.4)
    browser.find_element(By.ID, "points-save").click()
    _says(browser, "Saved, and in use", "points-say")
    (point,) = [point for point in load_site(system.site_file).access_points if point.id == "ap-5"]
    assert point.position is not None
    assert point.position == pytest.approx((-2, 4, 3.4), abs=0.1)


def test_on_a_phone_nothing_is_wider_than_the_screen(system: System, browser: WebDriver) -> None:
    size = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)  # type: ignore[attr-defined]
    for page, place, words in (
        ("camera-setup", "setup-say", "Take a picture to begin"),
        ("access-points", "points-say", "Drag an access point"),
    ):
        browser.get(f"{system.dashboard}/{page}")
        _says(browser, words, place)
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})  # type: ignore[attr-defined]


def test_the_browser_gets_no_picture_without_asking_and_sends_no_forms(system: System) -> None:
    ours = {"Sec-Fetch-Site": "same-origin"}
    form = httpx.post(f"{system.dashboard}/setup/access-points", data={"positions": "x"}, headers=ours)
    assert form.status_code == 415
    assert httpx.get(f"{system.dashboard}/setup/positions").status_code == 404
    assert httpx.get(f"{system.dashboard}/setup/cameras/view1/positions").status_code == 404


def _pets(system: System, data_folder: Path) -> Path:
    """The shipped site beside the test's, with the published calibration."""
    file = system.folder / "published.yaml"
    site = yaml.safe_load(system.site_file.read_text())
    tsai = data_folder / "pets09-s2l1" / "maps" / "View_001.xml"
    site["cameras"][0]["geometry"] = {"kind": "tsai", "file": str(tsai)}
    file.write_text(yaml.safe_dump(site))
    return file


def _click(browser: WebDriver, side: str, place: Any) -> None:
    x, y = browser.execute_script(
        f"return cameraSetup.{side}.screenOf(arguments[0])", [float(value) for value in place]
    )
    canvas = browser.find_element(By.ID, f"setup-{side}")
    left, top = _corner(canvas)
    ActionChains(browser, duration=0).move_to_element_with_offset(
        canvas, round(x - left), round(y - top)
    ).click().perform()


def _corner(canvas: Any) -> tuple[float, float]:
    """The middle of an element, from which the driver counts."""
    return canvas.size["width"] / 2, canvas.size["height"] / 2


def _move_cross(canvas: Any, dx: float, dy: float) -> None:
    for keys, way in ((("ARROW_LEFT", "ARROW_RIGHT"), dx), (("ARROW_UP", "ARROW_DOWN"), dy)):
        key = getattr(Key, keys[way > 0])
        tens, ones = divmod(round(abs(way)), 10)
        canvas.send_keys(*[key] * tens)
        if ones:
            canvas.send_keys(Key.SHIFT, *[key] * ones)
    canvas.send_keys(Key.ENTER)


def _type(browser: WebDriver, label: str, value: float) -> None:
    field = browser.find_element(By.CSS_SELECTOR, f"input[aria-label='{label}']")
    field.send_keys(Key.CONTROL + "a" + Key.NULL, str(value), Key.TAB)


def _trial(browser: WebDriver, count: int, left_out: int | None = None) -> Any:
    told = browser.execute_script("return cameraSetup.state.trial")
    if told is None or len(told["pairs"]) != count:
        return None
    used = [pair["used"] for pair in told["pairs"]]
    return told if used == [row != left_out for row in range(count)] else None


def _slowed(browser: WebDriver) -> Any:
    return browser.execute_script("return slowed")


def _says(browser: WebDriver, words: str, place: str = "setup-say") -> None:
    wait_until(lambda: words in _content(browser, place), 20, words)


def _told(browser: WebDriver, words: str) -> None:
    wait_until(lambda: words in _content(browser, "setup-told"), 20, words)


def _content(browser: WebDriver, place: str) -> str:
    return str(browser.execute_script("return document.getElementById(arguments[0])?.textContent ?? ''", place))


def _found(browser: WebDriver, selector: str) -> Any:
    return next(iter(browser.find_elements(By.CSS_SELECTOR, selector)), None)


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=2).status_code in (200, 303)
    except httpx.HTTPError:
        return False
