"""The last minutes of chunks, as they were consumed: bounded in time and in bytes."""

from __future__ import annotations

import dataclasses
import zlib
from collections import deque

import msgspec
from msgspec.structs import replace

from services.fusion.tracker import Chunk

__all__ = ["RecentChunks", "decode_chunk"]

_encode = msgspec.msgpack.Encoder().encode
_decoder = msgspec.msgpack.Decoder(Chunk)


class RecentChunks:
    """Keeps chunks in order.

    Args:
        seconds: how much event time is kept; 0 keeps nothing.
        most_bytes: how much memory, roughly.
    """

    def __init__(self, seconds: float, most_bytes: int) -> None:
        self._seconds = seconds
        self._most_bytes = most_bytes
        self._kept: deque[tuple[float, bytes]] = deque()
        self.bytes = 0

    def add(self, chunk: Chunk) -> None:
        """Keep a chunk. One that carries an erasure, or whose time ran back, begins anew: what went before is gone."""
        if not self._seconds:
            return
        if chunk.erasures or (self._kept and chunk.t_end < self._kept[-1][0]):
            self.clear()
        if chunk.erasures:
            return
        packed = zlib.compress(_encode(_lighter(chunk)), 1)
        self._kept.append((chunk.t_end, packed))
        self.bytes += len(packed)
        while self._kept and (self.bytes > self._most_bytes or self._kept[0][0] < chunk.t_end - self._seconds):
            self.bytes -= len(self._kept.popleft()[1])

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()
        self.bytes = 0

    def copy(self) -> list[bytes]:
        """Return what is kept, oldest first; may be called from another thread than ``add``."""
        # A deque that grows meanwhile cannot be iterated; its own copy is made in one step.
        return [packed for _, packed in self._kept.copy()]


def decode_chunk(packed: bytes) -> Chunk:
    """Return a chunk that ``RecentChunks`` kept."""
    return _decoder.decode(zlib.decompress(packed))


def _lighter(chunk: Chunk) -> Chunk:
    """Return the chunk without what no trial needs: radio models, and boxes, which are half of what a frame weighs."""
    frames = (replace(frame, box=[(0.0, 0.0, 0.0, 0.0)] * len(frame.x)) for frame in chunk.frames)
    return dataclasses.replace(chunk, frames=tuple(frames), models=())
