"""Which model is asked about? JSON, checked against the area before anything is tried."""

from __future__ import annotations

import math

import msgspec

from services.fusion.area_view import AreaView
from services.fusion.rescore.radio_candidate import CandidateError, RadioCandidate, with_radio

__all__ = ["CandidateError", "NoCandidate", "RadioCandidate", "StrideCandidate", "apply", "read_candidate"]

SCALE = (0.5, 2.0)
"""A person's steps are no more than so much longer or shorter than they were taken for."""


class NoCandidate(msgspec.Struct, frozen=True, tag_field="kind", tag="none"):
    """Only the active model is scored."""


class StrideCandidate(msgspec.Struct, frozen=True, tag_field="kind", tag="stride"):
    """By how much longer some devices' steps are than they were published."""

    scale: dict[str, float]


Candidate = NoCandidate | RadioCandidate | StrideCandidate
_decoder = msgspec.json.Decoder(Candidate)


def read_candidate(question: bytes) -> Candidate:
    """Return the candidate a question names; an empty question asks for the active model's score.

    Raises:
        CandidateError: it is none.
    """
    if not question.strip():
        return NoCandidate()
    try:
        candidate: Candidate = _decoder.decode(question)
    except msgspec.DecodeError as error:
        raise CandidateError(f"{error}; allowed kinds: none, radio, stride") from error
    if isinstance(candidate, StrideCandidate):
        if not candidate.scale:
            raise CandidateError("scale: found nothing; allowed: device ids, each with a factor")
        for device, factor in candidate.scale.items():
            if not (math.isfinite(factor) and SCALE[0] <= factor <= SCALE[1]):
                raise CandidateError(f"scale.{device}: found {factor:g}; allowed: {SCALE[0]:g} … {SCALE[1]:g}")
    return candidate


def apply(candidate: Candidate, view: AreaView) -> tuple[AreaView, dict[str, float]]:
    """Return the area as the candidate sees it, and the factor of each device's step lengths.

    Raises:
        CandidateError: the candidate does not fit the area.
    """
    if isinstance(candidate, RadioCandidate):
        return with_radio(candidate, view), {}
    return view, dict(candidate.scale) if isinstance(candidate, StrideCandidate) else {}
