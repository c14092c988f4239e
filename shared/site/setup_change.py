"""Change what is set up beside a site file: read, change, check the whole site, replace the file; one at a time."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from shared.part_file import PartFileError, read_part_file
from shared.site.setup_file import SetUp, apply_setup, read_setup, save_setup, setup_path
from shared.site.site_file import Site
from shared.site.site_loading import site_problems

__all__ = ["SetupRefusedError", "SetupUnwritableError", "change_setup"]


class SetupRefusedError(ValueError):
    """With this change the site would contradict itself, or a file is damaged; nothing was stored."""


class SetupUnwritableError(OSError):
    """The folder of the site file cannot be written: the text names it and says what to do."""


def change_setup(site_file: Path, change: Callable[[SetUp], SetUp]) -> SetUp:
    """Store what ``change`` makes of the present set-up, and return it with its version.

    Several processes may do so; they wait for each other.

    Args:
        site_file: the site file, beside which the set-up lies.
        change: returns the set-up as it shall be.

    Raises:
        SetupRefusedError: the site would not load with it.
        SetupUnwritableError: it could not be written.
    """
    with _alone(site_file.parent):
        try:
            site = read_part_file(site_file, Site)
            before = read_setup(site_file) or SetUp(site=site.site)
        except PartFileError as error:
            raise SetupRefusedError(str(error)) from error
        setup = change(before).model_copy(update={"version": before.version + 1})
        problems: list[str] = []
        problems += site_problems(apply_setup(site, setup, problems.append))
        if problems:
            raise SetupRefusedError("; ".join(problems))
        try:
            save_setup(site_file, setup)
        except OSError as error:
            raise SetupUnwritableError(
                f"{setup_path(site_file)} cannot be written: {error.strerror}; the process that saves needs the right "
                "to write into the folder of the site file (docs/camera-setup.md)"
            ) from error
        return setup


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the folder against other processes that change a set-up in it."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise SetupUnwritableError(f"{folder} cannot be opened: {error.strerror}") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
