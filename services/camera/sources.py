"""Which source does the site file mean?"""

from __future__ import annotations

from typing import Literal

from services.camera.frames import Source
from services.camera.live import LiveSource
from services.camera.recorded import FolderSource, VideoFile
from shared.site import Camera

__all__ = ["open_source"]


def open_source(camera: Camera, pace: Literal["source", "fast"] = "source") -> Source:
    """Return the source of one camera of the site; nothing is opened yet.

    Args:
        camera: as the site file says.
        pace: recorded sources play at their own pace, or as fast as pictures are asked for.
    """
    source = camera.source
    if source.file is not None:
        return VideoFile(source.file, pace=pace, frames_per_s=source.frames_per_s, loop=source.loop)
    if source.folder is not None:
        return FolderSource(source.folder, pace=pace, frames_per_s=source.frames_per_s or 1.0, loop=source.loop)
    return LiveSource(source.url if source.url is not None else source.device or 0, latency=camera.latency)
