"""Does the live map stay smooth with a full museum on it, and how soon is it there? In a real, headless Chromium."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.unused_port import unused_port
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import TrackFrame
from shared.site import Site, load_site

__all__ = ["EXPERIMENT", "main"]

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / "deploy" / "sites" / "museum" / "site.yaml"
PEOPLE, PHONES, RATE = 300, 100, 5.0
"""People on one floor, how many of them have a located phone, and frames per second."""
SECONDS = 20.0
"""How long pictures are timed."""
VISITS = 5
"""Times the page is opened."""
WINDOW = (1400, 900)
CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"
PATIENCE = 60.0


def run(options: Options, progress: Progress) -> Figures:
    """Open the page several times, then time its pictures."""
    task = progress.add_task("visits", total=VISITS + 1)
    with _dashboard() as address, tempfile.TemporaryDirectory() as folder, _browser(Path(folder)) as browser:
        seen: list[float] = []
        painted: list[float] = []
        for _ in range(VISITS):
            browser.get("about:blank")
            browser.get(address)
            _until(lambda: browser.execute_script("return Boolean(window.atrium?.firstDrawn)"), "the map")
            seen.append(browser.execute_script("return atrium.firstDrawn"))
            painted.append(
                browser.execute_script(
                    "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN"
                )
            )
            progress.advance(task)
        _until(lambda: browser.execute_script("return atrium.tracks().length") == PEOPLE, f"{PEOPLE} people")
        browser.execute_script("window.since = performance.now(); atrium.frameTimes.length = 0")
        _until(lambda: browser.execute_script(f"return performance.now() - since > {1000 * SECONDS}"), "pictures")
        times = np.array(browser.execute_script("return atrium.frameTimes"), dtype=float)
        heard = browser.execute_script("return atrium.frames")
        progress.advance(task)
    if len(times) < SECONDS:
        raise ExperimentError(f"the map drew {len(times)} pictures in {SECONDS:g} s")
    return {
        "frame_p95_ms": float(np.percentile(times, 95)),
        "frame_p50_ms": float(np.percentile(times, 50)),
        "frame_p99_ms": float(np.percentile(times, 99)),
        "first_paint_s": float(np.median(seen)) / 1000.0,
        "first_contentful_paint_s": float(np.median(painted)) / 1000.0,
        "people": float(PEOPLE),
        "frames_heard": float(heard),
    }


@contextlib.contextmanager
def _dashboard() -> Iterator[str]:
    """Start a router, the API and the dashboard, and let people walk; yields the dashboard's address."""
    endpoint, api, port = f"tcp/127.0.0.1:{unused_port()}", unused_port(), unused_port()
    site = load_site(SITE)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")} | {
        "ATRIUM_SITE_FILE": str(SITE),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": json.dumps([endpoint]),
        "ATRIUM_API_PORT": str(api),
        "ATRIUM_API_URL": f"http://127.0.0.1:{api}",
        "ATRIUM_DASHBOARD_PORT": str(port),
    }
    session = router(endpoint)
    with contextlib.ExitStack() as stack:
        stack.callback(session.close)
        bus = stack.enter_context(Bus([endpoint]))
        stack.enter_context(_walking(bus, site))
        for module in ("api", "dashboard"):
            command = [sys.executable, "-m", f"services.{module}"]
            process = subprocess.Popen(
                command, env=environment, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            stack.callback(process.wait, 10)
            stack.callback(process.terminate)
        address = f"http://127.0.0.1:{port}"
        _until(lambda: _answers(address), "the dashboard")
        yield address


@contextlib.contextmanager
def _walking(bus: Bus, site: Site) -> Iterator[None]:
    """Publish the frames of people who walk to and fro on one floor."""
    area = site.areas[0]
    stopping = threading.Event()
    publisher = bus.publisher(Keys(site.site).tracks(area.id), TrackFrame, newest=True)
    x0, y0, x1, y1 = site.floor(area.floor).plan().outline.bounds
    rng = np.random.default_rng(0)
    start = rng.uniform((x0, y0), (x1, y1), (PEOPLE, 2))
    velocity = rng.normal(0.0, 0.7, (PEOPLE, 2))
    device = [f"d-{n:011x}" if n < PHONES else None for n in range(PEOPLE)]

    def walk() -> None:
        began = time.monotonic()
        number = 0
        while not stopping.wait(max(began + number / RATE - time.monotonic(), 0.0)):
            number += 1
            low, span = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
            places = _to_and_fro(start + velocity * (time.monotonic() - began) - low, span) + low
            publisher.publish(_frame(area.id, area.floor, number, places, velocity, device))

    thread = threading.Thread(target=walk, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join(5.0)


def _to_and_fro(ways: NDArray[np.float64], span: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ways, shape (n, 2), turned back at walls that stand at 0 and ``span``."""
    return span - np.abs(np.mod(ways, 2.0 * span) - span)


def _frame(
    area: str,
    floor: str,
    number: int,
    places: NDArray[np.float64],
    velocity: NDArray[np.float64],
    device: list[str | None],
) -> TrackFrame:
    count = len(device)
    return TrackFrame(
        t=time.time(),
        area=area,
        chunk=number,
        tracker="benchmark",
        track=list(range(1, count + 1)),
        floor=[floor] * count,
        x=places[:, 0].tolist(),
        y=places[:, 1].tolist(),
        covariance=[(0.09, 0.0, 0.09)] * count,
        vx=velocity[:, 0].tolist(),
        vy=velocity[:, 1].tolist(),
        state=["confirmed"] * count,
        device=device,
        probability=[0.97] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[]] * count,
        sources=[[]] * count,
        quality=[0.9] * count,
    )


@contextlib.contextmanager
def _browser(folder: Path) -> Iterator[Any]:
    """Open a headless Chromium."""
    try:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service
    except ImportError as error:
        raise ExperimentError("this experiment needs selenium: install the extra dev") from error
    for program in (CHROMIUM, DRIVER):
        if not Path(program).exists():
            raise ExperimentError(f"{program}: not there; this experiment needs Chromium and its driver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={folder}",
        f"--window-size={WINDOW[0]},{WINDOW[1]}",
    ):
        options.add_argument(flag)
    browser = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield browser
    finally:
        browser.quit()


def _answers(address: str) -> bool:
    try:
        with urlopen(address, timeout=2.0) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False


def _until(condition: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise ExperimentError(f"waited {PATIENCE:g} s in vain for {what}")
        time.sleep(0.2)


EXPERIMENT = Experiment(
    name="dashboard",
    question="Does the live map stay smooth with 300 people on one floor, and how soon is it there?",
    kind="speed",
    scenario="museum",
    seeds=False,
    run=run,
    made=(
        f"A router, the API and the dashboard as processes, and {PEOPLE} people ({PHONES} with a located phone) who "
        f"walk on one floor of the demo museum, told {RATE:g} times a second. A headless Chromium without a graphics "
        f"processor, {WINDOW[0]} × {WINDOW[1]}, opens the live map {VISITS} times: `first_paint_s` is the median time "
        "from the request until the floor plan is drawn (`first_contentful_paint_s`: until anything is). Then the time "
        f"between two drawn pictures is taken for {SECONDS:g} s, with trails, names and uncertainty on; the map aims "
        "at 30 pictures a second."
    ),
    at_most={"frame_p95_ms": 50.0, "first_paint_s": 2.0},
)


def main() -> int:
    """Run from the command line."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
