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

Written from the models that check the file, by `python -m services.simulator.scenario_reference`; a test holds this
page to them. [Scenarios](scenarios.md) is the guide; metres, seconds, dB and degrees unless a line says otherwise.
"""
_MEANINGS = {
    "kind": "which one this is",
    "level": "which one this is",
    "line": "its corners on the plan, metres",
    "access_point": "an access point of the site",
    "camera": "a camera of the site",
    "id": "its name",
    "floor": "a floor of the site",
    "sensors": "how good its sensors are",
    "stride": "how its carrier steps",
    "habits": "how it is carried",
}
"""Of keys that say nothing of themselves."""
_SIGNS = ((Gt, "gt", "> "), (Ge, "ge", "≥ "), (Lt, "lt", "< "), (Le, "le", "≤ "))


def reference() -> str:
    """Return the page in Markdown."""
    places = dict(_places(Scenario, ""))
    return _HEAD + "".join(_section(part, place, places) for part, place in places.items())


def _places(part: type[Part], place: str, seen: tuple[type[Part], ...] = ()) -> Iterator[tuple[type[Part], str]]:
    """Yield ``part`` and the parts inside it, each with where it stands in the file; outer ones first."""
    yield part, place
    known = {part}
    for name, field in part.model_fields.items():
        inner_parts = _within(field.annotation)
        for inner in inner_parts:
            if inner in known or inner in seen:
                continue
            known.add(inner)
            many = "[]" if _is_list(field.annotation) else ""
            which = f" ({chosen})" if (chosen := _chosen_by(inner)) and len(inner_parts) > 1 else ""
            inside = f"{place.partition(' ')[0]}.{name}".lstrip(".") + many + which
            for found, where in _places(inner, inside, (*seen, *known)):
                known.add(found)
                yield found, where


def _is_list(annotation: Any) -> bool:
    return get_origin(annotation) is list or any(_is_list(part) for part in get_args(annotation))


def _chosen_by(part: type[Part]) -> str:
    """Return the value of ``kind`` or ``level`` by which a part is chosen among others."""
    for name in ("kind", "level"):
        field = part.model_fields.get(name)
        if field is not None and get_origin(field.annotation) is Literal:
            return str(get_args(field.annotation)[0])
    return ""


def _within(annotation: Any) -> list[type[Part]]:
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return [annotation]
    return [part for argument in get_args(annotation) for part in _within(argument)]


def _section(part: type[Part], place: str, places: dict[type[Part], str]) -> str:
    about = " ".join((part.__doc__ or "").strip().split("\n\n")[0].split()).replace("``", "`")
    if not about.endswith("."):
        about += "."
    title = f"`{place.partition(' ')[0]}`{place.partition(' ')[1]}{place.partition(' ')[2]}" if place else "The file"
    rows = "".join(_row(name, field, places) for name, field in part.model_fields.items())
    return (
        f'\n<a id="{part.__name__.lower()}"></a>\n\n## {title}\n\n{about}\n\n'
        f"| Key | Value | Default | Meaning |\n| --- | --- | --- | --- |\n{rows}"
    )


def _row(name: str, field: FieldInfo, places: dict[type[Part], str]) -> str:
    bounds = " ".join(_bounds(field.metadata))
    value = " ".join(filter(None, [_kind(field.annotation, places), bounds]))
    meaning = (field.description or _MEANINGS.get(name, "")).strip().replace("\n", " ")
    return f"| `{name}` | {_cell(value)} | {_cell(_default(field))} | {_cell(meaning)} |\n"


def _bounds(metadata: list[Any]) -> Iterator[str]:
    for entry in metadata:
        for kind, attribute, sign in _SIGNS:
            if isinstance(entry, kind):
                yield f"{sign}{getattr(entry, attribute):.10g}"
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
    if value in ("", []):
        return "empty"
    if isinstance(value, bool):
        return f"`{value}`".lower()
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{part:.10g}' if isinstance(part, float) else str(part) for part in value)}]`"
    return f"`{value:.10g}`" if isinstance(value, float) else f"`{value}`"


def _kind(annotation: Any, places: dict[type[Part], str]) -> str:
    """Return a type as the author of a file would say it."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in arguments)
    if origin is list:
        return f"list of {_kind(arguments[0], places)}"
    if origin is tuple:
        return f"[{', '.join(_kind(argument, places) for argument in arguments if argument is not Ellipsis)}]"
    if origin is dict:
        return f"mapping of {_kind(arguments[0], places)} to {_kind(arguments[1], places)}"
    if annotation is type(None):
        return "`null`"
    if isinstance(annotation, type):
        if issubclass(annotation, Part):
            label = _chosen_by(annotation) or places[annotation].partition(" ")[0]
            return f"[`{label}`](#{annotation.__name__.lower()})"
        return {int: "whole number", float: "number", bool: "true or false", str: "text", Path: "path"}.get(
            annotation, annotation.__name__
        )
    if hasattr(annotation, "__metadata__"):
        bounds = " ".join(_bounds(list(annotation.__metadata__)))
        return " ".join(filter(None, [_kind(arguments[0], places), bounds]))
    return " or ".join(filter(None, (_kind(argument, places) for argument in arguments)))


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    sys.stdout.write(reference())
