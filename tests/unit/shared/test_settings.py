"""Settings: who wins, what is refused, and what is never shown."""

from pathlib import Path
from typing import ClassVar

import pytest
from pydantic import Field, SecretStr

from shared.settings import ServiceSettings, SettingsError, data_folder, read_settings


class Kettle(ServiceSettings):
    """A service's settings as services write them."""

    secrets: ClassVar[tuple[str, ...]] = ("kettle_key",)
    kettle_key: SecretStr = Field(SecretStr("demo-key"), min_length=4)
    degrees: float = Field(80.0, gt=0, le=100, description="how hot")
    keep_warm: bool = False


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CONFIG", "PROFILE", "BUS", "DEGREES", "KETTLE_KEY", "SITE_FILE", "HEALTH_PORT", "KEEP_WARM"):
        monkeypatch.delenv(f"ATRIUM_{name}", raising=False)
    monkeypatch.setenv("ATRIUM_KETTLE_KEY", "my-own-key")


def read(*flags: str) -> Kettle:
    return read_settings(Kettle, ["--site-file", "site.yaml", *flags], "kettle")


def test_a_flag_beats_the_environment_beats_the_file_beats_the_default(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "kettle.yaml"
    file.write_text("degrees: 70\nlog_level: debug\n")
    assert read().degrees == 80.0
    assert read("--config", str(file)).degrees == 70.0
    monkeypatch.setenv("ATRIUM_DEGREES", "60")
    assert read("--config", str(file)).degrees == 60.0
    assert read("--config", str(file), "--degrees", "50").degrees == 50.0
    assert read(f"--config={file}").log_level == "debug"


def test_a_config_file_named_by_flag_is_forgotten_after_reading(tmp_path: Path) -> None:
    file = tmp_path / "kettle.yaml"
    file.write_text("degrees: 70\n")
    read("--config", str(file))
    assert read().degrees == 80.0


def test_a_config_file_named_by_the_environment_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "kettle.yaml"
    file.write_text("degrees: 70\n")
    monkeypatch.setenv("ATRIUM_CONFIG", str(file))
    assert read().degrees == 70.0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "cannot be read: No such file"),
        ("degrees: [", "not YAML"),
        ("- degrees", "must hold a mapping of settings, found list"),
        ("warmth: 3", "warmth: no such setting; allowed: .*degrees"),
        ("degrees: 200", "degrees: .*less than or equal to 100.*200"),
        ("log_format: ${NOT_SET_ANYWHERE}", "NOT_SET_ANYWHERE is not set"),
    ],
)
def test_a_bad_config_file_is_refused_with_the_reason(tmp_path: Path, text: str | None, reason: str) -> None:
    file = tmp_path / "kettle.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(SettingsError, match=reason):
        read("--config", str(file))


def test_config_without_a_name_is_refused() -> None:
    with pytest.raises(SettingsError, match="--config: needs a file name"):
        read("--config")


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["--degrees", "-1"], r"degrees: .*greater than 0.*'-1'.*--degrees or ATRIUM_DEGREES"),
        (["--degrees", "hot"], r"degrees: .*number.*'hot'"),
        (["--profile", "test"], r"profile: .*'demo' or 'production'.*'test'.*ATRIUM_PROFILE"),
        (["--health-port", "70000"], r"health_port: .*65535.*'70000'.*--health-port"),
        (["--log-level", "loud"], r"log_level: .*'debug'"),
        (["--bus", "[]"], r"bus: .*at least 1"),
    ],
)
def test_a_wrong_value_names_setting_value_and_what_is_allowed(flags: list[str], reason: str) -> None:
    with pytest.raises(SettingsError, match=reason):
        read(*flags)


def test_every_wrong_setting_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATRIUM_PROFILE", "x")
    with pytest.raises(SettingsError, match=r"(?s)profile.*degrees"):
        read("--degrees", "-1")


def test_a_missing_setting_says_where_to_give_it() -> None:
    with pytest.raises(SettingsError, match="site_file: Field required; set it by --site-file or ATRIUM_SITE_FILE"):
        read_settings(Kettle, [], "kettle")


def test_a_list_in_the_environment_that_is_not_json_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATRIUM_BUS", "tcp/zenoh:7447")
    with pytest.raises(SettingsError, match="bus: ATRIUM_BUS must hold JSON"):
        read()
    monkeypatch.setenv("ATRIUM_BUS", '["tcp/zenoh:7447"]')
    assert read().bus == ["tcp/zenoh:7447"]


def test_several_routers_can_be_given_by_flag() -> None:
    assert read("--bus", "tcp/a:1", "--bus", "tcp/b:2").bus == ["tcp/a:1", "tcp/b:2"]


def test_a_demo_secret_is_refused_in_production_and_accepted_in_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ATRIUM_KETTLE_KEY")
    with pytest.raises(SettingsError, match=r"kettle_key: the default secret .* set ATRIUM_KETTLE_KEY"):
        read()
    monkeypatch.setenv("ATRIUM_KETTLE_KEY", "demo-key")
    with pytest.raises(SettingsError, match="the default secret"):
        read()
    assert read("--profile", "demo").kettle_key.get_secret_value() == "demo-key"


def test_a_secret_is_shown_neither_in_the_log_nor_in_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "my-own-key" not in repr(read().shown())
    monkeypatch.setenv("ATRIUM_KETTLE_KEY", "abc")
    with pytest.raises(SettingsError, match="kettle_key") as refusal:
        read()
    assert "abc" not in str(refusal.value)


def test_help_names_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        read("--help")
    assert left.value.code == 0
    shown = capsys.readouterr().out
    for flag in ("--site-file", "--bus", "--health-port", "--degrees", "--keep-warm"):
        assert flag in shown
    assert "my-own-key" not in shown


def test_an_unknown_flag_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        read("--colour", "red")
    assert left.value.code == 2
    assert "--colour" in capsys.readouterr().err


def test_other_services_variables_do_not_disturb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATRIUM_SOMETHING_ELSE", "1")
    assert read().degrees == 80.0


def test_the_data_folder_is_where_the_environment_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ATRIUM_DATA", str(tmp_path))
    assert data_folder() == tmp_path
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ATRIUM_DATA", "recordings")  # handed on to processes that run elsewhere
    assert data_folder() == tmp_path / "recordings"
