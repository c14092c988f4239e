"""Read a YAML document into a checked object; every mistake names the file, the path inside it, the value, the allowed.

The site file and the scenario file are such documents: a tree of ``Part``s.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from shared.redaction import redact_url

__all__ = ["Part", "PartFileError", "read_part_file"]


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
        message = problem["msg"].removeprefix("Value error, ")
        value = problem["input"]
        shown = "" if isinstance(value, dict) or problem["type"] == "missing" else f" (found {_shorten(value)})"
        if problem["type"] == "extra_forbidden":
            message, shown = f"unknown key; allowed here: {', '.join(part.model_fields)}", ""
        elif problem["type"] == "string_type":
            message = "must be text; write it in quotes"
        elif problem["type"] in ("model_type", "model_attributes_type"):
            message = "must be a mapping of keys to values"
        elif problem["type"].startswith("union_tag"):
            key = str(problem.get("ctx", {}).get("discriminator", "'kind'")).strip("'")
            found = f" (found {_shorten(value[key])})" if isinstance(value, dict) and key in value else ""
            place, message = f"{place}.{key}", f"must be one of {', '.join(_tags(choices, key))}{found}"
        lines.append(f"{path}: {place or 'document'}: {message}{shown}")
    return "\n".join(lines)


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
    text = redact_url(repr(value))
    return text if len(text) <= 120 else text[:117] + "..."
