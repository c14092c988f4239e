"""One service as a process of its own, as in production."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
from conftest import unused_port
from waiting import wait_until


@contextmanager
def process(module: str, folder: Path, endpoint: str, site: Path, **environment: str) -> Iterator[str]:
    """Run one service until the block ends; yields the URL of its health pages. It must stop cleanly.

    Its log is ``folder / MODULE.log``, with ``-AREA`` where ATRIUM_AREA is set.
    """
    name = "-".join(filter(None, [module, environment.get("ATRIUM_AREA")]))
    health = unused_port()
    settings = {
        "ATRIUM_SITE_FILE": str(site),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": f'["{endpoint}"]',
        "ATRIUM_HEALTH_PORT": str(health),
        "ATRIUM_DATABASE_URL": f"sqlite:///{folder / 'atrium.db'}",
        **environment,
    }
    with (folder / f"{name}.log").open("w") as output:
        running = subprocess.Popen([sys.executable, "-m", module], env={**os.environ, **settings}, stderr=output)
        try:
            url = f"http://127.0.0.1:{health}"
            wait_until(lambda: _ready(url) or running.poll() is not None, 30, f"{module} to become ready")
            yield url
        finally:
            running.terminate()
            status = running.wait(timeout=8)
    assert status == 0, (folder / f"{name}.log").read_text()


def _ready(url: str) -> bool:
    try:
        return httpx.get(url + "/readyz").status_code == 200
    except httpx.TransportError:
        return False
