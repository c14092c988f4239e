"""docker-compose.yml cannot rot: its structure is checked, and every service is started by the very command and
environment written there, as a process of this machine."""

import os
import re
import shutil
import signal
import ssl
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import httpx
import pytest
import yaml
import zenoh
from certificates import make_certificate
from conftest import ROOT, unused_port
from waiting import wait_until

from shared.runner import STOP_WITHIN
from shared.site import load_site

COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if "build" in service}
PROCESSES = {name: service for name, service in OURS.items() if name != "migrate"}
DOCKERFILE = (ROOT / "deploy" / "Dockerfile").read_text(encoding="utf-8")
SECRETS = (
    "ATRIUM_ENROLMENT_KEY",
    "ATRIUM_TOKEN_KEY",
    "ATRIUM_ADDRESS_KEY",
    "ATRIUM_API_KEYS",
    "ATRIUM_API_KEY",
    "ATRIUM_DASHBOARD_PASSWORD",
)


def read_env(path: Path) -> dict[str, str]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


DEMO = read_env(ROOT / "deploy" / "demo.env")


def filled(value: str, variables: dict[str, str]) -> str:
    """Fill ``${NAME}`` and ``${NAME:-default}`` as docker-compose does."""
    return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", lambda m: variables.get(m[1]) or m[2] or "", value)


# ---- structure


@pytest.mark.parametrize("name", PROCESSES)
def test_every_service_is_watched_restarted_and_without_rights(name: str) -> None:
    service = PROCESSES[name]
    check = service["healthcheck"]["test"]
    assert check[:3] == ["CMD", "python", "-c"]
    assert f"{service['environment']['ATRIUM_HEALTH_PORT']}/readyz" in check[3]
    compile(check[3], "healthcheck", "exec")
    assert service["restart"] == "unless-stopped"
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    uid = str(service["user"]).split(":")[0]
    assert uid.isdigit()
    assert int(uid) > 0
    if name not in ("camera", "fusion"):  # sites extend these two, which docker-compose 1.29 refuses with depends_on
        assert service["depends_on"]["zenoh"] == {"condition": "service_healthy"}
    assert float(service["stop_grace_period"].removesuffix("s")) > STOP_WITHIN


@pytest.mark.parametrize("name", OURS)
def test_every_service_is_built_from_what_exists(name: str) -> None:
    service = OURS[name]
    target = service["build"]["target"]
    assert service["build"]["dockerfile"] == "deploy/Dockerfile"
    assert f"FROM runtime AS {target}\n" in DOCKERFILE
    extra = re.search(rf"FROM build AS {target}-packages\n(?:COPY .*\n)?RUN .*\[([a-z,]+)\]", DOCKERFILE)
    assert extra is not None
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(extra[1].split(",")) <= set(project["optional-dependencies"])
    if service["command"][0] == "python":
        assert service["command"][1] == "-m"
        assert find_spec(service["command"][2]) is not None
        assert find_spec(service["command"][2] + ".__main__") is not None
    else:
        assert service["command"][0] in project["scripts"]


def test_the_images_run_as_a_user_without_rights_and_keep_no_cache() -> None:
    assert re.search(r"^USER 10001:10001$", DOCKERFILE, re.M)
    assert "PIP_NO_CACHE_DIR=1" in DOCKERFILE
    installs = [line for line in DOCKERFILE.splitlines() if "pip install" in line]
    assert installs
    assert all("-c constraints.txt" in line for line in installs)


def test_every_service_of_the_project_is_in_the_file() -> None:
    modules = {path.parent.name for path in (ROOT / "services").glob("*/__main__.py")} - {"cli"}
    assert {service["command"][2].removeprefix("services.") for service in PROCESSES.values()} >= modules


def test_every_camera_and_area_of_the_demo_site_has_its_process() -> None:
    site = load_site(ROOT / DEMO["ATRIUM_SITE_FOLDER"] / "site.yaml")
    environments = [service["environment"] for service in PROCESSES.values()]
    cameras = {filled(env["ATRIUM_CAMERA"], DEMO) for env in environments if "ATRIUM_CAMERA" in env}
    areas = {filled(env["ATRIUM_AREA"], DEMO) for env in environments if "ATRIUM_AREA" in env}
    assert cameras == {camera.id for camera in site.cameras}
    assert areas == {area.id for area in site.areas}


def test_no_secret_stands_in_the_file_and_only_the_demo_has_known_ones() -> None:
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    assert "demo-" not in text
    assert "a demo key" not in text
    for name in SECRETS:
        assert re.search(rf"{name}: \${{{name}:-}}$", text, re.M), name
    assert {name: value for name, value in read_env(ROOT / ".env.example").items() if name in SECRETS} == dict.fromkeys(
        SECRETS, ""
    )
    assert DEMO["ATRIUM_PROFILE"] == "demo"
    assert "${ATRIUM_PROFILE:-production}" in text


def test_only_the_demo_has_the_simulator() -> None:
    assert [name for name, service in SERVICES.items() if service.get("profiles")] == ["simulator"]
    assert SERVICES["simulator"]["profiles"] == ["demo"]
    assert DEMO["COMPOSE_PROFILES"] == "demo"


@pytest.mark.parametrize("file", ["deploy/demo.env", ".env.example"])
def test_only_this_machine_reaches_the_published_ports_but_for_phones_that_come_by_https(file: str) -> None:
    variables = read_env(ROOT / file)
    open_to_all = set()
    for name, service in SERVICES.items():
        for port in service.get("ports", []):
            if not filled(port, variables).startswith("127.0.0.1:"):
                open_to_all.add(name)
    assert open_to_all == ({"gateway"} if variables.get("ATRIUM_TLS_CERTIFICATE") else set())


def test_the_router_is_pinned_to_the_version_the_services_speak() -> None:
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    library = re.search(r"^eclipse-zenoh==(\d+\.\d+)\.", constraints, re.M)
    assert library is not None
    assert SERVICES["zenoh"]["image"].startswith(f"eclipse/zenoh:{library[1]}.")


@pytest.mark.parametrize(
    "options",
    [[], ["--env-file", ".env.example"], ["--profile", "demo"], ["--env-file", "deploy/demo.env"]],
    ids=["bare", "production", "profile", "demo"],
)
def test_docker_compose_accepts_the_file(options: list[str], tmp_path: Path) -> None:
    if shutil.which("docker-compose") is None:
        if os.environ.get("CI") == "true":
            pytest.fail("CI must have docker-compose: scripts/system-packages.sh installs it")
        pytest.skip("needs docker-compose: scripts/system-packages.sh installs it")
    settings = tmp_path / "settings.env"
    settings.write_text("# what .env does not name\nATRIUM_RING_MINUTES=7\n", encoding="utf-8")
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "ATRIUM_SETTINGS_FILE": str(settings)}
    done = subprocess.run(
        ["docker-compose", *options, "config"], cwd=ROOT, capture_output=True, text=True, env=environment, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "variable is not set" not in done.stderr
    services = yaml.safe_load(done.stdout)["services"]
    assert services["api"]["command"] == SERVICES["api"]["command"]
    assert services["zenoh"]["image"] == SERVICES["zenoh"]["image"]
    assert all(services[name]["environment"]["ATRIUM_RING_MINUTES"] == "7" for name in ("camera", "gateway", "api"))
    if "deploy/demo.env" in options:
        assert services["api"]["environment"]["ATRIUM_PROFILE"] == "demo"
        assert "simulator" in services


def test_a_second_camera_is_added_as_the_documentation_says(tmp_path: Path) -> None:
    if shutil.which("docker-compose") is None:
        pytest.skip("needs docker-compose: scripts/system-packages.sh installs it")
    documented = (ROOT / "docs" / "site.md").read_text(encoding="utf-8")
    override = re.search(r"```yaml\n(services:\n.*?)```", documented, re.S)
    assert override is not None
    (tmp_path / "docker-compose.yml").write_text((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
    (tmp_path / "docker-compose.override.yml").write_text(override[1], encoding="utf-8")
    settings = str(ROOT / "deploy/settings.env")
    done = subprocess.run(
        ["docker-compose", "config"], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        env={"PATH": os.environ["PATH"], "HOME": str(tmp_path), "ATRIUM_SETTINGS_FILE": settings},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    services = yaml.safe_load(done.stdout)["services"]
    assert services["camera-stairs"]["command"] == SERVICES["camera"]["command"]
    assert services["camera-stairs"]["environment"]["ATRIUM_CAMERA"] == "stairs"
    assert services["camera-stairs"]["environment"]["ATRIUM_BUS"] == services["camera"]["environment"]["ATRIUM_BUS"]


# ---- every service, started by what stands in the file


@dataclass
class Host:
    """This machine in the place of the container network: where ports, hosts and folders of the file lie here."""

    folder: Path
    variables: dict[str, str]
    ports: dict[str, int] = field(default_factory=dict)

    def port(self, container_port: str) -> int:
        """All containers' ports are one machine's here; two services never use the same, except for health."""
        return self.ports.setdefault(container_port, unused_port())

    def folders(self, service: dict[str, Any]) -> dict[str, str]:
        places = {}
        for volume in service.get("volumes", []):
            source, target = filled(volume, self.variables).split(":")[:2]
            here = ROOT / source if source.startswith((".", "/")) else self.folder / source
            if not source.startswith((".", "/")):
                here.mkdir(exist_ok=True)
            places[target] = str(here.resolve())
        return places

    def environment(self, service: dict[str, Any], health_port: int) -> dict[str, str]:
        places = self.folders(service)
        environment = {}
        for name, raw in service["environment"].items():
            value = filled(str(raw), self.variables)
            if name == "ATRIUM_HEALTH_PORT":
                value = str(health_port)
            elif name.endswith("_PORT"):
                value = str(self.port(value))
            elif name.endswith("_HOST"):
                value = "127.0.0.1"
            else:
                hosts = "|".join(SERVICES)
                value = re.sub(rf"\b(?:{hosts}):(\d+)", lambda m: f"127.0.0.1:{self.port(m[1])}", value)
                for target, here in places.items():
                    value = re.sub(rf"(?<=/){target}(?=/)|^{target}(?=/|$)", here, value)
            environment[name] = value
        return environment

    def start(self, name: str, health_port: int) -> "subprocess.Popen[bytes]":
        service = OURS[name]
        program, *arguments = service["command"]
        here = sys.executable if program == "python" else str(Path(sys.executable).with_name(program))
        work = self.folder / f"work-{name}"
        work.mkdir(exist_ok=True)
        keep = {key: os.environ[key] for key in ("PATH", "LANG", "LC_ALL") if key in os.environ}
        with (self.folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [here, *arguments],
                cwd=work,  # never the checkout: in the image there is none
                env={**keep, "HOME": str(work), **self.environment(service, health_port)},
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace")[-3000:]


def status_of(url: str) -> int:
    try:
        with urlopen(url, timeout=2) as reply:
            return int(reply.status)
    except HTTPError as refusal:
        return refusal.code
    except OSError:
        return 0


@pytest.fixture
def host(tmp_path: Path) -> Host:
    return Host(tmp_path, DEMO)


@pytest.fixture
def configured_router(host: Host) -> Iterator[None]:
    """A router with the very configuration the router's container mounts, on a free port."""
    mounted = dict(volume.split(":")[:2] for volume in SERVICES["zenoh"]["volumes"])
    source = next(here for here, there in mounted.items() if there == SERVICES["zenoh"]["command"][1])
    config = zenoh.Config.from_file(str(ROOT / source))
    listening = config.get_json("listen/endpoints")
    assert "tcp/0.0.0.0:7447" in listening
    assert config.get_json("scouting/multicast/enabled") == "false"
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{host.port("7447")}"]')
    session = zenoh.open(config)
    yield
    session.close()  # type: ignore[no-untyped-call]


@pytest.mark.slow
@pytest.mark.usefixtures("configured_router")
def test_every_service_gets_ready_by_the_command_in_the_file_and_stops_when_told(host: Host) -> None:
    migrate = host.start("migrate", 0)
    assert migrate.wait(timeout=60) == 0, host.log("migrate")
    health = {name: unused_port() for name in PROCESSES}
    running = {name: host.start(name, port) for name, port in health.items()}
    try:
        for name, port in health.items():

            def ready(name: str = name, port: int = port) -> bool:
                assert running[name].poll() is None, f"{name} ended by itself:\n{host.log(name)}"
                return status_of(f"http://127.0.0.1:{port}/readyz") == 200

            try:
                wait_until(ready, 90.0, f"{name} to be ready")
            except AssertionError as error:
                raise AssertionError(f"{error}\n{host.log(name)}") from error
        for name, service in PROCESSES.items():
            for published in service.get("ports", []):
                port = host.port(published.rsplit(":", 1)[1])
                assert 200 <= status_of(f"http://127.0.0.1:{port}/") < 500, f"{name}: nobody serves port {published}"
        for name, process in running.items():
            begin = time.monotonic()
            process.send_signal(signal.SIGTERM)
            assert process.wait(timeout=10) == 0, f"{name}:\n{host.log(name)}"
            assert time.monotonic() - begin < STOP_WITHIN, f"{name} took {time.monotonic() - begin:.1f} s to stop"
    finally:
        for process in running.values():
            if process.poll() is None:
                process.kill()
                process.wait()


def test_in_a_museum_phones_reach_the_gateway_by_https_with_the_mounted_certificate(
    tmp_path: Path, zenoh_router: str
) -> None:
    (tmp_path / "tls").mkdir()
    certificate = make_certificate(tmp_path / "tls", "fullchain.pem", "privkey.pem")
    secrets = {name: f"a secret of this museum, {name}".replace(",", "") for name in SECRETS}
    variables = read_env(ROOT / ".env.example") | secrets
    variables |= {"ATRIUM_SITE_FOLDER": "./deploy/sites/hall", "ATRIUM_TLS_FOLDER": str(tmp_path / "tls")}
    host = Host(tmp_path, variables)
    host.ports["7447"] = int(zenoh_router.rsplit(":", 1)[1])
    assert host.start("migrate", 0).wait(timeout=60) == 0, host.log("migrate")
    health = unused_port()
    gateway = host.start("gateway", health)
    try:

        def ready() -> bool:
            assert gateway.poll() is None, host.log("gateway")
            return status_of(f"http://127.0.0.1:{health}/readyz") == 200

        wait_until(ready, 30.0, "the gateway to be ready")
        body = {"enrolment_key": secrets["ATRIUM_ENROLMENT_KEY"], "consent": True}
        trusting = ssl.create_default_context(cafile=str(certificate))
        answer = httpx.post(f"https://127.0.0.1:{host.port('8080')}/v1/devices", json=body, verify=trusting)
        assert answer.status_code == 201, answer.text
        with pytest.raises(httpx.HTTPError):
            httpx.post(f"http://127.0.0.1:{host.port('8080')}/v1/devices", json=body)
    finally:
        gateway.kill()


@pytest.mark.parametrize("name", ["gateway", "api", "dashboard"])
def test_without_secrets_of_your_own_production_refuses_to_start(tmp_path: Path, name: str) -> None:
    variables = read_env(ROOT / ".env.example") | {"ATRIUM_SITE_FOLDER": "./deploy/sites/hall"}
    host = Host(tmp_path, variables)
    process = host.start(name, unused_port())
    try:
        assert process.wait(timeout=30) == 2, host.log(name)
    finally:
        process.kill()
    assert any(f"ATRIUM_{secret}" in host.log(name) for secret in ("ENROLMENT_KEY", "API_KEY", "DASHBOARD_PASSWORD"))
