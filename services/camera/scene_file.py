"""The empty scene on disk, where an operator wants it there: one PNG, replaced as a whole."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import cv2
import structlog

from services.camera.detector import Image
from services.camera.empty_scene import EmptyScene

__all__ = ["SceneFile"]

EVERY = 300.0
"""Seconds between two saves."""

log = structlog.get_logger(__name__)


class SceneFile:
    """Where one camera's empty scene is kept.

    Args:
        path: of the PNG; None: it is not kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._saved = 0.0

    def load(self) -> Image | None:
        """Return the scene (h, w, 3), None where there is none that can be read."""
        if self._path is None or not self._path.is_file():
            return None
        picture = cv2.imread(str(self._path), cv2.IMREAD_COLOR)
        if picture is None:
            log.warning("the empty scene cannot be read and is learned anew", file=str(self._path))
        return cast(Image | None, picture)

    def save(self, scene: EmptyScene, t: float) -> None:
        """Keep a scene that is known if it is time to; a disk that is full costs the scene, not the camera."""
        if self._path is None or abs(t - self._saved) < EVERY or (picture := scene.picture) is None:
            return
        self._saved = t
        part = self._path.with_suffix(".part.png")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
            part.replace(self._path)
        except OSError as error:
            log.warning("the empty scene cannot be saved", file=str(self._path), reason=error.strerror)
