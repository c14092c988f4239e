"""A radio model as it is asked about: corrected access points, a map of what they leave unexplained.

``{"kind": "radio", "access_points": {ID: {"power_1m": dBm, "path_loss_exponent": n, "position": [x, y, z]}},
"shadowing": {"names": [ID], "origin": [x, y], "cell": metres, "mean": [per name][row][column] dB, "variance": likewise
dB²}}``; either part may be left out, and access points that are not named keep what the active model says. Or the whole
of it: ``{"kind": "radio", "model": RadioModelFile}``, null for what the site file says.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.trained_view import believable_place, under_model
from shared.messages import RadioModelFile
from shared.radio import PathLoss, RadioModelError, RadioNoise, ShadowingMap

__all__ = ["CandidateError", "RadioCandidate", "Windowed", "with_radio"]

POWER = (-110.0, 0.0)
EXPONENT = (1.0, 6.0)
CELL = (0.1, 10.0)
LARGEST_MEAN = 60.0
"""dB."""


class CandidateError(ValueError):
    """The candidate cannot be tried: the text names the field, the value found and what is allowed."""


class _AccessPoint(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    power_1m: float | None = None
    path_loss_exponent: float | None = None
    position: tuple[float, float, float] | None = None


class _Shadowing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    names: list[str]
    origin: tuple[float, float]
    cell: float
    mean: list[list[list[float]]]
    variance: list[list[list[float]]]


class Windowed(msgspec.Struct, frozen=True, kw_only=True):
    """What every question may say: seconds since the epoch; only what was withheld in between is scored."""

    since: float | None = None
    until: float | None = None


class RadioCandidate(Windowed, frozen=True, kw_only=True, tag_field="kind", tag="radio"):
    """Another radio model."""

    access_points: dict[str, _AccessPoint] = {}
    shadowing: _Shadowing | None = None
    model: RadioModelFile | msgspec.UnsetType | None = msgspec.UNSET


def with_radio(model: RadioCandidate, view: AreaView) -> AreaView:
    """Return the view with its radio as the model says.

    Raises:
        CandidateError: naming the field, the value found and what is allowed.
    """
    parts = bool(model.access_points) or model.shadowing is not None
    if model.model is not msgspec.UNSET:
        if parts:
            raise CandidateError(
                "model: found beside access_points or shadowing; allowed: a whole model or parts of one"
            )
        try:
            return under_model(view, model.model)
        except RadioModelError as error:
            raise CandidateError(f"model: {error}") from error
    if not parts:
        raise CandidateError("access_points, shadowing, model: found neither; allowed: one of them")
    known = view.radio.names
    power, exponent = view.radio.power_1m.copy(), view.radio.exponent.copy()
    positions = view.radio.positions.copy()
    for name, point in model.access_points.items():
        where = f"access_points.{name}"
        if name not in known:
            raise CandidateError(f"{where}: no access point of floor {view.floor}; allowed: {', '.join(known)}")
        index = known.index(name)
        if point.power_1m is not None:
            power[index] = _within(f"{where}.power_1m", point.power_1m, POWER)
        if point.path_loss_exponent is not None:
            exponent[index] = _within(f"{where}.path_loss_exponent", point.path_loss_exponent, EXPONENT)
        if point.position is not None:
            if not believable_place(view, point.position):
                raise CandidateError(
                    f"{where}.position: found {list(point.position)}; allowed: about floor {view.floor}"
                )
            positions[index] = point.position
    radio = PathLoss(known, positions, power, exponent)
    if model.shadowing is None and view.shadowing is not None and model.access_points:
        name = next(iter(model.access_points))
        raise CandidateError(
            f"shadowing: missing; allowed: a map that goes with the constants of {name}, for the active map corrects "
            "the active constants"
        )
    shadowing = view.shadowing if model.shadowing is None else _map(model.shadowing, view)
    return dataclasses.replace(view, radio=radio, shadowing=shadowing)


def _map(stored: _Shadowing, view: AreaView) -> ShadowingMap:
    """Return the map, its access points in the order of ``view``; of one it does not name the active map stands."""
    known, floor = view.radio.names, view.floor
    _within("shadowing.cell", stored.cell, CELL)
    if len(set(stored.names)) != len(stored.names):
        raise CandidateError(f"shadowing.names: found {stored.names!r}; allowed: each once")
    strangers = [name for name in stored.names if name not in known]
    if strangers:
        raise CandidateError(
            f"shadowing.names: {strangers[0]!r} is no access point of floor {floor}; allowed: {', '.join(known)}"
        )
    mean, variance = (_grid(name, getattr(stored, name), len(stored.names)) for name in ("mean", "variance"))
    if mean.shape != variance.shape:
        raise CandidateError(f"shadowing.variance: found {variance.shape}; allowed: the shape of mean, {mean.shape}")
    if np.abs(mean).max(initial=0.0) > LARGEST_MEAN:
        raise CandidateError(f"shadowing.mean: found {np.abs(mean).max():g} dB; allowed: at most {LARGEST_MEAN:g}")
    if (variance < 0.0).any():
        raise CandidateError(f"shadowing.variance: found {variance.min():g} dB²; allowed: 0 or more")
    shape = (len(known), *mean.shape[1:])
    ordered_mean, ordered_variance = np.zeros(shape), np.full(shape, RadioNoise().shadowing ** 2)
    if view.shadowing is not None:
        y, x = np.divmod(np.arange(shape[1] * shape[2]), shape[2])
        active = view.shadowing.at(np.array(stored.origin) + stored.cell * np.column_stack([x, y]))
        ordered_mean, ordered_variance = (grid.T.reshape(shape).copy() for grid in active)
    rows = [known.index(name) for name in stored.names]
    ordered_mean[rows], ordered_variance[rows] = mean, variance
    return ShadowingMap(known, np.array(stored.origin), stored.cell, ordered_mean, ordered_variance)


def _grid(name: str, value: Any, names: int) -> Any:
    try:
        grid = np.array(value, float)
    except ValueError:
        raise CandidateError(f"shadowing.{name}: found rows of different lengths; allowed: all of one") from None
    if grid.ndim != 3 or len(grid) != names or 0 in grid.shape:
        raise CandidateError(
            f"shadowing.{name}: found shape {grid.shape}; allowed: ({names} names, 1 or more rows, 1 or more columns)"
        )
    return grid


def _within(field: str, value: float, allowed: tuple[float, float]) -> float:
    if not allowed[0] <= value <= allowed[1]:
        raise CandidateError(f"{field}: found {value:g}; allowed: {allowed[0]:g} … {allowed[1]:g}")
    return value
