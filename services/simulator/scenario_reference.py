"""Every key of a scenario file as a page: ``python -m services.simulator.scenario_reference`` prints it.

Written from the models that check the file, so that page and check cannot differ.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from services.simulator.scenario_file import Scenario
from shared.part_file import Part

__all__ = ["reference"]

_HEAD = """# Every key of a scenario file

Written from the models that check the file (`python -m services.simulator.scenario_reference`); a test holds this page
to them. [Scenarios](scenarios.md) is the guide; metres, seconds, dB and degrees unless a line says otherwise.
"""
_SIGNS = ((Gt, "gt", "> "), (Ge, "ge", "≥ "), (Lt, "lt", "< "), (Le, "le", "≤ "))


def reference() -> str:
    """Return the page in Markdown."""
    return _HEAD + "".join(_section(part) for part in _parts(Scenario))


def _parts(root: type[Part]) -> Iterator[type[Part]]:
    """Yield ``root`` and the parts inside it, each once, outer ones first."""
    waiting, seen = [root], {root}
    while waiting:
        part = waiting.pop(0)
        yield part
        for field in part.model_fields.values():
            for inner in _within(field.annotation):
                if inner not in seen:
                    seen.add(inner)
                    waiting.append(inner)


def _within(annotation: Any) -> list[type[Part]]:
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return [annotation]
    return [part for argument in get_args(annotation) for part in _within(argument)]


def _section(part: type[Part]) -> str:
    about = (part.__doc__ or "").strip().splitlines()[0]
    rows = "".join(_row(name, field) for name, field in part.model_fields.items())
    return f"\n## {part.__name__}\n\n{about}\n\n| Key | Value | Default | Meaning |\n| --- | --- | --- | --- |\n{rows}"


def _row(name: str, field: FieldInfo) -> str:
    bounds = " ".join(_bounds(field.metadata))
    value = " ".join(filter(None, [_kind(field.annotation), bounds]))
    meaning = (field.description or "").strip().replace("\n", " ")
    return f"| `{name}` | {_cell(value)} | {_cell(_default(field))} | {_cell(meaning)} |\n"


def _bounds(metadata: list[Any]) -> Iterator[str]:
    for entry in metadata:
        for kind, attribute, sign in _SIGNS:
            if isinstance(entry, kind):
                yield f"{sign}{getattr(entry, attribute):g}"
        if isinstance(entry, MinLen) and entry.min_length:
            yield f"at least {entry.min_length}"
        if isinstance(entry, MaxLen):
            yield f"at most {entry.max_length}"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**needed**"
    value = field.default if field.default is not PydanticUndefined else field.get_default(call_default_factory=True)
    if value is None:
        return "none"
    if isinstance(value, Part):
        return "its defaults"
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{part:g}' if isinstance(part, float) else str(part) for part in value)}]`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def _kind(annotation: Any) -> str:
    """Return a type as the author of a file would say it."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in arguments)
    if origin is list:
        return f"list of {_kind(arguments[0])}"
    if origin is tuple:
        return f"[{', '.join(_kind(argument) for argument in arguments if argument is not Ellipsis)}]"
    if origin is dict:
        return f"mapping of {_kind(arguments[0])} to {_kind(arguments[1])}"
    if annotation is type(None):
        return ""
    if isinstance(annotation, type):
        if issubclass(annotation, Part):
            return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
        return {int: "whole number", float: "number", bool: "true or false", str: "text", Path: "path"}.get(
            annotation, annotation.__name__
        )
    if hasattr(annotation, "__metadata__"):
        bounds = " ".join(_bounds(list(annotation.__metadata__)))
        return " ".join(filter(None, [_kind(arguments[0]), bounds]))
    return " or ".join(filter(None, (_kind(argument) for argument in arguments)))


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(reference())
