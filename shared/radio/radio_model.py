"""What was learned of a site's radio: path-loss constants and shadowing, one model in one file."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from shared.messages import RadioModelFile
from shared.radio.path_loss import PathLoss
from shared.radio.shadowing_map import ShadowingMap

__all__ = [
    "RadioModel",
    "RadioModelError",
    "pack_radio_model",
    "read_radio_model",
    "unpack_radio_model",
    "write_radio_model",
]


class RadioModelError(ValueError):
    """A file holds no radio model, or not one of this site: the text names the file and what was expected."""


@dataclass(frozen=True)
class RadioModel:
    """Path loss and what it gets wrong, of the same access points in the same order; ``site`` is the site's id.

    ``located`` names the access points whose place was learned; where the others stand is for the site file to say, and
    if it does not they are not placed.
    """

    site: str
    path_loss: PathLoss
    shadowing: ShadowingMap
    located: tuple[str, ...] = ()

    def over(self, filed: PathLoss) -> RadioModel:
        """Return the model at a site: what it has not located hangs where the site file says, or nobody knows where.

        Args:
            filed: path loss as the site file says, of the same access points in the same order.
        """
        located = np.isin(filed.names, self.located)
        positions = np.where(located[:, None], self.path_loss.positions, filed.positions)
        return dataclasses.replace(self, path_loss=dataclasses.replace(self.path_loss, positions=positions))


def write_radio_model(model: RadioModel, path: Path) -> None:
    """Write a model as JSON; levels are kept to a thousandth of a dB."""
    path.write_bytes(msgspec.json.encode(pack_radio_model(model)))


def pack_radio_model(model: RadioModel, located: Sequence[str] = ()) -> RadioModelFile:
    """Return the model as files and messages hold it; ``located`` names the access points whose place was learned."""
    loss, shadowing = model.path_loss, model.shadowing
    return RadioModelFile(
        format="atrium-radio-model/1",
        site=model.site,
        access_points=list(loss.names),
        positions=[
            tuple(place) if placed else None
            for place, placed in zip(loss.positions.tolist(), loss.placed.tolist(), strict=True)
        ],
        power_1m=loss.power_1m.tolist(),
        exponent=loss.exponent.tolist(),
        origin=(float(shadowing.origin[0]), float(shadowing.origin[1])),
        cell=shadowing.cell,
        mean=np.round(shadowing.mean, 3).tolist(),
        variance=np.round(shadowing.variance, 3).tolist(),
        located=list(located or model.located),
    )


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
        file = msgspec.json.decode(path.read_bytes(), type=RadioModelFile)
    except OSError as error:
        raise RadioModelError(f"{path}: {error.strerror}") from error
    except msgspec.DecodeError as error:
        raise RadioModelError(f"{path}: not a radio model: {error}") from error
    try:
        return unpack_radio_model(file, site, names)
    except RadioModelError as error:
        raise RadioModelError(f"{path}: {error}") from error


def unpack_radio_model(file: RadioModelFile, site: str, names: tuple[str, ...]) -> RadioModel:
    """Return the model of a file or message, its access points in the order of ``names``.

    Raises:
        RadioModelError: it is of another site or other access points, or its columns do not fit each other.
    """
    if file.site != site:
        raise RadioModelError(f"learned at site {file.site!r}, expected {site!r}")
    known = file.access_points
    if sorted(known) != sorted(names):
        missing, strange = sorted(set(names) - set(known)), sorted(set(known) - set(names))
        parts = [f"lacks {', '.join(missing)}"] * bool(missing) + [f"has {', '.join(strange)}"] * bool(strange)
        raise RadioModelError(f"other access points than the site's: {'; '.join(parts) or 'some are doubled'}")
    lengths = {len(column) for column in (known, file.positions, file.power_1m, file.exponent)}
    try:
        mean, variance = np.array(file.mean), np.array(file.variance)
    except ValueError as error:
        raise RadioModelError("the rows of a map differ in length") from error
    if len(lengths) > 1 or mean.ndim != 3 or mean.shape != variance.shape or len(mean) != len(known) or not mean.size:
        raise RadioModelError(f"columns and maps are not of one shape with the {len(known)} access points")
    strangers = sorted(set(file.located) - set(names))
    if strangers:
        raise RadioModelError(f"located: {strangers[0]!r} is none of its access points")
    nowhere = sorted(name for name, place in zip(known, file.positions, strict=True) if place is None)
    if lost := sorted(set(file.located) & set(nowhere)):
        raise RadioModelError(f"positions: found null for {lost[0]!r}; allowed: where it hangs, for it is in located")
    order = np.array([known.index(name) for name in names], np.int64)
    path_loss = PathLoss(
        names=names,
        positions=np.array([place or (np.nan,) * 3 for place in file.positions], float).reshape(-1, 3)[order],
        power_1m=np.array(file.power_1m)[order],
        exponent=np.array(file.exponent)[order],
    )
    shadowing = ShadowingMap(names, np.array(file.origin), file.cell, mean[order], variance[order])
    return RadioModel(site, path_loss, shadowing, tuple(file.located))
