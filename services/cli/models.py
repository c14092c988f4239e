"""``atrium models``: what was learned, from the command line: list, export, import, roll back, freeze."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any, NoReturn, get_args

import msgspec
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from services.cli.demo import find_site
from services.cli.launcher import LauncherError
from shared.bus import Bus, BusError
from shared.keys import Keys
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import ModelKind
from shared.settings import DEFAULT_ENDPOINT
from shared.site import SiteError, load_site

__all__ = ["ModelsError", "app", "order", "renamed"]

app = typer.Typer(no_args_is_help=True, help="What was learned: list, export, import, roll back, freeze.")
console = Console(highlight=False)

SiteOption = Annotated[str, typer.Option("--site", help="a shipped site's name, a site file, or its folder")]
BusOption = Annotated[str, typer.Option("--bus", help="endpoint of the Zenoh router")]
KindArgument = Annotated[str, typer.Argument(help="radio, detector, stride, heading or alignment")]
SubjectArgument = Annotated[str, typer.Argument(help="of which area, camera or device")]
ROUTER_WITHIN = 10.0
ANSWER_WITHIN = 30.0
"""Seconds."""


class ModelsError(RuntimeError):
    """An order was not carried out: the text says why."""


def order(bus: Bus, site: str, fields: dict[str, Any]) -> LearningAnswer:
    """Give learning an order and return its answer.

    Raises:
        ModelsError: the order is none, nobody answers, or it was refused.
    """
    if fields.get("kind") not in (None, *get_args(ModelKind)):
        raise ModelsError(f"kind: found {fields['kind']!r}; allowed: {', '.join(get_args(ModelKind))}")
    try:
        command = msgspec.convert(fields, LearningCommand)
    except msgspec.ValidationError as error:
        raise ModelsError(str(error)) from error
    payload = msgspec.json.encode(command)
    for _, told in bus.ask(Keys(site).learning_command(), ANSWER_WITHIN, payload):
        answer = msgspec.json.decode(told, type=LearningAnswer)
        if not answer.done:
            raise ModelsError(answer.words)
        return answer
    raise ModelsError(f"learning of site {site} does not answer: does its service run, on this bus?")


def renamed(pairs: list[str], option: str) -> dict[str, str]:
    """Return OLD=NEW pairs as a mapping.

    Raises:
        ModelsError: one is no such pair.
    """
    found = {}
    for pair in pairs:
        old, equals, new = pair.partition("=")
        if not (old and equals and new):
            raise ModelsError(f"{option}: found {pair!r}; allowed: OLD=NEW")
        found[old] = new
    return found


@app.command("list")
def list_models(site: SiteOption = "hall", bus: BusOption = DEFAULT_ENDPOINT) -> None:
    """Show all models that are stored, and what became of them."""
    answer = _ordered(site, bus, {"do": "list"})
    table = Table("kind", "of", "version", "state", "since", "why", box=None)
    for line in answer.models:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(line.t))
        state = f"{line.state}, on probation" if line.probation else line.state
        table.add_row(line.kind, line.subject, str(line.version), state, when, escape(line.reason))
    if answer.models:
        console.print(table)
    console.print(answer.words)


@app.command("export")
def export(
    out: Annotated[Path, typer.Argument(help="the JSON file to write")],
    site: SiteOption = "hall",
    bus: BusOption = DEFAULT_ENDPOINT,
    personal: Annotated[bool, typer.Option("--personal", help="stride and heading of people's phones too")] = False,
) -> None:
    """Write the models that are live into one file, for a backup or a second museum."""
    answer = _ordered(site, bus, {"do": "export", "personal": personal})
    try:
        out.write_bytes(msgspec.json.format(bytes(answer.bundle), indent=1))
    except OSError as error:
        _refuse(f"{out}: cannot be written: {error.strerror}")
    console.print(f"{escape(answer.words)}, written to {escape(str(out))}")


@app.command("import")
def import_models(
    file: Annotated[Path, typer.Argument(help="a file written by atrium models export")],
    site: SiteOption = "hall",
    bus: BusOption = DEFAULT_ENDPOINT,
    as_site: Annotated[bool, typer.Option("--as-site", help="take another site's models for this one's")] = False,
    camera: Annotated[list[str] | None, typer.Option(help="OLD=NEW: a camera that has another name here")] = None,
    area: Annotated[list[str] | None, typer.Option(help="OLD=NEW: an area that has another name here")] = None,
    force: Annotated[bool, typer.Option("--force", help="make them live at once, untried")] = False,
) -> None:
    """Take in models: radio goes live once it wins on this site's minutes, other kinds by `atrium models activate`."""
    try:
        document = file.read_bytes()
        msgspec.json.decode(document)
        fields: dict[str, Any] = {
            "do": "import",
            "as_site": as_site,
            "cameras": renamed(camera or [], "--camera"),
            "areas": renamed(area or [], "--area"),
            "force": force,
            "bundle": msgspec.Raw(document),
        }
    except OSError as error:
        _refuse(f"{file}: cannot be read: {error.strerror}")
    except msgspec.DecodeError as error:
        _refuse(f"{file}: not JSON: {error}")
    except ModelsError as error:
        _refuse(str(error))
    console.print(escape(_ordered(site, bus, fields).words))


@app.command("rollback")
def rollback(
    kind: KindArgument, subject: SubjectArgument, site: SiteOption = "hall", bus: BusOption = DEFAULT_ENDPOINT
) -> None:
    """Return to the model before the one that is live, or to what is configured."""
    console.print(escape(_ordered(site, bus, {"do": "rollback", "kind": kind, "subject": subject}).words))


@app.command("activate")
def activate(
    kind: KindArgument,
    subject: SubjectArgument,
    version: Annotated[int, typer.Argument(help="one that `atrium models list` shows")],
    site: SiteOption = "hall",
    bus: BusOption = DEFAULT_ENDPOINT,
) -> None:
    """Make a stored model live at once, untried."""
    fields = {"do": "activate", "kind": kind, "subject": subject, "version": version}
    console.print(escape(_ordered(site, bus, fields).words))


@app.command("freeze")
def freeze(site: SiteOption = "hall", bus: BusOption = DEFAULT_ENDPOINT) -> None:
    """Let nothing new go live by itself; candidates are tried and told of, and what proves worse still goes back."""
    console.print(escape(_ordered(site, bus, {"do": "freeze"}).words))


@app.command("unfreeze")
def unfreeze(site: SiteOption = "hall", bus: BusOption = DEFAULT_ENDPOINT) -> None:
    """Let what wins go live again."""
    console.print(escape(_ordered(site, bus, {"do": "unfreeze"}).words))


def _ordered(site: str, endpoint: str, fields: dict[str, Any]) -> LearningAnswer:
    try:
        name = load_site(find_site(site)).site
        with Bus([endpoint], wait=ROUTER_WITHIN) as session:
            return order(session, name, {"by": "command line", **fields})
    except (BusError, LauncherError, ModelsError, SiteError) as error:
        _refuse(str(error))


def _refuse(words: str) -> NoReturn:
    console.print(f"[red]{escape(words)}[/red]")
    raise typer.Exit(1)
