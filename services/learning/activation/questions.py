"""What fusion's ``rescore`` is asked: this model, on what is newer than what taught it."""

from __future__ import annotations

from typing import Any

import msgspec

from shared.messages import Message, RadioModelFile, RadioModelUpdate

__all__ = ["held_out", "question_of"]


def question_of(model: Message) -> bytes | None:
    """Return the question that has a model tried; None for a kind that fusion cannot try by itself."""
    if not isinstance(model, RadioModelUpdate):
        return None
    if model.model is None:
        return msgspec.json.encode({"kind": "radio", "as_filed": True})
    return msgspec.json.encode({"kind": "radio", **_parts(model.model)})


def held_out(question: bytes, since: float) -> bytes:
    """Return the question restricted to what was measured after ``since``, seconds since the epoch."""
    document: dict[str, Any] = msgspec.json.decode(question)
    return msgspec.json.encode({**document, "since": since})


def _parts(file: RadioModelFile) -> dict[str, Any]:
    points: dict[str, dict[str, Any]] = {
        name: {"power_1m": power, "path_loss_exponent": exponent}
        for name, power, exponent in zip(file.access_points, file.power_1m, file.exponent, strict=True)
    }
    for name, place in zip(file.access_points, file.positions, strict=True):
        if name in file.located:
            points[name]["position"] = place
    shadowing = {
        "names": file.access_points,
        "origin": file.origin,
        "cell": file.cell,
        "mean": file.mean,
        "variance": file.variance,
    }
    return {"access_points": points, "shadowing": shadowing}
