"""Models as one document that another installation, or a second museum, can take in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import msgspec
from msgspec import Meta

from services.learning.activation.content import Contents
from services.learning.activation.kinds import PERSONAL, read_model, subject_of
from services.learning.activation.rows import StoredModel
from shared.learning_report import ModelKind
from shared.messages import CameraAlignment, DetectorSettings, Message, MessageError, RadioModelUpdate
from shared.radio.radio_model import RadioModelError, unpack_radio_model
from shared.site import Site

__all__ = ["Bundle", "BundleError", "Carried", "Incoming", "Renaming", "pack", "unpack"]

FORMAT = "atrium-models/1"
LONGEST_REASON = 500
"""Characters: each museum adds whom it had a model from."""


class BundleError(ValueError):
    """A document cannot be taken in: the text names the place, the value found and what is allowed.

    ``field`` is the field of the order that is to blame.
    """

    def __init__(self, words: str, field: str = "bundle") -> None:
        super().__init__(words)
        self.field = field


class Carried(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One model in a document."""

    kind: ModelKind
    subject: Annotated[str, Meta(max_length=64)]
    area: Annotated[str, Meta(max_length=64)]
    version: Annotated[int, Meta(ge=1, lt=2**31)]
    t: float
    """When it went live there."""
    reason: str = ""
    evidence: Annotated[dict[Annotated[str, Meta(max_length=128)], float], Meta(max_length=256)] = {}
    model: msgspec.Raw
    """The message of the bus."""


class Bundle(msgspec.Struct, frozen=True, kw_only=True):
    """All models of one site, as a document."""

    format: str
    site: Annotated[str, Meta(max_length=64)]
    t: float
    models: list[Carried] = []


@dataclass(frozen=True)
class Renaming:
    """What is called otherwise here.

    Attributes:
        as_site: whether models of another site are taken for this one's.
        areas: by area there, the area here.
        cameras: by camera there, the camera here.
    """

    as_site: bool
    areas: Mapping[str, str]
    cameras: Mapping[str, str]


@dataclass(frozen=True)
class Incoming:
    """A model as it is called here: ``model`` of ``kind`` and ``subject``, tried by fusion of ``area``."""

    kind: ModelKind
    subject: str
    area: str
    model: Message
    reason: str
    evidence: Mapping[str, float]


def pack(models: Sequence[StoredModel], site: str, t: float, *, personal: bool) -> bytes:
    """Return the document of the models that are live; of people's phones only where ``personal``."""
    carried = [
        Carried(
            kind=one.kind,
            subject=one.subject,
            area=one.area,
            version=one.version,
            t=one.decided,
            reason=one.reason[:LONGEST_REASON],
            evidence=dict(one.evidence),
            model=msgspec.Raw(msgspec.json.encode(one.model)),
        )
        for one in models
        if one.state == "active" and (personal or one.kind not in PERSONAL)
    ]
    return msgspec.json.encode(Bundle(format=FORMAT, site=site, t=t, models=carried))


def unpack(document: bytes, site: Site, names: Renaming) -> list[Incoming]:
    """Return the models of a document as they are called here; all of them, or none.

    Raises:
        BundleError: it is no such document, or one of its models does not fit this site.
    """
    try:
        bundle = msgspec.json.decode(document, type=Bundle)
    except (msgspec.DecodeError, RecursionError) as error:
        raise BundleError(f"bundle: no document of models: {error}") from error
    if bundle.format != FORMAT:
        raise BundleError(f"bundle.format: found {bundle.format!r}; allowed: {FORMAT}")
    if not bundle.models:
        raise BundleError("bundle.models: found none; allowed: one or more")
    _check_renaming(bundle, site, names)
    contents = Contents(site)
    incoming = [
        _here(f"bundle.models[{row}]", one, bundle.site, site, names, contents) for row, one in enumerate(bundle.models)
    ]
    seen: set[tuple[str, str]] = set()
    for row, one in enumerate(incoming):
        if (one.kind, one.subject) in seen:
            raise BundleError(f"bundle.models[{row}]: a second {one.kind} model of {one.subject!r}; allowed: one each")
        seen.add((one.kind, one.subject))
    return incoming


def _check_renaming(bundle: Bundle, site: Site, names: Renaming) -> None:
    if bundle.site != site.site and not names.as_site:
        raise BundleError(
            f"bundle.site: found {bundle.site!r}; allowed: {site.site}, or another site's models taken for this one's "
            "(--as-site)",
            "as_site",
        )
    here = {"areas": [area.id for area in site.areas], "cameras": [camera.id for camera in site.cameras]}
    for field, renamed in (("areas", names.areas), ("cameras", names.cameras)):
        for old, new in renamed.items():
            if new not in here[field]:
                raise BundleError(f"{field}.{old}: found {new!r}; allowed: {', '.join(here[field]) or 'none'}", field)


def _here(where: str, one: Carried, origin: str, site: Site, names: Renaming, contents: Contents) -> Incoming:
    try:
        model = read_model(one.kind, bytes(one.model))
    except MessageError as error:
        raise BundleError(f"{where}.model: {error}") from error
    if subject_of(model) != one.subject:
        raise BundleError(f"{where}.subject: found {one.subject!r}; allowed: that of its model, {subject_of(model)!r}")
    area, subject = names.areas.get(one.area, one.area), one.subject
    if area not in (areas := [each.id for each in site.areas]):
        raise BundleError(f"{where}.area: found {area!r}; allowed: {', '.join(areas)} (--area OLD=NEW)", "areas")
    if isinstance(model, RadioModelUpdate):
        subject = area
        model = _radio_here(where, model, area, origin, site)
    elif isinstance(model, DetectorSettings | CameraAlignment):
        subject = names.cameras.get(subject, subject)
        known = [camera.id for camera in site.cameras_of(area)]
        if subject not in known:
            raise BundleError(
                f"{where}.subject: found camera {subject!r}; allowed in area {area}: {', '.join(known) or 'none'} "
                "(--camera OLD=NEW)",
                "cameras",
            )
        model = msgspec.structs.replace(model, camera=subject)
    elif origin != site.site:
        raise BundleError(f"{where}.kind: found {one.kind} of another site's phone; allowed: of this site's phones")
    if problem := contents.problem(model):
        raise BundleError(f"{where}.model: {problem}")
    reason = f"from {origin}, version {one.version} there: {one.reason}" if one.reason else f"from {origin}"
    return Incoming(one.kind, subject, area, model, reason[:LONGEST_REASON], dict(one.evidence))


def _radio_here(where: str, model: RadioModelUpdate, area: str, origin: str, site: Site) -> RadioModelUpdate:
    if model.model is None:
        return msgspec.structs.replace(model, area=area)
    file = model.model
    if file.site != origin:
        raise BundleError(f"{where}.model.site: found {file.site!r}; allowed: that of the document, {origin!r}")
    file = msgspec.structs.replace(file, site=site.site)
    floor = site.area(area).floor
    points = tuple(point.id for point in site.access_points if point.floor == floor)
    try:
        unpack_radio_model(file, site.site, points)
    except RadioModelError as error:
        raise BundleError(f"{where}.model: {error}") from error
    return msgspec.structs.replace(model, area=area, model=file)
