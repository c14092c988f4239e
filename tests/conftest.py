"""Fixtures every test may use: free ports, a real router, the recordings."""

import os
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

ROOT = Path(__file__).resolve().parent.parent


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


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
