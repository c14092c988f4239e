"""``atrium history``: the past as a file: take it out, bring it in."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.markup import escape

from shared.keys import is_identifier
from shared.runner import ServiceError

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="What happened, as a file: export, import.")
console = Console(highlight=False)

DatabaseOption = Annotated[
    str | None, typer.Option("--database", help="its URL; by default ATRIUM_HISTORY_DATABASE_URL, ATRIUM_DATABASE_URL")
]
WHEN = "a time such as 2026-11-23 or 2026-11-23T10:00+01:00; without a zone UTC"


@app.command("export")
def export(
    out: Annotated[Path, typer.Argument(help="the file to write, JSON lines in gzip")],
    since: Annotated[str | None, typer.Option(help=f"only from then on: {WHEN}")] = None,
    until: Annotated[str | None, typer.Option(help="only before then")] = None,
    device: Annotated[
        str | None, typer.Option(help="only what bears this device's name: what its owner may ask")
    ] = None,
    database: DatabaseOption = None,
) -> None:
    """Write what is kept into one file: a backup, or what a visitor asks for of their own phone."""
    if device is not None and not is_identifier(device):
        _refuse(f"--device: found {device!r}; allowed: the id of a device")
    begin, end = _time("--since", since), _time("--until", until)
    # Only these commands need the libraries of databases.
    from services.history.transfer_command import export_to

    try:
        rows = export_to(database, out, begin, end, device)
    except (ServiceError, OSError) as error:
        _refuse(str(error))
    console.print(f"{rows} rows written to {escape(str(out))}")


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(help="a file written by atrium history export")],
    database: DatabaseOption = None,
) -> None:
    """Bring a file in, all of it or nothing; what is there already is not doubled, who is erased stays erased."""
    from services.history.transfer_command import import_from

    try:
        rows = import_from(database, file)
    except (ServiceError, OSError) as error:
        _refuse(str(error))
    console.print(f"{rows} rows brought in")


def _time(option: str, text: str | None) -> float | None:
    if text is None:
        return None
    try:
        found = datetime.datetime.fromisoformat(text)
        return (found if found.tzinfo else found.replace(tzinfo=datetime.UTC)).timestamp()
    except (ValueError, OverflowError):
        _refuse(f"{option}: found {text!r}; allowed: {WHEN}")


def _refuse(words: str) -> NoReturn:
    console.print(f"[red]{escape(words)}[/red]")
    raise typer.Exit(1)
