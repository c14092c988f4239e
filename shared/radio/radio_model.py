"""What was learned of a site's radio: path-loss constants and shadowing, one model in one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from shared.radio.path_loss import PathLoss
from shared.radio.shadowing_map import ShadowingMap

__all__ = ["RadioModel", "RadioModelError", "read_radio_model", "write_radio_model"]

Axes = tuple[float, float, float]


class RadioModelError(ValueError):
    """A file holds no radio model, or not one of this site: the text names the file and what was expected."""


@dataclass(frozen=True)
class RadioModel:
    """Path loss and what it gets wrong, of the same access points in the same order; ``site`` is the site's id."""

    site: str
    path_loss: PathLoss
    shadowing: ShadowingMap


class _File(msgspec.Struct, frozen=True, kw_only=True):
    """The form of the file: JSON that a person can read; dB, dB² and metres."""

    format: Literal["atrium-radio-model/1"]
    site: str
    access_points: list[str]
    positions: list[Axes]
    power_1m: list[float]
    exponent: list[float]
    origin: tuple[float, float]
    cell: Annotated[float, Meta(gt=0.0)]
    mean: list[list[list[float]]]
    variance: list[list[list[Annotated[float, Meta(ge=0.0)]]]]


def write_radio_model(model: RadioModel, path: Path) -> None:
    """Write a model as JSON; levels are kept to a thousandth of a dB."""
    loss, shadowing = model.path_loss, model.shadowing
    file = _File(
        format="atrium-radio-model/1",
        site=model.site,
        access_points=list(loss.names),
        positions=[tuple(place) for place in loss.positions.tolist()],
        power_1m=loss.power_1m.tolist(),
        exponent=loss.exponent.tolist(),
        origin=(float(shadowing.origin[0]), float(shadowing.origin[1])),
        cell=shadowing.cell,
        mean=np.round(shadowing.mean, 3).tolist(),
        variance=np.round(shadowing.variance, 3).tolist(),
    )
    path.write_bytes(msgspec.json.encode(file))


def read_radio_model(path: Path, site: str, names: tuple[str, ...]) -> RadioModel:
    """Read the model of a site.

    Args:
        path: the file.
        site: the id of the site it must be of.
        names: the access points it must be of, in the order the reader wants them.

    Raises:
        RadioModelError: no such file, not a radio model, or of another site or other access points.
    """
    try:
        file = msgspec.json.decode(path.read_bytes(), type=_File)
    except OSError as error:
        raise RadioModelError(f"{path}: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise RadioModelError(f"{path}: not a radio model: {error}") from error
    if file.site != site:
        raise RadioModelError(f"{path}: learned at site {file.site!r}, expected {site!r}")
    known = file.access_points
    if sorted(known) != sorted(names):
        missing, strange = sorted(set(names) - set(known)), sorted(set(known) - set(names))
        parts = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has {', '.join(strange)}"] * bool(strange)
        raise RadioModelError(f"{path}: other access points than the site's: {'; '.join(parts) or 'some are doubled'}")
    lengths = {len(column) for column in (known, file.positions, file.power_1m, file.exponent)}
    try:
        mean, variance = np.array(file.mean), np.array(file.variance)
    except ValueError as error:
        raise RadioModelError(f"{path}: the rows of a map differ in length") from error
    if len(lengths) > 1 or mean.ndim != 3 or mean.shape != variance.shape or len(mean) != len(known) or not mean.size:
        raise RadioModelError(f"{path}: columns and maps are not of one shape with the {len(known)} access points")
    order = np.array([known.index(name) for name in names], np.int64)
    path_loss = PathLoss(
        names=names,
        positions=np.array(file.positions)[order],
        power_1m=np.array(file.power_1m)[order],
        exponent=np.array(file.exponent)[order],
    )
    shadowing = ShadowingMap(names, np.array(file.origin), file.cell, mean[order], variance[order])
    return RadioModel(site, path_loss, shadowing)
