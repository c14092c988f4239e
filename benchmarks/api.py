"""How fast does the API answer, and how late do its streams come? Against a server that only sends the same bytes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import httpx
import numpy as np
from rich.progress import Progress

from benchmarks.api_load import Load
from benchmarks.bare_body import PLAIN
from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.http_askers import Answers
from benchmarks.unused_port import unused_port
from services.api.settings import DEMO_KEY
from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import TrackFrame
from shared.site import load_site

__all__ = ["EXPERIMENT", "main"]

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / "deploy" / "sites" / "hall" / "site.yaml"
PEOPLE = 50
RATE = 5.0
"""Frames a second."""
ROUNDS = 5
SECONDS = 4.0
CONNECTIONS = 32
WARM_UP = 2.0
"""Seconds not counted."""
BY_CLOCK, CLOCK_SECONDS = 2000.0, 15.0
"""Requests a second."""
STREAMS, STREAM_SECONDS = 500, 15.0
READ, STREAM = "/v1/positions", "/v1/stream?kinds=tracks"


@dataclass(frozen=True, slots=True)
class _Servers:
    """Ports."""

    api: int
    bare: int


def run(options: Options, progress: Progress) -> Figures:
    """Measure both servers in turn, then the API by the clock, then its streams."""
    task = progress.add_task("rounds", total=3 * ROUNDS + 3)
    ours: list[Answers] = []
    theirs: list[Answers] = []
    plain: list[Answers] = []
    with _servers() as servers:
        for port in (servers.api, servers.bare):
            _send(Load("ask", port, READ, DEMO_KEY, WARM_UP, CONNECTIONS))
        progress.advance(task)
        for _ in range(ROUNDS):
            for port, path, outcomes in (
                (servers.bare, READ, theirs),
                (servers.api, READ, ours),
                (servers.bare, PLAIN, plain),
            ):
                outcomes.append(_send(Load("ask", port, path, DEMO_KEY, SECONDS, CONNECTIONS)))
                progress.advance(task)
        by_clock = _send(Load("ask", servers.api, READ, DEMO_KEY, CLOCK_SECONDS, CONNECTIONS, BY_CLOCK))
        progress.advance(task)
        streams = _send(Load("listen", servers.api, STREAM, DEMO_KEY, STREAM_SECONDS, STREAMS))
        progress.advance(task)
    return {
        "positions_ratio": float(np.median([o.per_second / t.per_second for o, t in zip(ours, theirs, strict=True)])),
        "positions_per_s": float(np.median([outcome.per_second for outcome in ours])),
        "bare_per_s": float(np.median([outcome.per_second for outcome in theirs])),
        "plain_per_s": float(np.median([outcome.per_second for outcome in plain])),
        "p50_ms": by_clock.p50_ms,
        "p99_ms": by_clock.p99_ms,
        "by_clock_per_s": by_clock.per_second,
        "stream_p50_ms": streams.p50_ms,
        "stream_p99_ms": streams.p99_ms,
        "stream_events_per_s": streams.per_second,
    }


def _send(load: Load) -> Answers:
    """Let a process of its own do what is asked of it.

    Raises:
        ExperimentError: something was refused.
    """
    command = [sys.executable, "-m", "benchmarks.api_load"]
    answer = subprocess.run(command, input=json.dumps(asdict(load)), capture_output=True, text=True, cwd=ROOT)
    if answer.returncode:
        raise ExperimentError(f"the load generator failed: {answer.stderr[-500:]}")
    outcome = Answers(**json.loads(answer.stdout))
    if set(outcome.status) != {"200"}:
        raise ExperimentError(f"{load.path}: not all were answered 200: {outcome.status}")
    return outcome


@contextlib.contextmanager
def _servers() -> Iterator[_Servers]:
    """Start a router, whoever tells tracks, the API and the bare server; each server is a process."""
    bus, port, health, bare = (unused_port() for _ in range(4))
    endpoint = f"tcp/127.0.0.1:{bus}"
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        stack.enter_context(router(endpoint))
        stack.enter_context(_tracks(endpoint))
        settings = {
            "SITE_FILE": str(SITE),
            "PROFILE": "demo",
            "BUS": json.dumps([endpoint]),
            "API_PORT": str(port),
            "HEALTH_PORT": str(health),
            "API_DATABASE_URL": f"sqlite:///{folder}/api.db",
            "LOG_LEVEL": "warning",
            "STREAM_READERS_OF_ONE": "1000",  # all with the demo's key
        }
        environment = os.environ | {f"ATRIUM_{name}": value for name, value in settings.items()}
        stack.enter_context(_process([sys.executable, "-m", "services.api"], environment))
        body = _body(f"http://127.0.0.1:{port}{READ}")
        kept = Path(folder) / "body.json"
        kept.write_bytes(body)
        with kept.open("rb") as source:
            stack.enter_context(_process([sys.executable, "-m", "benchmarks.bare_body", str(bare)], None, source))
        if _body(f"http://127.0.0.1:{bare}/") != body:
            raise ExperimentError("the bare server does not answer what it was given")
        yield _Servers(port, bare)


@contextlib.contextmanager
def _tracks(endpoint: str) -> Iterator[None]:
    """Tell where 50 people are, five times a second, stamped with the wall clock."""
    stopping = threading.Event()
    keys = Keys(load_site(SITE).site)
    with Bus([endpoint]) as bus:
        publisher = bus.publisher(keys.tracks("hall"), TrackFrame, newest=True)

        def tell() -> None:
            due, chunk = time.monotonic(), 0
            while not stopping.wait(max(0.0, due - time.monotonic())):
                publisher.publish(_frame(time.time(), chunk))
                due, chunk = due + 1.0 / RATE, chunk + 1

        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stopping.set()
            thread.join()


def _frame(now: float, chunk: int) -> TrackFrame:
    angle = np.linspace(0.0, 2.0 * np.pi, PEOPLE, endpoint=False) + 0.1 * chunk
    return TrackFrame(
        t=now,
        area="hall",
        chunk=chunk,
        tracker="benchmark",
        track=list(range(PEOPLE)),
        floor=["ground"] * PEOPLE,
        x=(10.0 + 5.0 * np.cos(angle)).tolist(),
        y=(6.0 + 5.0 * np.sin(angle)).tolist(),
        covariance=[(0.04, 0.01, 0.05)] * PEOPLE,
        vx=(-np.sin(angle)).tolist(),
        vy=np.cos(angle).tolist(),
        state=["confirmed"] * PEOPLE,
        device=[f"d-{number:04x}" for number in range(PEOPLE)],
        probability=[0.97] * PEOPLE,
        runner_up=[None] * PEOPLE,
        runner_up_probability=[0.0] * PEOPLE,
        former=[[] for _ in range(PEOPLE)],
        sources=[["hall-east"]] * PEOPLE,
        quality=[0.9] * PEOPLE,
    )


@contextlib.contextmanager
def _process(command: list[str], environment: dict[str, str] | None, source: object = None) -> Iterator[None]:
    process = subprocess.Popen(command, env=environment, cwd=ROOT, stdin=source)  # type: ignore[call-overload]
    try:
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()


def _body(url: str) -> bytes:
    """Return what a server answers once it knows where all are.

    Raises:
        ExperimentError: it did not within half a minute.
    """
    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        with contextlib.suppress(httpx.HTTPError):
            answer = httpx.get(url, headers={"X-API-Key": DEMO_KEY})
            if answer.status_code == 200 and len(answer.json()["positions"]) == PEOPLE:
                return answer.content
        time.sleep(0.05)
    raise ExperimentError(f"{url} does not answer")


EXPERIMENT = Experiment(
    name="api",
    question="How fast does the API answer where everybody is, and how late do its streams come?",
    kind="speed",
    scenario="50 people",
    run=run,
    seeds=False,
    made="""\
50 people with phones in one hall, told five times a second over a Zenoh router to one API process. `positions_ratio`:
requests for `/v1/positions` a second over 32 kept connections, against a route of FastAPI that answers the very same
bytes, made before, and does nothing else (no key, no state, no bus), under the same server and asked by the same
generator, a process of its own; they take turns, and it is the median over five rounds. `plain_per_s` is what the
server does where not even a framework stands between it and the bytes. `p50_ms` and `p99_ms` are of requests sent by
the clock, 2000 a second, from when each was due. `stream_p50_ms` and `stream_p99_ms` are of 500 readers of
`/v1/stream`: from when a frame was published to when the whole event was with a client, the way over the bus
included; an event that a client never got took for ever. Anything but an answer 200 ends the run. All on one machine:
generator, router and API share its cores, and a busy one spoils the times.""",
    at_least={"positions_ratio": 0.9},
    at_most={"p99_ms": 20.0, "stream_p99_ms": 250.0},
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
