"""Typed settings of a service: flags, then environment (``ATRIUM_*``), then a file (``--config``), then defaults."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeVar

import yaml
from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import (
    BaseSettings,
    CliSettingsSource,
    InitSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)
from pydantic_settings import SettingsError as UnreadableSettingError

from shared.kept import Kept
from shared.site.site_file import expand_environment

__all__ = ["ServiceSettings", "SettingsError", "data_folder", "read_settings"]

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


class SettingsError(ValueError):
    """A setting is wrong: the text names setting, where it may be given, value and what is allowed."""


class ServiceSettings(BaseSettings):
    """What every service can be told. Services add fields of their own; names are unique across services."""

    model_config = SettingsConfigDict(
        env_prefix="ATRIUM_",
        extra="ignore",
        cli_kebab_case=True,
        cli_hide_none_type=True,
        cli_implicit_flags=True,
        hide_input_in_errors=False,
    )
    secrets: ClassVar[tuple[str, ...]] = ()
    """Names of fields that must not keep their demo value outside ``profile=demo``."""

    site_file: Path = Field(description="the site file (YAML)")
    profile: Literal["demo", "production"] = Field("production", description="demo accepts default secrets")
    bus: list[str] = Field([DEFAULT_ENDPOINT], min_length=1, description="Zenoh router endpoints")
    instance: str = Field("", description="name of this process among its kind; empty: chosen by the service")
    health_host: str = Field("127.0.0.1", description="where /healthz, /readyz and /metrics listen")
    health_port: int = Field(0, ge=0, le=65535, description="0: any free port, printed at start")
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: Literal["text", "json"] = "text"

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Order the sources: flags and arguments, environment, file."""
        path = os.environ.get("ATRIUM_CONFIG")
        file = (InitSettingsSource(settings_cls, _read_file(Path(path), settings_cls)),) if path else ()
        return (init_settings, env_settings, *file)

    def kept(self) -> list[Kept]:
        """Return what a service with these settings keeps of people, and for how long; services say what they do."""
        return []

    def shown(self) -> dict[str, Any]:
        """Return the settings for the log, secrets hidden."""
        return {name: "***" if isinstance(value, SecretStr) else value for name, value in self.model_dump().items()}


S = TypeVar("S", bound=ServiceSettings)


def read_settings(kind: type[S], arguments: Sequence[str] | None = None, program: str | None = None) -> S:
    """Read the settings of one service from command line, environment and file.

    Raises:
        SettingsError: a setting is missing, unknown or out of range, or a demo secret is used outside the demo.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    chosen = _take_config(arguments)
    before = os.environ.get("ATRIUM_CONFIG")
    if chosen is not None:
        os.environ["ATRIUM_CONFIG"] = chosen
    try:
        source: CliSettingsSource[S] = CliSettingsSource(
            kind, cli_parse_args=arguments, cli_prog_name=program, cli_exit_on_error=True
        )
        settings = kind(_cli_settings_source=source)
    except ValidationError as error:
        raise SettingsError(_explain(error, kind)) from error
    except UnreadableSettingError as error:
        raise SettingsError(_explain_unreadable(error)) from error
    finally:
        if chosen is not None:
            os.environ.pop("ATRIUM_CONFIG")
            if before is not None:
                os.environ["ATRIUM_CONFIG"] = before
    if settings.profile != "demo":
        for name in kind.secrets:
            value = getattr(settings, name)
            default = kind.model_fields[name].default
            if value == default:
                raise SettingsError(
                    f"{name}: the default secret is for the demo only; set {_variable(name)} to a secret of your own"
                )
    return settings


def data_folder() -> Path:
    """Return the folder of real recordings: ``ATRIUM_DATA``, by default ``../shared/data`` beside the project."""
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    return Path(os.environ.get("ATRIUM_DATA") or default).resolve()


def _read_file(path: Path, kind: type[BaseSettings]) -> dict[str, Any]:
    """Read a YAML file of settings; ``${NAME}`` in its text values is replaced by environment variables."""
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: not YAML: {error}") from error
    if not isinstance(document, dict):
        raise SettingsError(f"{path}: must hold a mapping of settings, found {type(document).__name__}")
    unknown = [str(name) for name in document if name not in kind.model_fields]
    if unknown:
        raise SettingsError(f"{path}: {', '.join(unknown)}: no such setting; allowed: {', '.join(kind.model_fields)}")
    try:
        return {name: expand_environment(v) if isinstance(v, str) else v for name, v in document.items()}
    except ValueError as error:
        raise SettingsError(f"{path}: {error}") from error


def _variable(name: str) -> str:
    return f"ATRIUM_{name.upper()}"


def _take_config(arguments: list[str]) -> str | None:
    """Take ``--config FILE`` or ``--config=FILE`` out of the arguments and return the file's name."""
    for position, argument in enumerate(arguments):
        if argument == "--config":
            if position + 1 >= len(arguments):
                raise SettingsError("--config: needs a file name")
            chosen = arguments[position + 1]
            del arguments[position : position + 2]
            return chosen
        if argument.startswith("--config="):
            del arguments[position]
            return argument.partition("=")[2]
    return None


def _explain(error: ValidationError, kind: type[ServiceSettings]) -> str:
    lines = []
    for problem in error.errors():
        message = problem["msg"].removeprefix("Value error, ")
        if not problem["loc"]:
            lines.append(message)
            continue
        name = str(problem["loc"][0])
        flag = "--" + name.replace("_", "-")
        hidden = problem["type"] == "missing" or _is_secret(name, kind)
        found = "" if hidden else f" (found {problem['input']!r})"
        lines.append(f"{name}: {message}{found}; set it by {flag} or {_variable(name)}")
    return "\n".join(lines)


def _is_secret(name: str, kind: type[ServiceSettings]) -> bool:
    field = kind.model_fields.get(name)
    return name in kind.secrets or (field is not None and "Secret" in repr(field.annotation))


def _explain_unreadable(error: UnreadableSettingError) -> str:
    """Say which variable holds no list or mapping; pydantic-settings names the field, not the variable."""
    match = re.search(r'field "(\w+)"', str(error))
    if match is None:
        return str(error)
    name = match[1]
    example = """ '["first", "second"]'"""
    return f"{name}: {_variable(name)} must hold JSON, such as{example}"
