"""Fixtures every test may use: free ports, a real router, the recordings; and what lets tests run side by side."""

import itertools
import os
import random
import socket
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from shared.bus import router
from shared.settings import data_folder as configured_data_folder

# In CI the same examples every time: a submission is not to fail on what another one brought in.
hypothesis.settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI") == "true":
    hypothesis.settings.load_profile("ci")

# Tests and the processes they start are as many as there are cores: more threads each only stand in the others' way.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent

PORTS_EACH = 500
_next_port = itertools.count(random.randrange(PORTS_EACH))


def unused_port() -> int:
    """A port that nobody has now and no other worker's tests will take.

    Below those the system gives to whoever asks for any: between this look and its use nobody gets it by chance.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    first = 12_000 + PORTS_EACH * (worker % 40)
    for _ in range(PORTS_EACH):
        port = first + next(_next_port) % PORTS_EACH
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise RuntimeError(f"no port from {first} to {first + PORTS_EACH - 1} is free")


@pytest.fixture
def free_port() -> int:
    return unused_port()


@pytest.fixture
def zenoh_router() -> Iterator[str]:
    """The endpoint of a real Zenoh router that lives as long as the test."""
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    session = router(endpoint)
    yield endpoint
    session.close()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings; absent, the test is skipped, but never in CI."""
    folder = configured_data_folder()
    if not folder.is_dir():
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must have the recordings, ATRIUM_DATA={folder} is no folder")
        pytest.skip(f"needs the recordings: set ATRIUM_DATA (now {folder}) to their folder")
    return folder


@pytest.fixture(scope="session")
def project() -> Path:
    return ROOT
