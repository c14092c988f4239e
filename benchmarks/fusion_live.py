"""Fusion as a process on a real router, under a load: when which tracks came of which detections; its memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import zenoh
from numpy.typing import NDArray

from benchmarks.experiment import ExperimentError
from benchmarks.fusion_load import LoadFile, Said, Sent
from benchmarks.unused_port import unused_port
from services.cli.launcher import Launcher, LauncherError, ProcessSpec
from shared.bus import router
from shared.keys import Keys
from shared.messages import ChunkMark, decode

__all__ = ["Latency", "LiveRun", "latency_of", "memory_slope", "processor_seconds", "resident_mb", "run_live"]

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[1]
READY_WITHIN = 60.0
QUIET = 1.0
"""Seconds without a chunk after which a load is consumed."""
LOOK_EVERY = 0.5


@dataclass(frozen=True, slots=True)
class LiveRun:
    """What was seen of one load.

    Attributes:
        sent: what the generator sent.
        marks: of every chunk, in order.
        tracks: wall-clock receipt of each track frame by its chunk's number.
        memory: (n, 2), event time since the first chunk, s, and the process' resident memory then, MB.
        cpu_share: of one core that fusion used from the load's beginning to its end.
        waited_share: of that time in which it had work and no core was free; a busy machine spoils latencies.
    """

    sent: Sent
    marks: Sequence[ChunkMark]
    tracks: dict[int, float]
    memory: Array
    cpu_share: float
    waited_share: float


@dataclass(frozen=True, slots=True)
class Latency:
    """From each detection message to the receipt of the tracks of the chunk that contains it.

    Attributes:
        seconds: (n,) by message, in the order in which they were sent; infinite where nothing came of it.
        closing: (m,) the same from the last message of each chunk; ``closing_sent``: (m,) when that was sent.
    """

    seconds: Array
    closing: Array
    closing_sent: Array

    @property
    def drop_share(self) -> float:
        """Share of messages nothing came of."""
        return float(np.mean(~np.isfinite(self.seconds)))


def latency_of(run: LiveRun) -> Latency:
    """Join what was sent with what came of it, by the trace ids in the chunk marks."""
    at = {trace: place for place, trace in enumerate(run.sent.trace)}
    seconds = np.full(len(at), np.inf)
    last: list[tuple[float, float]] = []
    for mark in run.marks:
        received = run.tracks.get(mark.chunk)
        places = [at[trace] for trace in mark.consumed if trace in at]
        if received is None or not places:
            continue
        passed = received - np.array([run.sent.sent[place] for place in places])
        seconds[places] = passed
        last.append((float(passed.min()), received - float(passed.min())))
    closing = np.array(last).reshape(-1, 2)
    return Latency(seconds, closing[:, 0], closing[:, 1])


def memory_slope(memory: Array) -> float:
    """Return how resident memory (n, 2) grows over the second half of a run, MB per hour of event time."""
    late = memory[memory[:, 0] >= 0.5 * memory[-1, 0]]
    return float(np.polyfit(late[:, 0] / 3600.0, late[:, 1], 1)[0])


def run_live(
    site_file: Path,
    site: str,
    area: str,
    arrivals: Sequence[tuple[float, Said]],
    *,
    progress: Callable[[float], None] = lambda seconds: None,
    **load: Any,
) -> LiveRun:
    """Send a load through the bus to a fusion process with the defaults that ship, and return what was seen.

    Args:
        site_file: the site; ``site`` and ``area``: their ids.
        site: see above.
        area: see above.
        arrivals: (time, message) in order.
        progress: called with the event time passed, seconds.
        load: more of ``LoadFile``.

    Raises:
        ExperimentError: a process did not start or ended early.
    """
    endpoint, keys, heard = f"tcp/127.0.0.1:{unused_port()}", Keys(site), _Heard()
    memory: list[tuple[float, float]] = []
    words: deque[str] = deque(maxlen=10)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        session = stack.enter_context(router(endpoint))
        session.declare_subscriber(keys.chunks(area), heard.mark)
        session.declare_subscriber(keys.tracks(area), heard.track)
        launcher = Launcher(
            {"ATRIUM_BUS": f'["{endpoint}"]', "ATRIUM_SITE_FILE": str(site_file), "ATRIUM_PROFILE": "demo"},
            lambda name, line: words.append(line),
        )
        stack.callback(launcher.stop)
        settings = {"ATRIUM_AREA": area, "ATRIUM_LOG_LEVEL": "warning", "ATRIUM_STATE_FOLDER": str(folder)}
        launcher.start(ProcessSpec("fusion", "services.fusion", unused_port(), settings))
        try:
            launcher.wait_ready(READY_WITHIN)
        except LauncherError as error:
            raise ExperimentError(str(error)) from error
        process = launcher.processes()["fusion"]
        todo, done = folder / "load.msgpack", folder / "sent.json"
        todo.write_bytes(msgspec.msgpack.encode(LoadFile.of(endpoint, site, area, arrivals, **load)))
        begin, used, waited = time.monotonic(), processor_seconds(process), _waited_seconds(process)
        command = [sys.executable, "-m", "benchmarks.fusion_load", str(todo), str(done)]
        with subprocess.Popen(command, cwd=ROOT) as generator:
            stack.callback(generator.kill)
            while generator.poll() is None or time.time() - heard.last < QUIET:
                time.sleep(LOOK_EVERY)
                if not launcher.running()["fusion"]:
                    raise ExperimentError("fusion ended under the load:\n" + "\n".join(words))
                if heard.marks:
                    memory.append((heard.passed, resident_mb(process)))
                    progress(heard.passed)
        if generator.returncode:
            raise ExperimentError(f"the load generator failed with status {generator.returncode}")
        wall = time.monotonic() - begin
        share, waited = (processor_seconds(process) - used) / wall, (_waited_seconds(process) - waited) / wall
        sent = msgspec.json.decode(done.read_bytes(), type=Sent)
    return LiveRun(sent, heard.marks, heard.tracks, np.array(memory), share, waited)


class _Numbered(msgspec.Struct):
    """As much of a track frame as is looked at."""

    chunk: int


class _Heard:
    """What fusion published; filled in by Zenoh's threads."""

    def __init__(self) -> None:
        self.marks: list[ChunkMark] = []
        self.tracks: dict[int, float] = {}
        self.last = -np.inf

    def mark(self, sample: zenoh.Sample) -> None:
        """Keep a chunk mark."""
        self.marks.append(decode(sample.payload.to_bytes(), ChunkMark))
        self.last = time.time()

    def track(self, sample: zenoh.Sample) -> None:
        """Keep when the tracks of a chunk were received."""
        now = time.time()
        self.tracks[msgspec.json.decode(sample.payload.to_bytes(), type=_Numbered).chunk] = now

    @property
    def passed(self) -> float:
        """Event time since the first chunk, s."""
        return self.marks[-1].t - self.marks[0].t


def processor_seconds(process: int) -> float:
    """Return the processor time a process has used, s (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(process: int) -> float:
    """Return the resident memory of a process, MB (Linux)."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _waited_seconds(process: int) -> float:
    """Return how long a process' main thread has waited for a core, s (Linux); NaN where the kernel does not tell."""
    file = Path(f"/proc/{process}/schedstat")
    return int(file.read_text().split()[1]) / 1e9 if file.is_file() else float("nan")
