"""Read a site file and check it whole before anything starts.

Every mistake is one message that names the file, the path inside it, the value found and what is allowed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml
from pydantic import ValidationError

from shared.site.camera_geometry import GeometryError
from shared.site.site_file import Part, PointsGeometry, PoseGeometry, Site, TsaiGeometry, redact_url

__all__ = ["SiteError", "load_site"]


class SiteError(ValueError):
    """The site file cannot be used: the text names file, path inside it, value and what is allowed."""


def load_site(path: str | Path) -> Site:
    """Read and check a site file.

    Raises:
        SiteError: the file is missing, is not YAML, or anything in it is wrong; all mistakes are named at once.
    """
    path = Path(path)
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), _Loader)  # noqa: S506 (derives from the safe loader)
    except OSError as error:
        raise SiteError(f"{path}: cannot be read: {error.strerror}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        hint = "; indent with spaces" if "'\\t'" in str(error.problem) else ""
        raise SiteError(f"{path}{place}: not YAML: {error.problem or error.context}{hint}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise SiteError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(document, dict):
        found = "nothing" if document is None else type(document).__name__
        raise SiteError(f"{path}: must hold a mapping with 'format', 'site', 'floors' …, found {found}")
    try:
        site = Site.model_validate(document, context={"folder": path.parent.resolve()})
    except ValidationError as error:
        raise SiteError(_explain(path, error)) from error
    problems = list(_cross_check(site))
    if problems:
        raise SiteError("\n".join(f"{path}: {problem}" for problem in problems))
    return site


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


_VARIANTS: dict[str, type[Part]] = {"tsai": TsaiGeometry, "points": PointsGeometry, "pose": PoseGeometry}


def _explain(path: Path, error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        place, part = _place(problem["loc"])
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
            found = f" (found {_shorten(value['kind'])})" if "kind" in value else ""
            place, message = f"{place}.kind", f"must be one of {', '.join(_VARIANTS)}{found}"
        lines.append(f"{path}: {place or 'document'}: {message}{shown}")
    return "\n".join(lines)


def _place(steps: Sequence[int | str]) -> tuple[str, type[Part]]:
    """Return the path inside the file as its author would write it, and the part that holds its last step."""
    place = ""
    part: type[Part] = Site
    inner: type[Part] | None = Site
    for index, step in enumerate(steps):
        if isinstance(step, int):
            place += f"[{step}]"
        elif index and steps[index - 1] == "geometry" and step in _VARIANTS:
            # pydantic puts the chosen variant of a tagged union into the path; the file has no such level.
            inner = _VARIANTS[step]
        else:
            place += f".{step}" if place else step
            part = inner or part
            field = part.model_fields.get(step)
            inner = None if field is None else _part_within(field.annotation)
    return place, part


def _part_within(annotation: Any) -> type[Part] | None:
    """Return the part named somewhere inside a type such as ``list[Floor]``; of a union the last."""
    if isinstance(annotation, type) and issubclass(annotation, Part):
        return annotation
    found = [part for argument in get_args(annotation) if (part := _part_within(argument)) is not None]
    return found[-1] if found else None


def _shorten(value: object) -> str:
    text = redact_url(repr(value))
    return text if len(text) <= 120 else text[:117] + "..."


def _cross_check(site: Site) -> Iterable[str]:
    """Yield what single fields cannot show: names used twice, names that lead nowhere, cameras that see no floor."""
    for name in ("floors", "areas", "cameras", "access_points", "zones"):
        counts = Counter(part.id for part in getattr(site, name))
        yield from (
            f"{name}: id {key!r} is used {count} times, ids must differ" for key, count in counts.items() if count > 1
        )
    addresses = Counter(address.lower() for point in site.access_points for address in point.addresses)
    for address, count in addresses.items():
        if count > 1:
            yield f"access_points: address {address!r} stands at {count} places; one address, one access point"
    for index, floor in enumerate(site.floors):
        for key, count in Counter(obstacle.id for obstacle in floor.obstacles).items():
            if count > 1:
                yield f"floors[{index}].obstacles: id {key!r} is used {count} times, ids must differ"
    floors = {floor.id for floor in site.floors}
    areas = {area.id for area in site.areas}
    for name in ("areas", "access_points", "zones"):
        for index, part in enumerate(getattr(site, name)):
            if part.floor not in floors:
                yield f"{name}[{index}].floor: {part.floor!r} is no floor; allowed: {', '.join(sorted(floors))}"
    for index, camera in enumerate(site.cameras):
        if camera.area not in areas:
            yield f"cameras[{index}].area: {camera.area!r} is no area; allowed: {', '.join(sorted(areas))}"
        try:
            geometry = camera.geometry.build()
        except GeometryError as error:
            yield f"cameras[{index}].geometry: {error}"
            continue
        if geometry.position[2] <= 0.0:
            height = geometry.position[2]
            yield f"cameras[{index}].geometry: the camera hangs {height:.2f} m above its floor; allowed: > 0"
            continue
        width, height = geometry.image_size
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 16)), axis=-1)
        if not np.isfinite(geometry.to_ground(grid.reshape(-1, 2))).any():
            yield f"cameras[{index}].geometry: no pixel of this camera sees the floor"
        for u, v in camera.area_of_interest or []:
            if not (0 <= u <= width and 0 <= v <= height):
                yield f"cameras[{index}].area_of_interest: ({u:g}, {v:g}) lies outside the {width} x {height} picture"
                break
