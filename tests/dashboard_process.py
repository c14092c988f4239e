"""The dashboard as a process of its own, before a double of the API."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import api_double
import httpx
from conftest import unused_port
from waiting import wait_until

from shared.bus import router
from shared.site import load_site


@contextmanager
def dashboard(project: Path, folder: Path) -> Iterator[tuple[str, api_double.Double]]:
    """Yield the dashboard's address and the API's double."""
    site_file = project / "deploy/sites/hall/site.yaml"
    endpoint, api, port = f"tcp/127.0.0.1:{unused_port()}", unused_port(), unused_port()
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ATRIUM_")}
    environment.pop("PYTEST_CURRENT_TEST", None)  # NiceGUI behaves differently under it
    environment |= {
        "PYTHONPATH": str(project),
        "ATRIUM_SITE_FILE": str(site_file),
        "ATRIUM_PROFILE": "demo",
        "ATRIUM_BUS": f'["{endpoint}"]',
        "ATRIUM_DASHBOARD_PORT": str(port),
        "ATRIUM_API_URL": f"http://127.0.0.1:{api}",
        "ATRIUM_API_KEY": api_double.KEY,
    }
    session = router(endpoint)
    with api_double.running(load_site(site_file), api) as double, (folder / "dashboard.log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "services.dashboard"], env=environment, stdout=log, stderr=log
        )
        try:
            wait_until(lambda: _answers(f"http://127.0.0.1:{port}"), 40, "the dashboard")
            yield f"http://127.0.0.1:{port}", double
        finally:
            process.terminate()
            process.wait(10)
    session.close()  # type: ignore[no-untyped-call]


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=2).status_code in (200, 303)
    except httpx.HTTPError:
        return False
