"""``atrium demo``: a whole site on this machine, one process per service, with a router inside the launcher."""

from __future__ import annotations

import json
import shutil
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from services.cli.launcher import Launcher, LauncherError, ProcessSpec
from shared.bus import router
from shared.settings import data_folder
from shared.site import load_site

__all__ = ["Demo", "Ports", "find_site", "shipped_sites"]

SITES = Path(__file__).resolve().parent.parent.parent / "deploy" / "sites"
API_KEY = "demo-api-key"


@dataclass(frozen=True)
class Ports:
    """Where the demo listens on 127.0.0.1."""

    bus: int = 7447
    gateway: int = 8080
    api: int = 8081
    dashboard: int = 8082
    video: int = 8090

    @classmethod
    def free(cls) -> Ports:
        """Return ports nobody uses now."""
        return cls(*_free_ports(5))

    def taken(self) -> list[str]:
        """Return which of these ports somebody else listens on."""
        return [f"{name} port {port}" for name, port in vars(self).items() if not _is_free(port)]


def shipped_sites() -> list[str]:
    """Return the names of the sites that come with the project."""
    return sorted(folder.parent.name for folder in SITES.glob("*/site.yaml"))


def find_site(name: str) -> Path:
    """Return the site file meant by ``name``: a shipped site's name, a site file, or a folder that holds site.yaml.

    Raises:
        LauncherError: there is no such site.
    """
    path = Path(name)
    for candidate in (SITES / name / "site.yaml", path / "site.yaml", path):
        if candidate.is_file():
            return candidate.resolve()
    raise LauncherError(f"--site {name}: no such site; shipped are {', '.join(shipped_sites())}, or name a site file")


class Demo:
    """The processes of one site, started in the order in which they need each other.

    The site's folder may hold ``scenario.yaml``: what the simulator plays, phones and cameras. Cameras of which it
    makes the detections have no process of their own. Without it only the site's real cameras run.

    Args:
        site_file: the site.
        ports: where to listen.
        log: called with (process, line) for everything printed.
        folder: where the log and the demo's database are kept; ``var/demo`` by default.
        dashboard: whether to start the live map.
        endpoint: a router that runs already; by default one is opened inside this process.
    """

    def __init__(
        self,
        site_file: Path,
        ports: Ports,
        log: Callable[[str, str], None] = lambda name, line: None,
        folder: Path | None = None,
        *,
        dashboard: bool = True,
        endpoint: str | None = None,
    ) -> None:
        self.site_file = site_file
        self.ports = ports
        self.endpoint = endpoint or f"tcp/127.0.0.1:{ports.bus}"
        self._dashboard = dashboard
        self._folder = (folder or Path("var") / "demo").resolve()
        self._folder.mkdir(parents=True, exist_ok=True)
        self.log_file = self._folder / f"{site_file.parent.name}.log"
        environment = {
            "ATRIUM_SITE_FILE": str(site_file),
            "ATRIUM_PROFILE": "demo",
            "ATRIUM_BUS": json.dumps([self.endpoint]),
            "ATRIUM_DATA": str(data_folder()),
            "ATRIUM_SIMULATOR_PORT": str(ports.video),
        }
        self.site = load_site(site_file)
        self.launcher = Launcher(environment, log, self.log_file)
        self._router = None if endpoint else router(self.endpoint)
        self.cameras, self.others = self._plan()

    @property
    def dashboard_url(self) -> str:
        """The live map."""
        return f"http://127.0.0.1:{self.ports.dashboard}"

    @property
    def api_url(self) -> str:
        """The API for staff."""
        return f"http://127.0.0.1:{self.ports.api}"

    @property
    def gateway_url(self) -> str:
        """Where phones post."""
        return f"http://127.0.0.1:{self.ports.gateway}"

    def start(self, timeout: float = 60.0, stopping: threading.Event | None = None) -> None:
        """Start everything; cameras last, so that nobody misses the first frame.

        Raises:
            LauncherError: a service does not become ready.
        """
        for spec in self.others:
            self.launcher.start(spec)
        self.launcher.wait_ready(timeout, stopping)
        for spec in self.cameras:
            self.launcher.start(spec)
        self.launcher.wait_ready(timeout, stopping)

    def get(self, path: str) -> dict[str, Any]:
        """Return what the API says, decoded."""
        answer = httpx.get(self.api_url + path, headers={"Authorization": f"Bearer {API_KEY}"}, timeout=5.0)
        answer.raise_for_status()
        body: dict[str, Any] = answer.json()
        return body

    def stop(self) -> dict[str, int]:
        """Stop all processes and the router; return the processes' exit statuses."""
        statuses = self.launcher.stop()
        if self._router is not None:
            self._router.close()  # type: ignore[no-untyped-call]
        return statuses

    def _plan(self) -> tuple[list[ProcessSpec], list[ProcessSpec]]:
        database = self._folder / f"{self.site.site}.db"
        kept = self._folder / f"{self.site.site}-api.db"
        models = self._folder / f"{self.site.site}-learning.db"
        past = self._folder / f"{self.site.site}-history"
        # For a fusion that is killed in mid-run; who was about in the demo before is nobody's business now.
        state = self._folder / f"{self.site.site}-state"
        shutil.rmtree(state, ignore_errors=True)
        state.mkdir(parents=True)
        scenario_file = self.site_file.parent / "scenario.yaml"
        played: set[str] = set()
        wanted: list[tuple[str, str, dict[str, str]]] = [
            (
                "gateway",
                "services.gateway",
                {"ATRIUM_GATEWAY_PORT": str(self.ports.gateway), "ATRIUM_DATABASE_URL": f"sqlite:///{database}"},
            ),
            *(
                (
                    f"fusion-{area.id}" if len(self.site.areas) > 1 else "fusion",
                    "services.fusion",
                    # Cameras start last: for the first seconds their silence is no news.
                    {
                        "ATRIUM_AREA": area.id,
                        "ATRIUM_SILENT_AFTER": "15",
                        "ATRIUM_STATE_FOLDER": str(state),
                    },
                )
                for area in self.site.areas
            ),
            ("geofence", "services.geofence", {"ATRIUM_STATE_FOLDER": str(state)}),
            ("learning", "services.learning", {"ATRIUM_LEARNING_DATABASE_URL": f"sqlite:///{models}"}),
            (
                "history",
                "services.history",
                {
                    "ATRIUM_HISTORY_DATABASE_URL": f"sqlite:///{past}.db",
                    "ATRIUM_HISTORY_SPOOL": str(past.with_name(past.name + "-spool")),
                },
            ),
            (
                "api",
                "services.api",
                {"ATRIUM_API_PORT": str(self.ports.api), "ATRIUM_API_DATABASE_URL": f"sqlite:///{kept}"},
            ),
        ]
        if self._dashboard:
            settings = {"ATRIUM_DASHBOARD_PORT": str(self.ports.dashboard), "ATRIUM_API_URL": self.api_url}
            wanted.append(("dashboard", "services.dashboard", settings))
        if scenario_file.is_file():
            settings = {"ATRIUM_GATEWAY_URL": self.gateway_url, "ATRIUM_VIDEO_PORT": str(self.ports.video)}
            wanted.append(("simulator", "services.simulator", settings))
            played = _cameras_without_pictures(scenario_file, self.site_file)
        cameras = [
            (f"camera-{camera.id}", "services.camera", {"ATRIUM_CAMERA": camera.id})
            for camera in self.site.cameras
            if camera.id not in played
        ]
        health_ports = iter(_free_ports(len(wanted) + len(cameras)))
        others_specs = [ProcessSpec(name, module, next(health_ports), env) for name, module, env in wanted]
        camera_specs = [ProcessSpec(name, module, next(health_ports), env) for name, module, env in cameras]
        return camera_specs, others_specs


def _cameras_without_pictures(scenario_file: Path, site_file: Path) -> set[str]:
    # Only a site with a scenario needs the simulator's libraries.
    from services.simulator.scenario_loading import ScenarioError, load_scenario
    from services.simulator.world import cameras_without_pictures

    try:
        return cameras_without_pictures(*load_scenario(scenario_file, site_file))
    except ScenarioError as error:
        raise LauncherError(str(error)) from error


def _free_ports(count: int) -> list[int]:
    probes = [socket.socket() for _ in range(count)]
    try:
        for probe in probes:
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in probes]
    finally:
        for probe in probes:
            probe.close()


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
