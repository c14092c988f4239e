"""``atrium staff``: let the first of the staff in, before there is anybody who could do so over HTTP."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from shared.runner import ServiceError

if TYPE_CHECKING:
    from services.api.admin.accounts import Accounts

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="People who may sign in: add, list, remove, give a new password.")
console = Console(highlight=False)
FromInput = Annotated[bool, typer.Option("--password-stdin", help="read the password from standard input")]
SOON = "sign-ins from before end within a minute"


@app.callback()
def staff() -> None:
    """Work on the API's database (ATRIUM_API_DATABASE_URL), whether the API runs or not."""


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="the name to sign in with")],
    role: Annotated[str, typer.Option(help="viewer, guard, desk, curator or admin")] = "admin",
    password_stdin: FromInput = False,
) -> None:
    """Let somebody in; asks for the password."""
    from services.api.admin.account_replies import NewUser
    from services.api.request_body import only_known, sound

    password = _password(password_stdin)
    with _accounts() as accounts:
        wanted = only_known(
            sound({"name": name, "role": role, "password": password}),
            NewUser,
            "viewer, guard, desk, curator or admin; a password",
        )
        accounts.let_in(wanted.name, wanted.role, wanted.password)
    console.print(f"{escape(name)} may sign in as {role}")


@app.command("list")
def show() -> None:
    """Who may sign in."""
    with _accounts() as accounts:
        for user in accounts.users():
            console.print(f"{escape(user.name)}  {user.role}")


@app.command()
def remove(name: Annotated[str, typer.Argument(help="the name they sign in with")]) -> None:
    """Take somebody out; the last admin stays. An API that runs hears of it within a minute."""
    with _accounts() as accounts:
        accounts.shut_out(name)
    console.print(f"{escape(name)} may not sign in any more; {SOON}")


@app.command()
def password(
    name: Annotated[str, typer.Argument(help="the name they sign in with")], password_stdin: FromInput = False
) -> None:
    """Give somebody a new password; asks for it."""
    from services.api.admin.account_replies import UserChange
    from services.api.request_body import only_known, sound

    typed = _password(password_stdin)
    with _accounts() as accounts:
        accounts.change(name, None, only_known(sound({"password": typed}), UserChange, "a password").password)
    console.print(f"{escape(name)} has a new password; {SOON}")


def _password(from_input: bool) -> str:
    if from_input:
        return sys.stdin.readline().rstrip("\r\n")
    typed: str = typer.prompt("Password", hide_input=True, confirmation_prompt=True)
    return typed


@contextmanager
def _accounts() -> Iterator[Accounts]:
    """Open the database; what goes wrong there is said in words, and the command has failed."""
    # Only these commands need the API's libraries.
    from services.api.admin.accounts import Accounts
    from services.api.admin.database import open_admin
    from services.api.problems import ProblemError
    from services.api.settings import default_api_database_url

    try:
        yield Accounts(open_admin(default_api_database_url()), session_hours=1.0, session_rate=1.0)
    except (ProblemError, ServiceError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from None
