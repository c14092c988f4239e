"""How a tracker's arrays travel through JSON without losing a bit."""

from __future__ import annotations

import base64
import binascii
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

__all__ = ["pack", "unpack"]


def pack(array: NDArray[Any]) -> dict[str, Any]:
    """Return a JSON value that holds the array exactly (type, shape, base64 of its bytes in C order)."""
    data = base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
    return {"type": array.dtype.str, "shape": list(array.shape), "data": data}


def unpack(value: Any) -> NDArray[Any]:
    """Return the array that ``pack`` stored.

    Raises:
        msgspec.ValidationError: the value is no packed array.
    """
    try:
        flat = np.frombuffer(base64.b64decode(value["data"]), dtype=np.dtype(value["type"]))
        array: NDArray[Any] = flat.reshape(value["shape"]).copy()
    except (KeyError, TypeError, ValueError, binascii.Error) as error:
        raise msgspec.ValidationError(f"no packed array: {error}") from error
    return array
