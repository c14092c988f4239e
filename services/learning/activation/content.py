"""What a model may say: the one place that knows, asked of everything that may go live or come in."""

from __future__ import annotations

import math
from collections.abc import Iterable

from services.learning.activation.kinds import kind_of, subject_of
from shared.camera_limits import alignment_problem, calibration_problem, options_problem
from shared.keys import is_identifier
from shared.messages import (
    CameraAlignment,
    DetectorSettings,
    HeadingModel,
    Message,
    RadioModelFile,
    RadioModelUpdate,
    StrideModel,
)
from shared.site import Camera, Site
from shared.site.footprint import Ring, footprint
from shared.site.geometry_digest import geometry_digest

__all__ = ["Contents"]

Range = tuple[float, float]
SLOPE: Range = (-5.0, 5.0)
OFFSET: Range = (-10.0, 10.0)
TURN: Range = (-2.0 * math.pi, 2.0 * math.pi)
SPREAD: Range = (0.0, 100.0)
"""Of a stride's factor, and rad² of a heading."""
POWER: Range = (-150.0, 50.0)
EXPONENT: Range = (0.0, 20.0)
LEVEL: Range = (-200.0, 200.0)
VARIANCE: Range = (0.0, 40_000.0)
PLACE: Range = (-1e6, 1e6)
CELL: Range = (0.01, 1000.0)
"""All far beyond what was ever learned: what lies outside is no model, whatever it is called."""


class Contents:
    """Knows what models may say.

    Args:
        site: its cameras' views are held against alignments; None: they are not.
    """

    def __init__(self, site: Site | None = None) -> None:
        self._site = site
        self._seen: dict[str, Ring] = {}

    def problem(self, model: Message) -> str:
        """Return why a model may not go live, as "field: found …; allowed: …"; empty: it may."""
        subject = subject_of(model)
        if not is_identifier(subject):
            allowed = "1 to 64 of the letters, digits, '_', '.' and '-'"
            return f"{kind_of(model)} model: found a subject called {subject[:64]!r}; allowed: {allowed}"
        match model:
            case StrideModel():
                return _first(
                    _within("slope", [model.slope], SLOPE),
                    _within("offset", [model.offset], OFFSET),
                    _within("scale_variance", [model.scale_variance], SPREAD),
                )
            case HeadingModel():
                return _first(_within("bias", [model.bias], TURN), _within("variance", [model.variance], SPREAD))
            case DetectorSettings():
                return options_problem(model.options)
            case CameraAlignment():
                return alignment_problem(model.homography, self._floor_of(model.camera)) or self.outlived(model)
            case RadioModelUpdate():
                return "" if model.model is None else _radio(model.model)
        return ""

    def outlived(self, model: Message) -> str:
        """Return why a model is one of a calibration that its camera has no more; empty: it is not."""
        if not isinstance(model, CameraAlignment) or (camera := self._camera(model.camera)) is None:
            return ""
        return calibration_problem(model.homography, model.geometry, geometry_digest(camera.geometry))

    def _camera(self, camera: str) -> Camera | None:
        cameras = [] if self._site is None else self._site.cameras
        return next((one for one in cameras if one.id == camera), None)

    def _floor_of(self, camera: str) -> Ring:
        """Return the floor a camera sees; none where that is not known."""
        one = self._camera(camera)
        if self._site is None or one is None:
            return []
        if camera not in self._seen:
            outline = self._site.floor(self._site.area(one.area).floor).plan().outline
            self._seen[camera] = footprint(one.geometry.build(), one.area_of_interest, outline)
        return self._seen[camera]


def _radio(file: RadioModelFile) -> str:
    """Return what is wrong with the numbers of a radio model; whose it is is asked elsewhere."""
    return _first(
        _within("model.positions", (value for place in file.positions if place for value in place), PLACE),
        _within("model.power_1m", file.power_1m, POWER),
        _within("model.exponent", file.exponent, EXPONENT),
        _within("model.origin", file.origin, PLACE),
        _within("model.cell", [file.cell], CELL),
        _within("model.mean", (value for grid in file.mean for row in grid for value in row), LEVEL),
        _within("model.variance", (value for grid in file.variance for row in grid for value in row), VARIANCE),
    )


def _within(field: str, values: Iterable[float], allowed: Range) -> str:
    for value in values:
        if not allowed[0] <= value <= allowed[1]:  # NaN is not within either
            return f"{field}: found {value:g}; allowed: {allowed[0]:g} to {allowed[1]:g}"
    return ""


def _first(*problems: str) -> str:
    return next(filter(None, problems), "")
