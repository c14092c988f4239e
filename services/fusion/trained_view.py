"""An area as a radio model sees it: the site file's, or one that was learned."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from shared.messages import RadioModelFile
from shared.radio import RadioModel, RadioModelError, read_radio_model, unpack_radio_model
from shared.site import Site

__all__ = ["believable_place", "radio_digest", "same_radio", "trained_view", "under_model"]

POWER = (-150.0, 50.0)
"""dBm a metre away; what is outside was not learned of a transmitter …"""
EXPONENT = (0.0, 10.0)
"""… nor this of a room."""
CELL = (0.1, 50.0)
"""Metres."""
LARGEST_MEAN = 100.0
"""dB; and that squared, its variance."""
MOST_CELLS = 4_000_000
"""Of all access points' maps together."""
AROUND = 100.0
"""Metres from the floor's borders within which an access point may hang that is heard there."""
HEIGHT = (-500.0, 2000.0)
"""Metres above the site's zero, likewise."""


def trained_view(site: Site, area: str, radio_model: Path | None) -> AreaView:
    """Return the view of one area, its radio as a file of ``shared.radio.radio_model`` says (None: as the site file).

    Raises:
        KeyError: the site has no such area.
        RadioModelError: the file is no radio model of this floor's access points.
    """
    view = AreaView.of(site, area)
    if radio_model is None:
        return view
    return _with_model(view, read_radio_model(radio_model, site.site, view.radio.names))


def under_model(view: AreaView, file: RadioModelFile | None) -> AreaView:
    """Return the view with its radio as a model says; None: as the site file says.

    Raises:
        RadioModelError: it is of another site or other access points, or holds what nobody can have learned.
    """
    if file is None:
        return dataclasses.replace(view, radio=view.filed, shadowing=None)
    model = unpack_radio_model(file, view.site, view.radio.names)
    _check(model, view)
    return _with_model(view, model)


def radio_digest(view: AreaView) -> str:
    """Return what tells one radio model from another: access points, their places, constants and shadowing."""
    radio, shadowing = view.radio, view.shadowing
    arrays = [radio.positions, radio.power_1m, radio.exponent]
    if shadowing is not None:
        arrays += [shadowing.origin, np.array(shadowing.cell), shadowing.mean, shadowing.variance]
    digest = hashlib.sha256(msgspec.json.encode(radio.names))
    for array in arrays:
        digest.update(np.ascontiguousarray(array, float).tobytes())
    return digest.hexdigest()


def same_radio(one: AreaView, other: AreaView) -> bool:
    """Whether two views of an area expect the same of its radio."""
    same = one.radio is other.radio and one.shadowing is other.shadowing
    return same or radio_digest(one) == radio_digest(other)


def believable_place(view: AreaView, place: tuple[float, float, float]) -> bool:
    """Whether an access point that is heard on the floor may hang there, metres."""
    x, y, z = place
    low, high = view.lower - AROUND, view.upper + AROUND
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1] and HEIGHT[0] <= z <= HEIGHT[1])


def _with_model(view: AreaView, model: RadioModel) -> AreaView:
    return dataclasses.replace(view, radio=model.over(view.filed).path_loss, shadowing=model.shadowing)


def _check(model: RadioModel, view: AreaView) -> None:
    loss, shadowing = model.path_loss, model.shadowing
    for field, values, (least, most) in (
        ("power_1m", loss.power_1m, POWER),
        ("exponent", loss.exponent, EXPONENT),
        ("cell", np.array([shadowing.cell]), CELL),
        ("mean", shadowing.mean, (-LARGEST_MEAN, LARGEST_MEAN)),
        ("variance", shadowing.variance, (0.0, LARGEST_MEAN**2)),
    ):
        wrong = values[~((values >= least) & (values <= most))]
        if wrong.size:
            raise RadioModelError(f"{field}: found {wrong.flat[0]:g}; allowed: {least:g} … {most:g}")
    if shadowing.mean.size > MOST_CELLS:
        raise RadioModelError(f"mean: found {shadowing.mean.size} cells; allowed: at most {MOST_CELLS}")
    for name in model.located:
        place = tuple(loss.positions[loss.names.index(name)].tolist())
        if not believable_place(view, place):
            raise RadioModelError(f"positions: {name} at {place}; allowed: within {AROUND:g} m of floor {view.floor}")
