"""The life of a process, watched from outside: a real service as a real process."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from conftest import unused_port
from health_page import get
from waiting import wait_until

from shared.bus import Bus, router
from shared.keys import Keys

TINY = Path(__file__).with_name("tiny_service.py")
Process = subprocess.Popen[str]
Start = Callable[..., tuple[Process, int]]


@pytest.fixture
def start(project: Path) -> Iterator[Start]:
    """Start the tiny service; its log is read at the end from ``stderr``."""
    processes: list[Process] = []

    def launch(endpoint: str, *flags: str, health_port: int | None = None) -> tuple[Process, int]:
        port = unused_port() if health_port is None else health_port
        site = str(project / "deploy" / "sites" / "hall" / "site.yaml")
        command = [sys.executable, str(TINY), "--site-file", site, "--bus", endpoint, "--health-port", str(port)]
        environment = {k: v for k, v in os.environ.items() if not k.startswith("ATRIUM_")}
        process = subprocess.Popen(
            [*command, *flags], stderr=subprocess.PIPE, text=True, cwd=project, env=environment | {"PYTHONPATH": "."}
        )
        processes.append(process)
        return process, port

    yield launch
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for(port: int, path: str, status: int) -> str:
    reply = wait_until(lambda: (found := get(port, path))[0] == status and found, 20.0, f"{path} to answer {status}")
    return reply[1]


def stop(process: Process, number: int = signal.SIGTERM) -> tuple[int, float, str]:
    """Send a signal; return exit status, seconds taken, log."""
    begin = time.monotonic()
    process.send_signal(number)
    _, log = process.communicate(timeout=10)
    return process.returncode, time.monotonic() - begin, log


def test_a_service_tells_its_health_and_its_metrics(start: Start, zenoh_router: str) -> None:
    process, port = start(zenoh_router, "--log-format", "json", "--instance", "7")
    ready = json.loads(wait_for(port, "/readyz", 200))
    assert ready == {"ready": True, "problems": {}}
    assert json.loads(wait_for(port, "/healthz", 200))["status"] == "alive"
    metrics = wait_for(port, "/metrics", 200)
    assert "atrium_bus_connected 1.0" in metrics
    assert "atrium_problems 0.0" in metrics
    assert "/readyz" in json.loads(wait_for(port, "/else", 404))["detail"]
    with Bus([zenoh_router], wait=5.0) as bus:
        alive = Keys("hall").alive("tiny", "7")
        wait_until(lambda: bus.present(Keys("hall").alive()) == [alive], 20.0, "its liveliness token")
        status, seconds, log = stop(process)
        assert status == 0
        assert seconds < 5.0
        wait_until(lambda: bus.present(Keys("hall").alive()) == [], 20.0, "its token to vanish")
    lines = [json.loads(line) for line in log.splitlines()]
    assert {line["service"] for line in lines} == {"tiny"}
    events = [line["event"] for line in lines]
    assert events[0] == "starting"
    assert events[-1] == "stopped"
    assert "stopping" in events


def test_a_problem_is_shown_in_plain_words_without_taking_the_service_out_of_work(
    start: Start, zenoh_router: str
) -> None:
    _, port = start(zenoh_router, "--behaviour", "ill")
    assert json.loads(wait_for(port, "/readyz", 200))["problems"] == {"camera": "the stream is silent"}
    assert "atrium_problems 1.0" in wait_for(port, "/metrics", 200)
    with Bus([zenoh_router], wait=5.0) as bus:
        key, told = next(bus.ask(Keys("hall").health()))
        assert key == Keys("hall").health("tiny", "0")
        assert json.loads(told) == {"camera": "the stream is silent"}


def test_a_service_without_a_router_is_alive_not_ready_and_gets_ready_when_one_comes(
    start: Start, free_port: int
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    process, port = start(endpoint)
    problems = json.loads(wait_for(port, "/readyz", 503))["problems"]
    assert problems["bus"] == f"no router at {endpoint}"
    assert get(port, "/healthz")[0] == 200
    first = router(endpoint)
    wait_for(port, "/readyz", 200)
    first.close()  # type: ignore[no-untyped-call]
    wait_for(port, "/readyz", 503)
    second = router(endpoint)
    wait_for(port, "/readyz", 200)
    second.close()  # type: ignore[no-untyped-call]
    status, seconds, _ = stop(process)
    assert (status, seconds < 5.0) == (0, True)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_service_that_waits_for_its_router_can_be_stopped(start: Start, free_port: int, number: int) -> None:
    process, port = start(f"tcp/127.0.0.1:{free_port}")
    wait_for(port, "/readyz", 503)
    status, seconds, log = stop(process, number)
    assert status == 0
    assert seconds < 5.0
    assert "Traceback" not in log


def test_a_service_that_hangs_is_gone_within_five_seconds_all_the_same(start: Start, zenoh_router: str) -> None:
    process, port = start(zenoh_router, "--behaviour", "hang")
    wait_for(port, "/readyz", 200)
    status, seconds, log = stop(process)
    assert status == 3
    assert seconds < 5.0
    assert "did not stop in time" in log


@pytest.mark.parametrize(
    ("behaviour", "told"), [("fail", "the camera fell off the wall"), ("crash", "ZeroDivisionError: by accident")]
)
def test_a_service_that_cannot_go_on_says_why_and_exits_with_one(
    start: Start, zenoh_router: str, behaviour: str, told: str
) -> None:
    process, _ = start(zenoh_router, "--behaviour", behaviour)
    _, log = process.communicate(timeout=20)
    assert process.returncode == 1
    assert told in log


def test_a_bad_site_file_is_one_message_and_exit_status_two(start: Start, zenoh_router: str, tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text("format: atrium-site/1\nsite: hall\nfloors:\n\t- id: ground\n")
    process, _ = start(zenoh_router, "--site-file", str(site))
    _, log = process.communicate(timeout=20)
    assert process.returncode == 2
    assert log.splitlines() == [
        f"tiny: {site}, line 4, column 1: not YAML: found character '\\t' that cannot start any token; "
        "indent with spaces"
    ]


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (["--log-level", "loud"], "tiny: log_level: .*'loud'.*--log-level or ATRIUM_LOG_LEVEL"),
        (["--site-file", "gone.yaml"], r"tiny: gone\.yaml: cannot be read: No such file"),
        (["--behaviour", "refuse"], "tiny: behaviour: 'refuse' does not fit site hall"),
    ],
)
def test_settings_that_cannot_work_are_refused_before_anything_opens(
    start: Start, free_port: int, flags: list[str], told: str
) -> None:
    process, _ = start(f"tcp/127.0.0.1:{free_port}", *flags)
    _, log = process.communicate(timeout=20)
    assert process.returncode == 2
    assert len(log.splitlines()) == 1
    assert re.match(told, log)


def test_a_taken_health_port_is_named_and_exit_status_one(start: Start, zenoh_router: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        process, _ = start(zenoh_router, health_port=port)
        _, log = process.communicate(timeout=20)
    assert process.returncode == 1
    assert f"health port 127.0.0.1:{port}: Address already in use" in log


def test_a_malformed_router_endpoint_is_named_and_exit_status_one(start: Start) -> None:
    process, _ = start("nonsense")
    _, log = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "cannot open a session to nonsense" in log


def test_a_service_begins_anew_in_its_process_with_another_site(start: Start, zenoh_router: str) -> None:
    process, port = start(zenoh_router, "--behaviour", "anew")
    wait_for(port, "/readyz", 200)
    told_now = {"second": "site set up anew"}  # what the first life complained of is forgotten
    wait_until(lambda: json.loads(get(port, "/healthz")[1])["problems"] == told_now, 10, "the second life")
    with Bus([zenoh_router]) as bus:
        keys = Keys("hall")
        wait_until(lambda: bus.present(keys.alive("tiny")) == [keys.alive("tiny", "0")], 10, "one token")
        ((_, told),) = bus.ask(keys.health("tiny"))
        assert json.loads(told) == told_now
    assert stop(process)[0] == 0
