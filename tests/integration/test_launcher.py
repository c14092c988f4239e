"""The launcher's promises: what ends is started again, what is stopped stops, and nobody outlives the launcher."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import unused_port
from health_page import get
from typer.testing import CliRunner
from waiting import wait_until

from services.cli.launcher import Launcher, LauncherError, ProcessSpec
from services.cli.main import app

SCRIPT = """
import sys, threading
from services.cli.launcher import Launcher, ProcessSpec
launcher = Launcher({"ATRIUM_SITE_FILE": sys.argv[1], "ATRIUM_PROFILE": "demo", "ATRIUM_BUS": '["tcp/127.0.0.1:1"]'})
launcher.start(ProcessSpec("geofence", "services.geofence", int(sys.argv[2])))
print(launcher.processes()["geofence"], flush=True)
threading.Event().wait()
"""


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A process nobody has waited for yet is not alive.
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


def test_services_do_not_outlive_a_launcher_that_is_killed(project: Path) -> None:
    site = project / "deploy" / "sites" / "hall" / "site.yaml"
    command = [sys.executable, "-c", SCRIPT, str(site), str(unused_port())]
    launcher = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert launcher.stdout is not None
    service = int(launcher.stdout.readline())
    assert alive(service)
    launcher.kill()
    launcher.wait()
    wait_until(lambda: not alive(service), 20, "the service to notice")


def test_a_process_that_dies_is_started_again(project: Path) -> None:
    site = project / "deploy" / "sites" / "hall" / "site.yaml"
    launcher = Launcher({"ATRIUM_SITE_FILE": str(site), "ATRIUM_PROFILE": "demo", "ATRIUM_BUS": '["tcp/127.0.0.1:1"]'})
    port = unused_port()
    launcher.start(ProcessSpec("geofence", "services.geofence", port))
    try:
        first = launcher.processes()["geofence"]
        os.kill(first, signal.SIGKILL)

        def again() -> bool:
            launcher.keep_running()
            return launcher.processes()["geofence"] != first and launcher.running()["geofence"]

        wait_until(again, 20, "the process to be started again")
        assert launcher.restarts == {"geofence": 1}
        wait_until(lambda: get(port, "/healthz")[0] == 200, 20, "its health page")
    finally:
        statuses = launcher.stop()
    assert statuses == {"geofence": 0}


def test_a_service_with_a_wrong_setting_is_told_with_its_last_words(tmp_path: Path) -> None:
    launcher = Launcher({"ATRIUM_SITE_FILE": str(tmp_path / "nowhere.yaml")})
    launcher.start(ProcessSpec("geofence", "services.geofence", unused_port()))
    try:
        with pytest.raises(LauncherError, match=r"nowhere\.yaml"):
            launcher.wait_ready(20)
    finally:
        launcher.stop()


@pytest.mark.parametrize("command", ["demo", "record"])
def test_a_recording_that_cannot_be_written_is_refused_before_anything_starts(command: str, tmp_path: Path) -> None:
    out = tmp_path / "no such folder" / "run.mcap"
    arguments = ["demo", "--free-ports", "--record", str(out)] if command == "demo" else ["record", str(out)]
    result = CliRunner().invoke(app, arguments, env={"COLUMNS": "500"})
    assert result.exit_code == 1
    assert "cannot be written" in result.output
    assert not out.parent.exists()


def test_a_site_file_with_a_mistake_ends_with_status_2_and_its_name(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_text("format: atrium-site/1\nsite: x\nfloors: []\nareas: []\n")
    result = CliRunner().invoke(app, ["site", str(path)], env={"COLUMNS": "500"})
    assert result.exit_code == 2
    assert "site.yaml: floors" in result.output.replace("\n", "")  # a narrow terminal breaks the line anywhere
