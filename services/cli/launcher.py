"""Start the services of a site as processes of this machine, keep them running, stop them all."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import httpx

from shared.runner import LAUNCHED

__all__ = ["Launcher", "LauncherError", "ProcessSpec"]

STOP_WITHIN = 6.0
RESTART_AFTER = (0.5, 1.0, 2.0, 5.0, 10.0)


class LauncherError(RuntimeError):
    """A process could not be started or did not become ready: the text names it and shows its last words."""


@dataclass(frozen=True)
class ProcessSpec:
    """One service process: its name here, its module, its settings as environment variables, its health port."""

    name: str
    module: str
    health_port: int
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass
class _Process:
    spec: ProcessSpec
    popen: subprocess.Popen[str] | None = None
    restarts: int = 0
    restart_at: float = 0.0
    last_words: list[str] = field(default_factory=list)


class Launcher:
    """Runs processes as a supervisor would: one that ends unasked is started again with growing pauses.

    Args:
        environment: what every process gets beside its own settings.
        log: called with (process name, line) for everything the processes print; must be quick.
        log_file: where all lines are kept as well.
    """

    def __init__(
        self,
        environment: Mapping[str, str],
        log: Callable[[str, str], None] = lambda name, line: None,
        log_file: Path | None = None,
    ) -> None:
        self._environment = dict(environment)
        self._log = log
        self._log_file: IO[str] | None = None
        if log_file is not None:
            log_file.parent.mkdir(parents=True, exist_ok=True)
            self._log_file = log_file.open("w", encoding="utf-8")
        self._processes: dict[str, _Process] = {}
        self._lock = threading.Lock()
        self._stopping = False

    @property
    def restarts(self) -> dict[str, int]:
        """How often each process had to be started again."""
        return {name: process.restarts for name, process in self._processes.items()}

    def start(self, spec: ProcessSpec) -> None:
        """Start one process."""
        process = self._processes[spec.name] = _Process(spec)
        self._spawn(process)

    def wait_ready(self, timeout: float, stopping: threading.Event | None = None) -> None:
        """Wait until every process answers ``/readyz`` with 200.

        Raises:
            LauncherError: one did not within ``timeout`` seconds, or ended with an error.
        """
        deadline = time.monotonic() + timeout
        waiting = list(self._processes.values())
        reason = ""
        while waiting and not (stopping and stopping.is_set()):
            self.keep_running()
            process = waiting[0]
            if process.restarts > 0:
                raise LauncherError(f"{process.spec.name} ended at start:\n  " + "\n  ".join(process.last_words[-8:]))
            ready, reason = _readiness(process.spec.health_port)
            if ready:
                waiting.pop(0)
            elif time.monotonic() > deadline:
                words = "\n  ".join(process.last_words[-8:])
                raise LauncherError(f"{process.spec.name} is not ready after {timeout:g} s: {reason}\n  {words}")
            else:
                (stopping or threading.Event()).wait(0.1)

    def keep_running(self) -> None:
        """Start again what ended unasked; call this now and then."""
        for process in self._processes.values():
            if self._stopping or process.popen is None:
                continue
            status = process.popen.poll()
            if status is None:
                continue
            if process.restart_at == 0.0:
                pause = RESTART_AFTER[min(process.restarts, len(RESTART_AFTER) - 1)]
                process.restarts += 1
                process.restart_at = time.monotonic() + pause
                self._write(process, f"ended with status {status}; starting again in {pause:g} s")
            elif time.monotonic() >= process.restart_at:
                self._spawn(process)

    def processes(self) -> dict[str, int]:
        """Return the process ids."""
        return {name: p.popen.pid for name, p in self._processes.items() if p.popen is not None}

    def running(self) -> dict[str, bool]:
        """Return which processes are running now."""
        return {name: p.popen is not None and p.popen.poll() is None for name, p in self._processes.items()}

    def stop(self) -> dict[str, int]:
        """Stop all processes, the latest started first, and return their exit statuses."""
        self._stopping = True
        processes = [p for p in reversed(self._processes.values()) if p.popen is not None]
        for process in processes:
            if process.popen is not None and process.popen.poll() is None:
                process.popen.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + STOP_WITHIN
        statuses = {}
        for process in processes:
            assert process.popen is not None  # noqa: S101 (filtered above)
            try:
                status = process.popen.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.popen.kill()
                status = process.popen.wait()
            # One that had not yet begun to listen to signals when it was told to stop has stopped as well.
            statuses[process.spec.name] = 0 if status == -signal.SIGTERM else status
        if self._log_file is not None:
            self._log_file.flush()
        return statuses

    def _spawn(self, process: _Process) -> None:
        spec = process.spec
        environment = {
            **os.environ,
            **self._environment,
            **spec.environment,
            "ATRIUM_HEALTH_PORT": str(spec.health_port),
            "PYTHONUNBUFFERED": "1",
            LAUNCHED: "1",
        }
        process.restart_at = 0.0
        process.popen = subprocess.Popen(  # noqa: S603 (our own modules)
            [sys.executable, "-m", spec.module],
            env=environment,
            stdin=subprocess.PIPE,  # never written to: its end tells the process that the launcher is gone
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # Ctrl-C reaches the launcher alone, which stops the others in order
        )
        threading.Thread(target=self._read, args=(process, process.popen), daemon=True).start()

    def _read(self, process: _Process, popen: subprocess.Popen[str]) -> None:
        assert popen.stdout is not None  # noqa: S101 (opened as a pipe)
        for line in popen.stdout:
            self._write(process, line.rstrip("\n"))

    def _write(self, process: _Process, line: str) -> None:
        process.last_words.append(line)
        del process.last_words[:-20]
        with self._lock:
            self._log(process.spec.name, line)
            if self._log_file is not None:
                self._log_file.write(f"{process.spec.name:<12} {line}\n")
                self._log_file.flush()


def _readiness(port: int) -> tuple[bool, str]:
    try:
        answer = httpx.get(f"http://127.0.0.1:{port}/readyz", timeout=2.0)
    except httpx.HTTPError:
        return False, "it does not answer yet"
    body = answer.json()
    problems = "; ".join(f"{topic}: {reason}" for topic, reason in body["problems"].items())
    return answer.status_code == 200, problems
