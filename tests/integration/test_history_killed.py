"""A history process that is killed loses nothing it had taken: the next one brings it into the database."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import httpx
from conftest import unused_port
from history_in_process import DEADLINE, Teller, ask
from history_world import NOON
from waiting import wait_until

from services.history.spool import Spool
from shared.bus import Bus
from shared.history_query import AskTrajectory, Trajectory, numbers


def start(project: Path, folder: Path, endpoint: str, write_every: float) -> "subprocess.Popen[bytes]":
    health = unused_port()
    settings = {
        "ATRIUM_SITE_FILE": str(project / "deploy/sites/hall/site.yaml"),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": f'["{endpoint}"]',
        "ATRIUM_HEALTH_PORT": str(health),
        "ATRIUM_HISTORY_DATABASE_URL": f"sqlite:///{folder / 'history.db'}",
        "ATRIUM_HISTORY_SPOOL": str(folder / "spool"),
        "ATRIUM_HISTORY_PHONE_DAYS": "3660",
        "ATRIUM_HISTORY_DETAIL_DAYS": "3660",
        "ATRIUM_HISTORY_WRITE_EVERY": str(write_every),
    }
    with (folder / "history.log").open("ab") as log:
        running = subprocess.Popen(
            [sys.executable, "-m", "services.history"], env={**os.environ, **settings}, stderr=log
        )
    url = f"http://127.0.0.1:{health}"

    def ready() -> bool:
        assert running.poll() is None, (folder / "history.log").read_text()
        try:
            return httpx.get(url + "/readyz").status_code == 200
        except httpx.TransportError:
            return False

    wait_until(ready, 30.0, "history to become ready")
    return running


def test_a_killed_process_loses_nothing(project: Path, tmp_path: Path, zenoh_router: str) -> None:
    with Bus([zenoh_router]) as bus:
        first = start(project, tmp_path, zenoh_router, write_every=300.0)
        try:
            teller = Teller(bus)
            teller.walk(0, 30)

            def on_disk() -> int:
                found = Spool(tmp_path / "spool", 10**9)
                return sum(len(found.read(path.name)[0]) for path in (tmp_path / "spool").glob("*.spool"))

            wait_until(lambda: on_disk() == 3 * 30, DEADLINE, "each second's positions and counts on disk")
        finally:
            first.send_signal(signal.SIGKILL)
            first.wait(5)
        teller.until_alone()
        following = start(project, tmp_path, zenoh_router, write_every=0.2)
        try:

            def stored() -> list[float]:
                way = ask(bus, AskTrajectory(device="d-1", since=NOON, until=NOON + 60.0))
                assert isinstance(way, Trajectory)
                return numbers(way.t).tolist()

            wait_until(lambda: stored() == [NOON + second for second in range(30)], DEADLINE, "all of the walk")
        finally:
            following.terminate()
            assert following.wait(8) == 0
        assert list((tmp_path / "spool").glob("*.spool")) == []
