"""``atrium staff``: let the first of the staff in, before there is anybody who could do so over HTTP."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from shared.runner import ServiceError

__all__ = ["app"]

app = typer.Typer(no_args_is_help=True, help="People who may sign in: add one, list them.")
console = Console(highlight=False)


@app.callback()
def staff() -> None:
    """Work on the API's database (ATRIUM_API_DATABASE_URL), whether the API runs or not."""


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="the name to sign in with")],
    role: Annotated[str, typer.Option(help="viewer, guard, desk, curator or admin")] = "admin",
    password_stdin: Annotated[
        bool, typer.Option("--password-stdin", help="read the password from standard input")
    ] = False,
) -> None:
    """Let somebody in; asks for the password."""
    # Only these commands need the API's libraries.
    from services.api.admin.account_replies import NewUser
    from services.api.admin.accounts import Accounts
    from services.api.admin.database import open_admin
    from services.api.problems import ProblemError
    from services.api.request_body import only_known, sound
    from services.api.settings import default_api_database_url

    if password_stdin:
        password = sys.stdin.readline().rstrip("\r\n")
    else:
        password = typer.prompt("Password", hide_input=True, confirmation_prompt=True)
    try:
        wanted = only_known(
            sound({"name": name, "role": role, "password": password}),
            NewUser,
            "viewer, guard, desk, curator or admin; a password",
        )
        engine = open_admin(default_api_database_url())
        Accounts(engine, session_hours=1.0, session_rate=1.0).let_in(wanted.name, wanted.role, wanted.password)
    except (ProblemError, ServiceError) as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from None
    console.print(f"{escape(name)} may sign in as {role}")


@app.command("list")
def show() -> None:
    """Who may sign in."""
    from services.api.admin.accounts import Accounts
    from services.api.admin.database import open_admin
    from services.api.settings import default_api_database_url

    try:
        users = Accounts(open_admin(default_api_database_url()), session_hours=1.0, session_rate=1.0).users()
    except ServiceError as error:
        console.print(f"[red]{escape(str(error))}[/red]")
        raise typer.Exit(1) from None
    for user in users:
        console.print(f"{escape(user.name)}  {user.role}")
