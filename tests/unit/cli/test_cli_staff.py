"""``atrium staff`` lets the first admin in."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from services.api.admin.accounts import Accounts
from services.api.admin.database import migrate, open_admin
from services.cli.main import app


def test_the_first_admin_is_let_in_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.api.admin.passwords.LOG2_N", 4)
    url = f"sqlite:///{tmp_path}/api.db"
    monkeypatch.setenv("ATRIUM_API_DATABASE_URL", url)
    add = ["staff", "add", "maria", "--password-stdin"]
    early = CliRunner().invoke(app, add, input="correct horse battery\n")
    assert early.exit_code == 1
    assert "atrium migrate" in early.output.replace("\n", " ")
    migrate(url)
    done = CliRunner().invoke(app, add, input="correct horse battery\n")
    assert done.exit_code == 0, done.output
    assert Accounts(open_admin(url), 1.0, 1.0).is_right("maria", "correct horse battery") == "admin"
    asked = CliRunner().invoke(app, ["staff", "add", "otto", "--role", "guard"], input="ten letters\nten letters\n")
    assert asked.exit_code == 0, asked.output
    assert "ten letters" not in asked.output
    listed = CliRunner().invoke(app, ["staff", "list"]).output
    assert [line.split() for line in listed.splitlines()] == [["maria", "admin"], ["otto", "guard"]]
    renewed = CliRunner().invoke(app, ["staff", "password", "otto", "--password-stdin"], input="another password\n")
    assert renewed.exit_code == 0, renewed.output
    assert Accounts(open_admin(url), 1.0, 1.0).is_right("otto", "another password") == "guard"
    mistyped = CliRunner().invoke(app, ["staff", "password", "otto", "--password-stdin"], input="another\x7fpassword\n")
    assert mistyped.exit_code == 1, "nobody could sign in with it"
    gone = [CliRunner().invoke(app, ["staff", "remove", name]).exit_code for name in ("otto", "otto", "maria")]
    assert gone == [0, 1, 1], "nobody twice, and the last admin stays"
    assert [user.name for user in Accounts(open_admin(url), 1.0, 1.0).users()] == ["maria"]


@pytest.mark.parametrize(
    ("arguments", "password", "word"),
    [
        (["maria"], "short", "password"),
        (["maria", "--role", "king"], "correct horse", "role"),
        ([" "], "x" * 12, "name"),
    ],
)
def test_what_is_wrong_is_named_and_nobody_let_in(
    arguments: list[str], password: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"sqlite:///{tmp_path}/api.db"
    monkeypatch.setenv("ATRIUM_API_DATABASE_URL", url)
    migrate(url)
    refused = CliRunner().invoke(app, ["staff", "add", *arguments, "--password-stdin"], input=f"{password}\n")
    assert refused.exit_code == 1
    assert word in refused.output
    assert password not in refused.output
    assert Accounts(open_admin(url), 1.0, 1.0).users() == []
