"""The kinds of models: which message each is, what it is of, and the message that takes it back."""

from __future__ import annotations

from typing import Any

import msgspec

from shared.camera_limits import UNIT
from shared.learning_report import ModelKind
from shared.messages import (
    CameraAlignment,
    DetectorSettings,
    HeadingModel,
    Message,
    MessageError,
    RadioModelUpdate,
    StrideModel,
    decode,
)

__all__ = ["MESSAGES", "PERSONAL", "as_configured", "is_configured", "kind_of", "numbered", "read_model", "subject_of"]

MESSAGES: dict[ModelKind, type[Message]] = {
    "radio": RadioModelUpdate,
    "detector": DetectorSettings,
    "stride": StrideModel,
    "heading": HeadingModel,
    "alignment": CameraAlignment,
}
SUBJECT: dict[ModelKind, str] = {
    "radio": "area",
    "detector": "camera",
    "stride": "device",
    "heading": "device",
    "alignment": "camera",
}
PERSONAL: frozenset[ModelKind] = frozenset({"stride", "heading"})
"""Of one visitor's phone: gone when it withdraws, and not exported unless asked for."""


def kind_of(model: Message) -> ModelKind:
    """Return the kind of a model.

    Raises:
        ValueError: the message is no model.
    """
    for kind, message in MESSAGES.items():
        if type(model) is message:
            return kind
    raise ValueError(f"{type(model).__name__} is no model; allowed: {', '.join(m.__name__ for m in MESSAGES.values())}")


def subject_of(model: Message) -> str:
    """Return the area, camera or device a model is of."""
    return str(getattr(model, SUBJECT[kind_of(model)]))


def read_model(kind: ModelKind, payload: bytes) -> Message:
    """Return a model from its JSON.

    Raises:
        MessageError: it is no message of this kind, or has no name to be published under.
    """
    model = decode(payload, MESSAGES[kind])
    if not subject_of(model):
        raise MessageError(f"{SUBJECT[kind]}: is empty")
    return model


def numbered(model: Message, version: int, t: float, reason: str = "") -> Message:
    """Return the model as version ``version``, decided at ``t``, for ``reason`` where its message tells one."""
    changes: dict[str, Any] = {"version": version, "t": t}
    if reason and "reason" in model.__struct_fields__:
        changes["reason"] = reason
    return msgspec.structs.replace(model, **changes)


def as_configured(kind: ModelKind, subject: str, t: float) -> Message:
    """Return the model that takes all models of this kind and subject back: as configured, or as for anybody."""
    match kind:
        case "radio":
            return RadioModelUpdate(t=t, area=subject, version=0)
        case "detector":
            return DetectorSettings(t=t, camera=subject, version=0)
        case "alignment":
            return CameraAlignment(t=t, camera=subject, version=0, homography=UNIT)
        case "stride":
            # All zeros stand for somebody of whom nothing is known (shared.walking.StrideLine).
            return StrideModel(t=t, device=subject, version=0, slope=0.0, offset=0.0, scale_variance=0.0)
        case "heading":
            # Nought adds nothing to what the phone itself says of its headings.
            return HeadingModel(t=t, device=subject, version=0, bias=0.0, variance=0.0)


def is_configured(model: Message) -> bool:
    """Return whether a model is the one that takes all others of its kind and subject back."""
    bare = numbered(model, 0, 0.0)
    if "reason" in bare.__struct_fields__:
        bare = msgspec.structs.replace(bare, reason="")
    return bare == as_configured(kind_of(model), subject_of(model), 0.0)
