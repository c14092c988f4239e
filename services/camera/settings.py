"""What the camera service can be told."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from shared.kept import Kept
from shared.settings import ServiceSettings

__all__ = ["CameraSettings"]


class CameraSettings(ServiceSettings):
    """Settings of one camera process; everything about the camera itself stands in the site file."""

    camera: str = Field(description="which camera of the site file this process runs")
    pace: Literal["source", "fast"] = Field(
        "source", description="recorded sources: at their own pace, or as fast as possible"
    )
    detector: str = Field("foreground", description="foreground, or package.module:Class of a detector of your own")
    detector_options: dict[str, Any] = Field(
        default_factory=dict, description='options of the detector as JSON, such as {"learning_rate": 0.02}'
    )
    wait_for_subscriber: bool = Field(
        False, description="open the source only once somebody subscribes to the detections (for exact experiments)"
    )
    opencv_threads: int = Field(1, ge=0, le=64, description="threads for picture processing; 0: all cores")
    ring_megabytes: float = Field(
        96.0,
        ge=0,
        le=128,
        description="memory for the last minutes' small pictures, on which learning tries detector options; they are "
        "never written to disk; 0: none are kept",
    )
    ring_minutes: float = Field(5.0, gt=0, le=60, description="how far back those pictures reach")
    ring_rate: float = Field(4.0, gt=0, le=30, description="how many of them are kept per second")
    redetect_patience: float = Field(300.0, gt=0, description="seconds a trial of other options may take")
    scene_file: Path | None = Field(
        None,
        description="PNG in which what the scene looks like without people outlives a restart; by default it is in "
        "memory only. Who stands unseen for long may leave a faint trace in it",
    )
    allow_stills: bool = Field(
        False,
        description="whether pictures for calibration may leave this process at all, each time for still_minutes after "
        "an operator opened it by name; off: none ever does",
    )
    still_minutes: float = Field(15.0, gt=0, le=60, description="how long stills stay open, with allow_stills")

    def kept(self) -> list[Kept]:
        """What a camera's process keeps of people."""
        rows = []
        if self.ring_megabytes > 0:
            rows.append(
                Kept(
                    what="pictures, shrunk",
                    settings=("ring_minutes", "ring_megabytes"),
                    seconds=60.0 * self.ring_minutes,
                    note="in memory, never on disk",
                )
            )
        where = "in memory" if self.scene_file is None else "on disk"
        note = f"{where}; who stands unseen for minutes may leave a faint trace"
        rows.append(Kept(what="what the scene looks like without people", settings=("scene_file",), note=note))
        return rows
