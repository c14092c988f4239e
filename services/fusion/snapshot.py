"""How a tracker's arrays travel through JSON without losing a bit.

A snapshot holds plain copies, so that it can be taken between two chunks; to encode it is the work of another thread.
"""

from __future__ import annotations

import base64
import binascii
import zlib
from collections import Counter
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

__all__ = ["counts", "encode_snapshot", "of_shape", "pack", "unpack"]

SAMPLE = 2048
"""Values, evenly taken from an array, by which it is known whether it compresses …"""
WORTH = 0.6
"""… to less than this share; otherwise it is stored as it is, at once."""


def encode_snapshot(snapshot: Any) -> bytes:
    """Return JSON of a structure that may hold arrays; most of the time it takes, other threads run."""
    return msgspec.json.encode(snapshot, enc_hook=pack)


def pack(array: Any) -> dict[str, Any]:
    """Return what stands for an array (type, shape, its compressed bytes in C order), exact to the bit.

    Raises:
        NotImplementedError: it is no array.
    """
    if not isinstance(array, np.ndarray):
        raise NotImplementedError(f"{type(array).__name__} has no place in a state")
    flat = np.ascontiguousarray(array).reshape(-1)
    data = zlib.compress(flat.data, 1 if _compresses(flat) else 0)
    return {"type": array.dtype.str, "shape": list(array.shape), "data": data}


def _compresses(flat: NDArray[Any]) -> bool:
    """Whether it is worth the time: what was never heard shrinks to nothing, estimates hardly do."""
    sample = flat[:: max(1, flat.size // SAMPLE)]
    return len(zlib.compress(sample.tobytes(), 1)) < WORTH * sample.nbytes


def counts(value: Any) -> Counter[str]:
    """Return counts by reason as a state holds them.

    Raises:
        AttributeError, TypeError, ValueError: the value is no such thing.
    """
    return Counter({str(reason): int(count) for reason, count in value.items()})


def unpack(value: Any) -> NDArray[Any]:
    """Return the array that ``pack`` stored.

    Raises:
        msgspec.ValidationError: the value is no packed array.
    """
    try:
        flat = np.frombuffer(zlib.decompress(base64.b64decode(value["data"])), dtype=np.dtype(value["type"]))
        array: NDArray[Any] = flat.reshape(value["shape"]).copy()
    except (KeyError, TypeError, ValueError, binascii.Error, zlib.error) as error:
        raise msgspec.ValidationError(f"no packed array: {error}") from error
    return array


def of_shape(array: NDArray[Any], expected: tuple[int, ...]) -> NDArray[Any]:
    """Return the array.

    Raises:
        msgspec.ValidationError: it has another shape.
    """
    if array.shape != expected:
        raise msgspec.ValidationError(f"an array of shape {array.shape}, expected {expected}")
    return array
