"""What a fusion process can be told."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from services.fusion.registry import DEFAULT_TRACKER, TRACKERS
from shared.kept import Kept, state_on_disk
from shared.settings import ServiceSettings

__all__ = ["FusionSettings"]


class FusionSettings(ServiceSettings):
    """One process tracks one area."""

    area: str = Field("", description="id of the area to track; empty: the site's only area")
    tracker: str = Field(DEFAULT_TRACKER, description=f"which tracker runs: {', '.join(sorted(TRACKERS))}")
    tracker_seed: int = Field(0, ge=0, description="seed of the tracker's random generator, where it has one")
    camera_lateness: float = Field(
        0.15, ge=0.0, le=5.0, description="seconds by which the fastest camera may be ahead before others are left out"
    )
    silent_after: float = Field(5.0, gt=0.0, le=3600.0, description="seconds after which a silent camera is a problem")
    phones_silent_after: float = Field(
        60.0, gt=0.0, le=3600.0, description="seconds without any phone, while people are tracked, that are a problem"
    )
    state_folder: Path | None = Field(None, description="where the tracker's state is kept across restarts")
    state_every: float = Field(5.0, gt=0.0, le=3600.0, description="seconds between two saved states")
    radio_model: Path | None = Field(
        None, description="trained radio model of the area's floor (JSON), none: untrained"
    )
    rescore_minutes: float = Field(
        5.0, ge=0.0, le=30.0, description="minutes of what was consumed that are kept to try other models on; 0: none"
    )
    rescore_megabytes: int = Field(64, ge=1, le=1024, description="and at most so much of it")
    rescore_patience: float = Field(300.0, gt=0.0, le=3600.0, description="seconds one trial of a model may take")

    def kept(self) -> list[Kept]:
        """What fusion keeps of people."""
        rows = [Kept(what="where everybody is now, and who it is", note="in memory, until they have left")]
        if self.state_folder is not None:
            rows.append(state_on_disk("the same on disk, for a restart", self.state_every))
        if self.rescore_minutes > 0.0:
            seconds = 60.0 * self.rescore_minutes
            rows.append(
                Kept(what="what cameras and phones told, in memory", settings=("rescore_minutes",), seconds=seconds)
            )
        return rows
