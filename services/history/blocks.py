"""A minute of one subject as bytes: columns of small whole numbers, differences along time, byte planes, deflate.

Neighbours in time differ little, so that of four bytes three are nearly always zero and pack to almost nothing; and
blocks of equal length unpack together in a few array operations, which is what makes a day of everybody readable.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["COLUMNS", "MOST_POINTS", "BlockError", "check", "decode", "encode", "merge"]

COLUMNS = ("ms", "x", "y", "accuracy", "probability", "track", "state")
"""Milliseconds in the minute; centimetres; centimetres; centimetres (one sigma); thousandths; id; index of a state."""
MOST_POINTS = 12_000
"""Of a block: 200 a second. What claims to be longer is no block."""
_FORMAT = b"\x01"
_LEVEL = 6
_POINT = 4 * len(COLUMNS)
"""Bytes."""


class BlockError(ValueError):
    """Bytes that are no block: the text says why."""


def encode(block: NDArray[np.int32]) -> bytes:
    """Return a block of shape (7, n) as bytes; rows as in ``COLUMNS``, n at most ``MOST_POINTS``."""
    steps = np.diff(block, axis=1, prepend=np.int32(0))  # wraps around as int32 does, and back when summed
    folded = ((steps << 1) ^ (steps >> 31)).astype("<i4")
    planes = np.ascontiguousarray(folded).view(np.uint8).reshape(len(COLUMNS), -1, 4).transpose(0, 2, 1)
    return _FORMAT + zlib.compress(np.ascontiguousarray(planes).tobytes(), _LEVEL)


def decode(payloads: Sequence[bytes], wanted: Sequence[str] = COLUMNS) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return what blocks hold, one after the other.

    Args:
        payloads: m blocks of our own making; of others see ``check``.
        wanted: names of the columns that are unpacked.

    Returns:
        How many points each block has, shape (m,); and the columns, shape (len(wanted), total).

    Raises:
        BlockError: one is no block.
    """
    if not {payload[:1] for payload in payloads} <= {_FORMAT}:
        raise BlockError("a block of another version")
    try:
        raws = [zlib.decompress(payload[1:]) for payload in payloads]
    except zlib.error as error:
        raise BlockError(f"a block that does not unpack: {error}") from error
    sizes = np.fromiter(map(len, raws), np.int64, len(raws))
    counts = sizes // _POINT
    if (sizes != counts * _POINT).any():
        raise BlockError("a block of other than whole points")
    starts = np.cumsum(counts) - counts
    rows = [COLUMNS.index(name) for name in wanted]
    found = np.empty((len(rows), int(counts.sum())), np.int32)
    for n in np.unique(counts[counts > 0]).tolist():
        same = np.flatnonzero(counts == n)
        planes = np.frombuffer(b"".join([raws[place] for place in same.tolist()]), np.uint8)
        planes = planes.reshape(len(same), len(COLUMNS), 4, n)[:, rows]
        folded = np.ascontiguousarray(planes.transpose(1, 0, 3, 2)).view("<u4")[..., 0]
        steps = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
        values = np.cumsum(steps, axis=2, dtype=np.int32)
        found[:, (starts[same][:, None] + np.arange(n)).ravel()] = values.reshape(len(rows), -1)
    return counts, found


def merge(old: NDArray[np.int32], new: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return both blocks' points in order of time; of two of the same millisecond the new one, later ones first."""
    both = np.concatenate([old, new], axis=1)[:, ::-1]
    _, kept = np.unique(both[0], return_index=True)
    return np.ascontiguousarray(both[:, kept])


def check(payload: bytes) -> NDArray[np.int32]:
    """Return a block from somewhere else, shape (7, n); it takes no more memory than the longest block.

    Raises:
        BlockError: it is no block.
    """
    unpacking = zlib.decompressobj()
    try:
        raw = unpacking.decompress(payload[1:], _POINT * MOST_POINTS)
    except zlib.error as error:
        raise BlockError(f"a block that does not unpack: {error}") from error
    if payload[:1] != _FORMAT or not unpacking.eof or unpacking.unused_data or len(raw) % _POINT:
        raise BlockError(f"a block of another version, cut off, or of more than {MOST_POINTS} points")
    return decode([payload])[1]
