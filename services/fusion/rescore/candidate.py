"""Which model is asked about? JSON, checked against the area before anything is tried."""

from __future__ import annotations

import dataclasses
import math

import msgspec

from services.fusion.area_view import AreaView
from services.fusion.rescore.detections_candidate import DetectionsCandidate, with_detections
from services.fusion.rescore.radio_candidate import CandidateError, RadioCandidate, Windowed, with_radio
from services.fusion.rescore.setting import Asked, Setting

__all__ = [
    "Candidate",
    "CandidateError",
    "DetectionsCandidate",
    "NoCandidate",
    "RadioCandidate",
    "StrideCandidate",
    "apply",
    "check_size",
    "read_candidate",
]

LARGEST = 64 * 2**20
"""Bytes of a question; four cameras' detections of five minutes are a third of it."""
SCALE = (0.5, 2.0)
"""A person's steps are no more than so much longer or shorter than they were taken for."""
SLOPE = (-2.0, 2.0)
"""m per step/s of anybody's line of step length on cadence …"""
OFFSET = (-3.0, 3.0)
"""… and metres at no cadence, where nobody walks."""


class NoCandidate(Windowed, frozen=True, kw_only=True, tag_field="kind", tag="none"):
    """Only the active model is scored."""


class _Line(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    slope: float
    offset: float


class StrideCandidate(Windowed, frozen=True, kw_only=True, tag_field="kind", tag="stride"):
    """By how much longer some devices' steps are than they were published, or their own lines of length on cadence."""

    scale: dict[str, float] = {}
    lines: dict[str, _Line] = {}


Candidate = NoCandidate | RadioCandidate | StrideCandidate | DetectionsCandidate
_decoder = msgspec.json.Decoder(Candidate)


def read_candidate(question: bytes) -> Candidate:
    """Return the candidate a question names; an empty question asks for the active model's score.

    Raises:
        CandidateError: it is none.
    """
    check_size(question)
    if not question.strip():
        return NoCandidate()
    try:
        candidate: Candidate = _decoder.decode(question)
    except (msgspec.DecodeError, RecursionError) as error:
        raise CandidateError(f"{error}; allowed kinds: detections, none, radio, stride") from error
    since, until = candidate.since, candidate.until
    if since is not None and until is not None and not since < until:
        raise CandidateError(f"until: found {until}; allowed: after since, {since}")
    return candidate


def check_size(question: bytes) -> None:
    """Refuse a question of absurd size.

    Raises:
        CandidateError: it is one.
    """
    if len(question) > LARGEST:
        found = f"{len(question) / 2**20:.0f} MB"
        raise CandidateError(f"question: found {found}; allowed: at most {LARGEST // 2**20}; ask about fewer minutes")


def apply(candidate: Candidate, view: AreaView) -> Asked:
    """Return what the candidate asks, as the area has it.

    Raises:
        CandidateError: the candidate does not fit the area.
    """
    asked = Asked(Setting(view))
    if isinstance(candidate, RadioCandidate):
        asked = Asked(Setting(view), Setting(with_radio(candidate, view)))
    elif isinstance(candidate, DetectionsCandidate):
        asked = with_detections(candidate, view)
    elif isinstance(candidate, StrideCandidate):
        asked = Asked(Setting(view), _with_strides(candidate, view))
    return dataclasses.replace(
        asked,
        since=asked.since if candidate.since is None else max(asked.since, candidate.since),
        until=asked.until if candidate.until is None else min(asked.until, candidate.until),
    )


def _with_strides(candidate: StrideCandidate, view: AreaView) -> Setting:
    if not candidate.scale and not candidate.lines:
        raise CandidateError("scale, lines: found nothing; allowed: device ids, each with a factor or a line")
    for device, factor in candidate.scale.items():
        _within(f"scale.{device}", factor, SCALE)
    for device, line in candidate.lines.items():
        if device in candidate.scale:
            raise CandidateError(f"lines.{device}: found in scale too; allowed: one of them")
        _within(f"lines.{device}.slope", line.slope, SLOPE)
        _within(f"lines.{device}.offset", line.offset, OFFSET)
    lines = {device: (line.slope, line.offset) for device, line in candidate.lines.items()}
    return Setting(view, scale=candidate.scale, lines=lines)


def _within(field: str, value: float, allowed: tuple[float, float]) -> None:
    if not (math.isfinite(value) and allowed[0] <= value <= allowed[1]):
        raise CandidateError(f"{field}: found {value:g}; allowed: {allowed[0]:g} … {allowed[1]:g}")
