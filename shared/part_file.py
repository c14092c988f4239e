"""Read a YAML document into a checked object; every mistake names the file, the path inside it, the value, the allowed.

The site file and the scenario file are such documents: a tree of ``Part``s.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from shared.redaction import redact_url

__all__ = ["Part", "PartFileError", "read_part_file"]

_WORDS = {
    "missing": "is missing",
    "string_type": "must be text; write it in quotes",
    "model_type": "must be a mapping of keys to values",
    "model_attributes_type": "must be a mapping of keys to values",
    "dict_type": "must be a mapping of keys to values",
    "list_type": "must be a list",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "int_from_float": "must be a whole number",
    "path_type": "must be a path",
}
"""What pydantic's kinds of mistake are called in front of an author of YAML."""
DEEPEST = 6
"""Levels of a value that a message shows; an anchor may lead back into itself."""


class Part(BaseModel):
    """Any mapping of such a file; an unknown key is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class PartFileError(ValueError):
    """The file cannot be used: the text names file, path inside it, value and what is allowed."""


P = TypeVar("P", bound=Part)


def read_part_file(path: Path, root: type[P]) -> P:
    """Return the document in ``path`` as a ``root``; paths inside it are relative to its folder.

    Raises:
        PartFileError: the file is missing, is not YAML, or anything in it is wrong; all mistakes are named at once.
    """
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), _Loader)  # noqa: S506 (derives from the safe loader)
    except OSError as error:
        raise PartFileError(f"{path}: cannot be read: {error.strerror}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        hint = "; indent with spaces" if "'\\t'" in str(error.problem) else ""
        raise PartFileError(f"{path}{place}: not YAML: {error.problem or error.context}{hint}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PartFileError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        found = "nothing" if document is None else type(document).__name__
        needed = ", ".join(repr(name) for name in [n for n, f in root.model_fields.items() if f.is_required()][:3])
        raise PartFileError(f"{path}: must hold a mapping with {needed} …, found {found}")
    try:
        return root.model_validate(document, context={"folder": path.parent.resolve()})
    except ValidationError as error:
        raise PartFileError(_explain(path, error, root)) from error


class _Loader(yaml.SafeLoader):
    """Refuses a key given twice: YAML would silently keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != "<<":
                if key.value in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"key {key.value!r} stands here a second time", key.start_mark
                    )
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def _explain(path: Path, error: ValidationError, root: type[Part]) -> str:
    lines = []
    for problem in error.errors():
        place, part, choices = _place(problem["loc"], root)
        message, value = _words(problem, part), problem["input"]
        shown = _shown(problem, message)
        if problem["type"] == "extra_forbidden":
            message, shown = f"unknown key; allowed here: {', '.join(part.model_fields)}", ""
        elif problem["type"].startswith("union_tag"):
            key = str(problem.get("ctx", {}).get("discriminator", "'kind'")).strip("'")
            found = f" (found {_shorten(value[key])})" if isinstance(value, dict) and key in value else ""
            place, message = f"{place}.{key}", f"must be one of {', '.join(_tags(choices, key))}{found}"
        lines.append(f"{path}: {place or 'document'}: {message}{shown}")
    return "\n".join(lines)


def _words(problem: ErrorDetails, part: type[Part]) -> str:
    """Say what is wrong as the file's author would; a check's own words stay as they are."""
    kind, limits = problem["type"], problem.get("ctx", {})
    if kind in _WORDS:
        return _WORDS[kind]
    if kind == "tuple_type":
        keys = [step for step in problem["loc"] if isinstance(step, str)]
        field = part.model_fields.get(keys[-1]) if keys else None
        usual = field.default if field is not None else None
        return f"must be a list such as {_in_yaml(usual)}" if isinstance(usual, tuple) else "must be a list of numbers"
    if kind == "too_short":
        return f"must hold at least {limits['min_length']}"
    if kind == "too_long":
        return f"must hold at most {limits['max_length']}"
    if kind == "string_too_short":
        return f"must be text of {limits['min_length']} or more characters"
    if kind == "string_too_long":
        return f"must be text of {limits['max_length']} characters at most"
    message = re.sub("^(Value error|Assertion failed), ", "", problem["msg"])
    return re.sub("^(Input|String|Value) should ", "must ", message).replace("must be a valid ", "must be a ")


def _shown(problem: ErrorDetails, message: str) -> str:
    """Return the value found, for the end of the message, unless the message tells it."""
    value, kind = problem["input"], problem["type"]
    if kind == "missing" or (kind == "value_error" and ", found " in message):
        return ""
    if isinstance(value, dict):
        return " (found a mapping)" if kind.endswith("_type") else ""
    return " (found none)" if kind == "too_short" and not value else f" (found {_shorten(value)})"


def _place(steps: Sequence[int | str], root: type[Part]) -> tuple[str, type[Part], list[type[Part]]]:
    """Return the path inside the file as its author would write it, the part that holds its last step, and the parts
    that might stand there.
    """
    place, part, choices = "", root, [root]
    for step in steps:
        if isinstance(step, int):
            place += f"[{step}]"
            continue
        if len(choices) > 1:
            # pydantic puts the chosen variant of a tagged union into the path; the file has no such level.
            choices = [choice for choice in choices if step in _literals(choice)] or choices[:1]
            continue
        place += f".{step}" if place else step
        part = choices[-1] if choices else part
        field = part.model_fields.get(step)
        choices = (_parts_within(field.annotation) if field is not None else []) or [part]
    return place, part, choices


def _parts_within(annotation: Any) -> list[type[Part]]:
    """Return the parts named somewhere inside a type such as ``list[Floor]``."""
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return [annotation]
    return [part for argument in get_args(annotation) for part in _parts_within(argument)]


def _literals(part: type[Part]) -> list[str]:
    return [tag for name in part.model_fields for tag in _tags([part], name)]


def _tags(parts: Sequence[type[Part]], key: str) -> list[str]:
    annotations = [part.model_fields[key].annotation for part in parts if key in part.model_fields]
    return [str(tag) for annotation in annotations if get_origin(annotation) is Literal for tag in get_args(annotation)]


def _shorten(value: object) -> str:
    text = redact_url(_in_yaml(value))
    return text if len(text) <= 120 else text[:117] + "..."


def _in_yaml(value: object, depth: int = 0) -> str:
    """Return a value about as it stands in the file: null, true and false are YAML's words."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, datetime.date):
        return value.isoformat()
    if not isinstance(value, list | tuple | dict):
        return repr(value)
    if depth == DEEPEST:
        return "…"
    if isinstance(value, dict):
        pairs = (f"{_in_yaml(key, depth + 1)}: {_in_yaml(part, depth + 1)}" for key, part in value.items())
        return "{" + ", ".join(pairs) + "}"
    return "[" + ", ".join(_in_yaml(part, depth + 1) for part in value) + "]"
