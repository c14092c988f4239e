"""A real PostgreSQL server for a test, on a port of its own, which may go away and come back."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conftest import unused_port

DEBIAN = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)


def _program(name: str) -> str:
    found = shutil.which(name, path=os.pathsep.join([os.environ["PATH"], *map(str, DEBIAN)]))
    assert found is not None, f"{name} is missing: scripts/system-packages.sh installs it"
    return found


class PostgresServer:
    """A server whose files lie in ``folder``; whoever comes from this machine is let in."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = unused_port()
        # PostgreSQL refuses to run as root.
        self._user = "postgres" if os.geteuid() == 0 else None
        if self._user is not None:
            shutil.chown(folder, self._user)
        self.url = f"postgresql://postgres@127.0.0.1:{self._port}/postgres?connect_timeout=2"
        self._call("initdb", "-D", str(folder / "data"), "-U", "postgres", "-A", "trust", "--no-sync", "-E", "UTF8")

    def start(self) -> None:
        options = f"-p {self._port} -c listen_addresses=127.0.0.1 -c fsync=off -k {self._folder}"
        log = str(self._folder / "server.log")
        self._call("pg_ctl", "-D", str(self._folder / "data"), "-l", log, "-o", options, "-w", "-t", "30", "start")

    def stop(self) -> None:
        self._call("pg_ctl", "-D", str(self._folder / "data"), "-m", "immediate", "-w", "stop")

    def _call(self, name: str, *arguments: str) -> None:
        done = subprocess.run(
            [_program(name), *arguments],
            user=self._user,
            cwd=self._folder,
            stdout=subprocess.DEVNULL,  # the server would hold a pipe open
            stderr=subprocess.DEVNULL,
            timeout=60,
        )
        assert done.returncode == 0, f"{name}: {done.returncode}"


@contextmanager
def postgres() -> Iterator[PostgresServer]:
    """A server that runs when the block begins; it may be stopped and started, and is gone with the block."""
    # Not in tmp_path: its parents let nobody else in.
    folder = Path(tempfile.mkdtemp(prefix="atrium-postgres-"))
    try:
        server = PostgresServer(folder)
        server.start()
        try:
            yield server
        finally:
            subprocess.run(
                [_program("pg_ctl"), "-D", str(folder / "data"), "-m", "immediate", "stop"],
                user=server._user,
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=30,
            )
    finally:
        shutil.rmtree(folder, ignore_errors=True)
