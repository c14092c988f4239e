"""The ``atrium`` command line. Each command lives in a file of its own; here they only meet their options."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import httpx
import typer
from rich.console import Console
from rich.markup import escape

from services.cli import calibrate_lens as lens_command
from services.cli import history, models, staff
from services.cli import replay as player
from services.cli.demo import API_KEY, Demo, Ports, find_site
from services.cli.launcher import LauncherError
from services.cli.recorder import record as record_bus
from services.cli.recording import Recording, RecordingError, check_writable
from shared.bus import Bus, BusError
from shared.radio import RadioModelError
from shared.runner import ServiceError
from shared.settings import DEFAULT_ENDPOINT
from shared.site import SiteError, load_site
from shared.site.setup_file import read_setup, setup_path

__all__ = ["app", "main"]

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Who is where, in metres, now.")
app.add_typer(models.app, name="models")
app.add_typer(history.app, name="history")
app.add_typer(staff.app, name="staff")
console = Console(highlight=False)

SiteOption = Annotated[str, typer.Option("--site", help="a shipped site's name, a site file, or its folder")]
BusOption = Annotated[str, typer.Option("--bus", help="endpoint of the Zenoh router")]
SERVICES = ("api", "camera", "dashboard", "fusion", "gateway", "geofence", "history", "learning", "simulator")
ROUTER_WITHIN = 10.0
"""Seconds a command waits for the router it is told to use."""
QUIET = ("[info", "[debug")


@app.command()
def demo(
    site: SiteOption = "hall",
    seconds: Annotated[float | None, typer.Option(help="stop by itself after this long")] = None,
    free_ports: Annotated[bool, typer.Option("--free-ports", help="listen on any free ports")] = False,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="open the live map")] = False,
    record: Annotated[Path | None, typer.Option(help="also record the run into this MCAP file")] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="show everything the services log")] = False,
    dashboard: Annotated[bool, typer.Option("--dashboard/--no-dashboard", help="start the live map")] = True,
) -> None:
    """Start a whole site on this machine: services, router, simulated phones, live map. Ctrl-C stops all."""
    stopping = _stop_on_signals()

    def show(name: str, line: str) -> None:
        # While stopping, each service notices that the others leave: nothing to worry anybody with.
        if verbose or not (stopping.is_set() or any(mark in line for mark in QUIET)):
            console.print(f"[dim]{escape(name):<12}[/dim] {escape(line)}")

    running: Demo | None = None
    recording: threading.Thread | None = None
    status = 0
    try:
        site_file = find_site(site)
        if record is not None:
            check_writable(record)
        ports = Ports.free() if free_ports else Ports()
        if taken := ports.taken():
            raise LauncherError(f"in use already: {', '.join(taken)}; stop what listens there or add --free-ports")
        running = Demo(site_file, ports, show, dashboard=dashboard)
        with console.status(f"starting {running.site.name or running.site.site} …"):
            if record is not None:
                recording = _record_in_thread(running, record, stopping)
            running.start(stopping=stopping)
        if stopping.is_set():
            console.print("stopped before everything was up")
        else:
            _introduce(running, dashboard)
            if open_browser and dashboard:
                webbrowser.open(running.dashboard_url)
            _watch(running, stopping, seconds)
    except (LauncherError, RecordingError, SiteError, BusError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        status = 2 if isinstance(error, SiteError) else 1
    finally:
        stopping.set()
        if recording is not None:
            recording.join(timeout=10.0)
        if running is not None:
            with console.status("stopping …"):
                statuses = running.stop()
            failed = {name: code for name, code in statuses.items() if code != 0}
            if failed:
                console.print(f"[red]ended badly: {failed}[/red]")
                status = status or 1
            else:
                console.print("all services stopped")
    raise typer.Exit(status)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def run(
    context: typer.Context,
    service: Annotated[str, typer.Argument(help=f"one of {', '.join(SERVICES)}")],
) -> None:
    """Run one service in the foreground; what follows its name are its settings (try --help there)."""
    if service not in SERVICES:
        console.print(f"[red]{escape(service)}: no such service; allowed: {', '.join(SERVICES)}[/red]")
        raise typer.Exit(2)
    raise typer.Exit(_python("-m", f"services.{service}", *context.args))


@app.command()
def record(
    out: Annotated[Path, typer.Argument(help="the MCAP file to write")],
    site: SiteOption = "hall",
    bus: BusOption = DEFAULT_ENDPOINT,
    seconds: Annotated[float | None, typer.Option(help="stop by itself after this long")] = None,
) -> None:
    """Record what fusion consumes and publishes until Ctrl-C; the file replays to the very same tracks."""
    stopping = _stop_on_signals()
    if seconds is not None:
        _after(seconds, stopping.set)
    try:
        site_file = find_site(site)
        check_writable(out)
        with Bus([bus], wait=ROUTER_WITHIN) as session, console.status("recording …") as line:

            def progress(counts: dict[str, int]) -> None:
                shown = ", ".join(f"{count} {name}" for name, count in sorted(counts.items())) or "nothing yet"
                line.update(f"recording into {out}: {shown}")

            counts = record_bus(session, load_site(site_file), site_file, out, stopping, progress)
    except (LauncherError, RecordingError, SiteError, BusError, OSError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from error
    console.print(f"{out}: " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))


@app.command()
def replay(
    recording: Annotated[Path, typer.Argument(help="a file written by atrium record")],
    verify: Annotated[
        bool, typer.Option("--verify", help="compute the tracks anew and compare them bit for bit")
    ] = False,
    site: Annotated[str | None, typer.Option(help="site file; by default the one named in the recording")] = None,
    radio_model: Annotated[Path | None, typer.Option(help="trained radio model fusion had, with --verify")] = None,
    bus: Annotated[str | None, typer.Option(help="send the recorded sensors to this Zenoh router instead")] = None,
    pace: Annotated[float, typer.Option(min=0.01, help="times the recorded speed, with --bus")] = 1.0,
) -> None:
    """Show what a recording holds, verify it, or play it on a bus as if it happened now."""
    try:
        opened = Recording(recording)
        if bus is not None:
            with Bus([bus], wait=ROUTER_WITHIN) as session:
                sent = player.play(opened, session, pace, _stop_on_signals())
            console.print(f"{sent} messages sent to {bus}")
            return
        site_file = find_site(site) if site else opened.site_file
        if verify:
            verdicts = player.verify(opened, load_site(site_file), radio_model)
            for verdict in verdicts:
                console.print(str(verdict))
            raise typer.Exit(0 if verdicts and all(verdict.identical for verdict in verdicts) else 1)
        console.print(player.describe(opened))
    except (LauncherError, RecordingError, SiteError, BusError, RadioModelError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from error


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def bench(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(help="an experiment, for example pets-video; none lists them")] = None,
) -> None:
    """Measure: run one experiment of benchmarks/ (needs a checkout), print its table, write its result."""
    root = Path(__file__).resolve().parent.parent.parent
    if not (root / "benchmarks").is_dir():
        console.print(f"[red]{escape(str(root))} holds no benchmarks/: experiments need a checkout[/red]")
        raise typer.Exit(2)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(root), os.environ.get("PYTHONPATH")]))
    raise typer.Exit(_python("-m", "benchmarks", *filter(None, [name]), *context.args))


@app.command()
def simulate(
    scenario: Annotated[str, typer.Argument(help="a shipped scenario (museum, construction-1 …) or a scenario file")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="same seed, same world; by default the scenario's own")
    ] = None,
    seconds: Annotated[float | None, typer.Option(min=1.0, help="how long; by default the scenario's duration")] = None,
    out: Annotated[
        Path | None, typer.Option(help="write all of it here, one JSON object per line (.gz: packed)")
    ] = None,
) -> None:
    """Make a scenario's world off-line, as fast as it goes; to see it live: atrium demo --site NAME."""
    from services.cli.simulate import simulate as make_world

    try:
        make_world(scenario, seed, seconds, out, console)
    except (LauncherError, ValueError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(2) from error


@app.command()
def migrate() -> None:
    """Bring the databases of all services up to date; run once before the services start.

    ATRIUM_DATABASE_URL is the gateway's; ATRIUM_LEARNING_DATABASE_URL is learning's, ATRIUM_HISTORY_DATABASE_URL
    history's and ATRIUM_API_DATABASE_URL the API's, by default the same.
    """
    # Only this command needs the libraries of databases.
    from services.api.admin.database import migrate as migrate_api
    from services.api.alerts.database import migrate as migrate_alerts
    from services.api.settings import default_api_database_url
    from services.gateway.devices.database import migrate as migrate_gateway
    from services.gateway.settings import default_database_url
    from services.history.database import migrate as migrate_history
    from services.history.settings import default_history_database_url
    from services.learning.activation.database import migrate as migrate_learning
    from services.learning.settings import default_learning_database_url

    try:
        migrate_gateway(default_database_url())
        migrate_learning(default_learning_database_url())
        migrate_history(default_history_database_url())
        migrate_api(default_api_database_url())
        migrate_alerts(default_api_database_url())
    except ServiceError as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from None
    console.print("databases are up to date")


@app.command("calibrate-lens")
def calibrate_lens(
    clip: Annotated[Path, typer.Argument(help="a video in which a checkerboard is moved through the whole picture")],
    board: Annotated[str, typer.Option(help="its inner corners across and down: squares less one")] = "9x6",
    site: Annotated[str | None, typer.Option(help="keep the lens beside this site file, with --camera")] = None,
    camera: Annotated[str | None, typer.Option(help="the camera whose lens it is")] = None,
) -> None:
    """Find out how a camera's lens bends straight lines, before calibrating the camera in the browser."""
    raise typer.Exit(lens_command.calibrate_lens(clip, board, site, camera, console))


@app.command("site")
def check_site(site: Annotated[str, typer.Argument(help="a shipped site's name, a site file, or its folder")]) -> None:
    """Check a site file and say what is in it."""
    try:
        path = find_site(site)
        found = load_site(path)
    except (LauncherError, SiteError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(2) from error
    console.print(f"{path}: good. Site [bold]{found.site}[/bold] ({found.name})")
    for floor in found.floors:
        console.print(f"  floor {floor.id}: level {floor.level}, {floor.plan().outline.area:.0f} m²")
    for camera in found.cameras:
        x, y, z = camera.geometry.build().position
        console.print(
            f"  camera {camera.id}: area {camera.area}, hangs at ({x:.1f}, {y:.1f}, {z:.1f}) m, {camera.source}"
        )
    console.print(f"  {len(found.access_points)} access points, {len(found.zones)} zones")
    setup = read_setup(path)
    if setup is not None:
        over = [*setup.cameras, *setup.access_points]
        console.print(f"  {setup_path(path).name}, version {setup.version}, goes over the file for {', '.join(over)}")
    nowhere = [point.id for point in found.access_points if point.position is None]
    if nowhere:
        console.print(f"  no position yet, to be found by learning: {', '.join(nowhere)}")


def main() -> None:
    """Run the command line."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(130)


def _python(*arguments: str) -> int:
    """Run a module of ours in this terminal; Ctrl-C is left to it."""
    with subprocess.Popen([sys.executable, *arguments]) as child:  # noqa: S603 (our own modules)
        while True:
            try:
                return child.wait()
            except KeyboardInterrupt:
                continue


def _stop_on_signals() -> threading.Event:
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    return stopping


def _after(seconds: float, action: Callable[[], None]) -> None:
    timer = threading.Timer(seconds, action)
    timer.daemon = True
    timer.start()


def _record_in_thread(running: Demo, out: Path, stopping: threading.Event) -> threading.Thread:
    site, site_file, endpoint = running.site, running.site_file, running.endpoint

    def work() -> None:
        with Bus([endpoint]) as session:
            counts = record_bus(session, site, site_file, out, stopping)
        console.print(f"{out}: " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))

    thread = threading.Thread(target=work, name="recorder", daemon=True)
    thread.start()
    return thread


def _introduce(running: Demo, dashboard: bool) -> None:
    if dashboard:
        console.print(f"  live map    [bold]{running.dashboard_url}[/bold]")
    console.print(f"  API         {running.api_url}/docs   (key: {API_KEY})")
    console.print(f"  phones post {running.gateway_url}/docs   (enrolment key: demo-enrolment-key)")
    console.print(f"  bus         {running.endpoint}")
    console.print(f"  log         {running.log_file}")
    console.print("Ctrl-C stops all.", style="dim")


def _watch(running: Demo, stopping: threading.Event, seconds: float | None) -> None:
    """Keep the processes running and say now and then how it goes."""
    end = None if seconds is None else time.monotonic() + seconds
    next_word = time.monotonic() + 5.0
    with console.status("waiting for the first tracks …") as line:
        while not stopping.wait(0.2) and (end is None or time.monotonic() < end):
            running.launcher.keep_running()
            if time.monotonic() < next_word:
                continue
            next_word = time.monotonic() + 2.0
            try:
                positions, alerts = running.get("/v1/positions"), running.get("/v1/alerts?limit=1")
            except httpx.HTTPError as error:
                line.update(f"the API does not answer: {error}")
                continue
            latest = alerts["alerts"]
            last = f"last alert: {latest[0]['kind']} {latest[0]['zone']}" if latest else "no alerts yet"
            line.update(f"{len(positions['positions'])} phones located, {last}")
