"""``atrium simulate``: make a scenario's world off-line, as fast as it goes, and say what was in it."""

from __future__ import annotations

import errno
import os
import resource
import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from services.cli.demo import SITES
from services.cli.launcher import LauncherError

__all__ = ["find_scenario", "simulate"]

TOLD = 12
"""People with phones named one by one."""


def find_scenario(name: str) -> Path:
    """Return the scenario file meant by ``name``: a shipped one, a file, or a folder that holds scenario.yaml.

    Raises:
        LauncherError: there is no such scenario.
    """
    path = Path(name)
    for candidate in (SITES / name / "scenario.yaml", path / "scenario.yaml", path):
        if candidate.is_file():
            return candidate.resolve()
    shipped = ", ".join(sorted(file.parent.name for file in SITES.glob("*/scenario.yaml")))
    raise LauncherError(f"{name}: no such scenario; shipped are {shipped}, or name a scenario file")


def simulate(name: str, seed: int | None, seconds: float | None, out: Path | None, console: Console) -> None:
    """Make the world and print what was in it.

    Raises:
        LauncherError: there is no such scenario, or the file cannot be written.
        ScenarioError: the scenario is wrong.
    """
    # Only this command needs the simulator's libraries.
    from services.simulator.scenario_loading import load_scenario, scenario_digest
    from services.simulator.world import World, cameras_without_pictures
    from services.simulator.world_file import write_world

    file = find_scenario(name)
    if out is not None and (reason := _why_not_writable(out)) is not None:
        raise LauncherError(f"{out}: cannot be written: {reason}")
    scenario, site = load_scenario(file)
    wanted = scenario.duration if seconds is None else seconds
    console.print(f"making {wanted:.0f} s of {scenario.scenario}; its people and its radio come first")
    world = World(scenario, site, seed)
    begun = time.perf_counter()
    bar = Progress(
        TextColumn(f"{scenario.scenario}, seed {world.seed}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeElapsedColumn(),
        console=console,
    )
    try:
        with bar as progress:
            task = progress.add_task("", total=wanted)
            counts = write_world(world, wanted, out, lambda made: progress.update(task, completed=made))
    except OSError as error:
        raise LauncherError(f"{out}: cannot be written: {error.strerror}") from error
    took = time.perf_counter() - begun
    table = Table("what", "how much", title=f"{scenario.scenario}: {scenario.about or site.name}")
    for what, count in counts.items():
        table.add_row(what, f"{count:,}")
    seen = cameras_without_pictures(scenario, site)
    unseen = [camera.id for camera in site.cameras if camera.id not in seen]
    if unseen:
        which = f"{', '.join(unseen)}: " if seen else ""
        table.add_row("cameras", f"{which}rendered or real, nothing to see off line")
    told = ", ".join(f"{carrier.person}: {carrier.device}" for carrier in world.carriers[:TOLD]) or "nobody"
    more = len(world.carriers) - TOLD
    table.add_row("people with phones", f"{told} and {more} more" if more > 0 else told)
    table.add_row("made in", f"{took:.1f} s, {wanted / took:.0f} times real time")
    table.add_row("memory", f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB at most")
    table.add_row("digest of scenario and site", scenario_digest(scenario, site)[:16])
    console.print(table)
    if out is not None:
        console.print(f"written to {out}")


def _why_not_writable(out: Path) -> str | None:
    """Say why a file cannot be written, before a world is made for it; nothing is created yet."""
    if out.is_dir():
        return os.strerror(errno.EISDIR)
    if not out.parent.is_dir():
        return f"there is no folder {out.parent}"
    if not os.access(out if out.exists() else out.parent, os.W_OK):
        return os.strerror(errno.EACCES)
    return None
