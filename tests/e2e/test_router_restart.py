"""The router dies and comes back in the middle of a run: nothing crashes, work goes on, the gap is counted."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from waiting import wait_until

from services.cli.demo import Demo, Ports, find_site

pytestmark = pytest.mark.alone

ROUTER = """
import sys, threading
from shared.bus import router
session = router(sys.argv[1])
print("up", flush=True)
threading.Event().wait()
"""


def start_router(endpoint: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", ROUTER, endpoint], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "up\n"
    return process


@pytest.fixture
def hall(tmp_path: Path) -> Iterator[tuple[Demo, subprocess.Popen[str]]]:
    ports = Ports.free()
    endpoint = f"tcp/127.0.0.1:{ports.bus}"
    router = start_router(endpoint)
    demo = Demo(find_site("hall"), ports, folder=tmp_path, dashboard=False, endpoint=endpoint)
    demo.start(timeout=90)
    yield demo, router
    demo.stop()
    router.kill()


def newest(demo: Demo) -> float:
    """Time of measurement of the newest track the API knows."""
    return max((float(track["t"]) for track in demo.get("/v1/tracks")["tracks"]), default=0.0)


def ready(demo: Demo) -> list[bool]:
    specs = [*demo.others, *demo.cameras]
    return [httpx.get(f"http://127.0.0.1:{spec.health_port}/readyz").status_code == 200 for spec in specs]


def gaps(demo: Demo) -> float:
    (fusion,) = (spec for spec in demo.others if spec.name == "fusion")
    text = httpx.get(f"http://127.0.0.1:{fusion.health_port}/metrics").text
    lines = [
        line for line in text.splitlines() if line.startswith("atrium_bus_dropped_total") and 'reason="gap"' in line
    ]
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines)


def test_router_killed_and_restarted_during_the_run(hall: tuple[Demo, subprocess.Popen[str]]) -> None:
    demo, router = hall
    before = wait_until(lambda: newest(demo), 60, "tracks")
    wait_until(lambda: newest(demo) > before, 20, "tracks to go on")

    router.kill()
    router.wait()
    wait_until(lambda: not any(ready(demo)), 20, "every service to say it is not ready")
    stale = newest(demo)

    again = start_router(demo.endpoint)
    try:
        wait_until(lambda: all(ready(demo)), 30, "every service to be ready again")
        wait_until(lambda: newest(demo) > stale + 1.0, 30, "new tracks")
        wait_until(lambda: gaps(demo) > 0, 20, "the lost frames to be counted")
        assert all(demo.launcher.running().values())
        assert not any(demo.launcher.restarts.values()), "a service crashed"
    finally:
        demo.stop()  # before the router: a service says goodbye on the bus
        again.kill()
