"""``atrium calibrate-lens``: a clip of a moving checkerboard in, a lens out; kept beside the site file if wanted."""

from __future__ import annotations

import threading
from pathlib import Path

import yaml
from rich.console import Console
from rich.markup import escape

from services.cli.demo import find_site
from services.cli.launcher import LauncherError
from shared.site import SiteError, load_site
from shared.site.setup_change import SetupRefusedError, SetupUnwritableError, change_setup
from shared.site.setup_file import CameraSetup, SetUp, setup_path
from shared.site.site_file import Lens

__all__ = ["calibrate_lens"]


def calibrate_lens(clip: Path, board: str, site: str | None, camera: str | None, console: Console) -> int:
    """Find the lens, tell of it, save it where ``site`` and ``camera`` are named; return the exit status."""
    # Only this command needs the libraries of pictures.
    from services.camera import lens_clip
    from services.camera.frames import SourceError
    from services.camera.recorded import VideoFile

    try:
        columns, rows = _board(board)
        if (site is None) != (camera is None):
            raise LauncherError("--site and --camera belong together: both, or neither")
        site_file = None if site is None else find_site(site)
        if site_file is not None and camera not in [one.id for one in load_site(site_file).cameras]:
            raise LauncherError(f"--camera {camera}: {site_file} has no camera of this name")
        source = VideoFile(clip, pace="fast", frames_per_s=30.0)
        with console.status("looking for the board …"):
            images = (frame.image for frame in source.frames(threading.Event()))
            views, size = lens_clip.collect_views(images, columns, rows)
        fit = lens_clip.calibrate_lens(views, size, columns, rows)
    except (LauncherError, SiteError, SourceError, ValueError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        return 2
    console.print(
        f"{fit.views} views of {size[0]} x {size[1]}: {fit.error:.2f} px off, "
        f"{fit.straight_error:.2f} px without k1 and k2"
    )
    console.print(escape(yaml.safe_dump({"lens": fit.lens.model_dump(mode="json")}, default_flow_style=None)), end="")
    if site_file is None or camera is None:
        console.print("For a camera's geometry of kind points; --site and --camera keep it beside the site file.")
        return 0
    return _keep(site_file, camera, fit.lens, console)


def _keep(site_file: Path, camera: str, lens: Lens, console: Console) -> int:
    def change(setup: SetUp) -> SetUp:
        before = setup.cameras.get(camera, CameraSetup())
        cameras = {**setup.cameras, camera: before.model_copy(update={"lens": lens})}
        return setup.model_copy(update={"cameras": cameras})

    try:
        change_setup(site_file, change)
    except (SetupRefusedError, SetupUnwritableError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        return 1
    console.print(
        f"kept in {setup_path(site_file)}; calibrate {camera} in the browser now: what is saved from then on uses it"
    )
    return 0


def _board(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdigit() and rows.isdigit()):
        raise LauncherError(f"--board {text}: allowed: inner corners across and down, such as 9x6")
    return int(columns), int(rows)
