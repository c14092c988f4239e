"""What did a real detector see? Detections read from a file, in place of simulated ones.

Two forms. ``mot``: the MOT challenge's det.txt, one box per line, ``frame, id, left, top, width, height, confidence``
(more columns are ignored); frames and pixels count from 1. ``csv``: a header ``t,x,y`` and, as far as known,
``confidence`` and ``left,top,width,height``; seconds of the world, metres on the plan, pixels counted from 0.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from services.simulator.cameras.detection_frames import FramePublisher, frame_numbers
from services.simulator.cameras.visibility import project_bodies
from services.simulator.people import People
from shared.messages import DetectionFrame
from shared.site import Camera, CameraGeometry
from shared.site.site_file import Number, Part

__all__ = ["DetectionFileError", "FileDetectionParameters", "FileDetections"]

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_TALL = 1.75
"""Metres: how tall people are taken to be where the file has no boxes."""
_MOT_COLUMNS = 7


class DetectionFileError(ValueError):
    """The file cannot be used: the text names file, line, value and what is allowed."""


class FileDetectionParameters(Part):
    """How a file of detections is to be read."""

    format: Literal["mot", "csv"] = Field("mot", description="mot: boxes in pixels; csv: t,x,y in metres")
    frames_per_s: Number = Field(15.0, gt=0, le=240, description="of the camera that made them")
    least_confidence: Number = Field(
        -1e9, description="what is less sure is left out; in the file's own measure (PETS: 20)"
    )
    full_confidence: Number = Field(
        1.0, gt=0, description="confidence of the file that is certainty; published ones are shares of it, at most 1"
    )


@dataclass(frozen=True, slots=True)
class _Rows:
    number: Ints
    foot: Array
    box: Array  # left, top, right, bottom
    confidence: Array


class FileDetections:
    """One camera's detections from a file; asked as ``DetectionModel`` is. People are ignored: the file saw others.

    Args:
        camera: geometry and area of interest; pixels of the file are of the geometry's image size.
        floor: id of the floor it watches.
        file: of detections.
        parameters: how it is to be read.

    Raises:
        DetectionFileError: it cannot be read.
    """

    def __init__(self, camera: Camera, floor: str, file: Path, parameters: FileDetectionParameters) -> None:
        self._publisher = FramePublisher(camera, floor, parameters.frames_per_s)
        self.frames_per_s = parameters.frames_per_s
        mot = parameters.format == "mot"
        rows = _read_mot(file) if mot else _read_csv(file, parameters.frames_per_s, self._publisher.geometry)
        order = np.lexsort((rows.number,))
        order = order[rows.confidence[order] >= parameters.least_confidence]
        confidence = np.clip(rows.confidence[order] / parameters.full_confidence, 0.0, 1.0)
        self._rows = _Rows(rows.number[order], rows.foot[order], rows.box[order], confidence)

    def frames(self, people: People | None, start: float, end: float) -> list[DetectionFrame]:
        """Return the frames taken in [start, end), seconds of the world; empty ones are among them."""
        numbers = frame_numbers(self.frames_per_s, start, end)
        if not numbers.size:
            return []
        rows = self._rows
        a, b = np.searchsorted(rows.number, [numbers[0], numbers[-1] + 1])
        place = rows.number[a:b] - numbers[0]
        return self._publisher.frames(numbers, place, rows.foot[a:b], rows.box[a:b], rows.confidence[a:b])


def _read_mot(file: Path) -> _Rows:
    table: list[list[float]] = []
    for line, text in enumerate(_lines(file), 1):
        if text.strip():
            fields = text.replace(",", " ").split()
            if len(fields) < _MOT_COLUMNS:
                found = f"{len(fields)} columns"
                raise DetectionFileError(
                    f"{file}, line {line}: {found}; needed: frame, id, left, top, width, height, confidence"
                )
            table.append([_number(file, line, field) for field in fields[:_MOT_COLUMNS]])
            frame, _, _, _, width, height, _ = table[-1]
            if frame < 1 or width <= 0 or height <= 0:
                raise DetectionFileError(
                    f"{file}, line {line}: frame {frame:g}, box {width:g} x {height:g}; allowed: "
                    "frames from 1, widths and heights above 0"
                )
    rows = np.array(table).reshape(-1, _MOT_COLUMNS)
    left, top, width, height = rows[:, 2:6].T
    left, top = left - 1.0, top - 1.0
    return _Rows(
        number=rows[:, 0].astype(np.intp) - 1,
        foot=np.column_stack([left + 0.5 * width, top + height]),
        box=np.column_stack([left, top, left + width, top + height]),
        confidence=rows[:, 6],
    )


def _read_csv(file: Path, frames_per_s: float, geometry: CameraGeometry) -> _Rows:
    reader = csv.DictReader(_lines(file), skipinitialspace=True)
    names = reader.fieldnames or []
    missing = [name for name in ("t", "x", "y") if name not in names]
    if missing:
        raise DetectionFileError(
            f"{file}, line 1: column {', '.join(missing)} is missing; the header must name t, x and y"
        )
    boxed = all(name in names for name in ("left", "top", "width", "height"))
    wanted = ["t", "x", "y", *(["confidence"] if "confidence" in names else [])]
    wanted += ["left", "top", "width", "height"] if boxed else []
    table = [[_number(file, k, row[name] or "") for name in wanted] for k, row in enumerate(reader, 2)]
    rows = np.array(table).reshape(-1, len(wanted))
    if (rows[:, 0] < 0.0).any():
        line = int(np.argmax(rows[:, 0] < 0.0)) + 2
        raise DetectionFileError(f"{file}, line {line}: t {rows[line - 2, 0]:g}; allowed: 0 and above")
    shown = project_bodies(geometry, rows[:, 1:3], np.full(len(rows), _TALL))
    box = shown.box
    if boxed:
        box = rows[:, -4:].copy()
        box[:, 2:] += box[:, :2]
    return _Rows(
        number=np.rint(rows[:, 0] * frames_per_s).astype(np.intp),
        foot=shown.foot,
        box=box,
        confidence=rows[:, 3] if "confidence" in wanted else np.ones(len(rows)),
    )


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise DetectionFileError(f"{file}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DetectionFileError(f"{file}: not a text file (byte {error.start})") from error


def _number(file: Path, line: int, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DetectionFileError(f"{file}, line {line}: {text!r} is not a number")
    return value
