"""What fusion's ``rescore`` is asked: this model, on what is newer than what taught it."""

from __future__ import annotations

from typing import Any

import msgspec

from shared.learning_report import ModelKind
from shared.messages import Message, RadioModelUpdate

__all__ = ["held_out", "is_tried", "question_of"]


def is_tried(kind: ModelKind) -> bool:
    """Whether fusion can try a whole model of this kind by itself."""
    return kind == "radio"


def question_of(model: Message) -> bytes | None:
    """Return the question that has a whole model tried; None for a kind that fusion cannot try by itself."""
    if not isinstance(model, RadioModelUpdate):
        return None
    return msgspec.json.encode({"kind": "radio", "model": model.model})


def held_out(question: bytes, since: float) -> bytes:
    """Return the question restricted to what was measured after ``since``, seconds since the epoch."""
    document: dict[str, Any] = msgspec.json.decode(question)
    return msgspec.json.encode({**document, "since": since})
