"""What is said when no camera spoke, because somebody withdrew meanwhile, say: what was said last, and nobody seen."""

from __future__ import annotations

import math

import msgspec

from services.fusion.tracker import Chunk
from shared.messages import TrackFrame

__all__ = ["said_again", "without_device"]


def said_again(said: TrackFrame | None, chunk: Chunk, area: str, tracker: str) -> TrackFrame:
    """Return the frame of a chunk in which no camera spoke: that of before, if there was one, for its time."""
    t = max((frame.t for frame in chunk.frames if math.isfinite(frame.t)), default=chunk.t_start)
    if said is None:
        return TrackFrame(t=t, area=area, chunk=chunk.index, tracker=tracker)
    return msgspec.structs.replace(
        said,
        t=t,
        chunk=chunk.index,
        state=["coasting" if state == "confirmed" else state for state in said.state],
        sources=[[] for _ in said.sources],
    )


def without_device(said: TrackFrame, device: str) -> TrackFrame:
    """Return the frame without the row of a device."""
    kept = [index for index, name in enumerate(said.device) if name != device]
    if len(kept) == len(said.device):
        return said
    columns = {name: [getattr(said, name)[index] for index in kept] for name in said.columns()}
    return msgspec.structs.replace(said, **columns)
