"""The scenario file: what may stand in the YAML document that says what happens at a site.

``docs/scenarios.md`` is the reference for its author. Each part of the twin owns its own parameters; here they meet.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from services.simulator.crowd import WalkerParameters
from services.simulator.detection_files import FileDetectionParameters
from services.simulator.detection_parameters import DetectionParameters
from services.simulator.faults import Fault
from services.simulator.fleet import FleetParameters
from services.simulator.magnetic import MagneticParameters
from services.simulator.radio_world import RadioParameters
from services.simulator.video_light import VideoParameters
from shared.site.site_file import Identifier, Number, Part, SitePath

__all__ = ["DetectedView", "FileView", "RecordedPeople", "RenderedView", "Scenario", "Seeds", "View", "WalkingPeople"]


class Seeds(Part):
    """Two seeds everybody may know; results are told for ``test``, nothing is ever tuned on it."""

    train: Annotated[int, Field(ge=0)]
    test: Annotated[int, Field(ge=0)]


class WalkingPeople(Part):
    """People who walk on the site's plan."""

    kind: Literal["walkers"]
    walkers: WalkerParameters


class RecordedPeople(Part):
    """People who follow a recorded file."""

    kind: Literal["recorded"]
    file: SitePath
    format: Literal["csv", "mot", "eth"] = "csv"
    """csv: t,id,x,y; mot: PETS truth at 7 frames/s; eth: obsmat of eth-walking."""
    floor: Identifier | None = None
    """None: the first floor."""
    camera: Identifier | None = None
    """A real camera whose clip the file belongs to: live, second zero is when that clip begins."""


class DetectedView(Part):
    """A camera of which only the detections are made."""

    level: Literal["detections"]
    camera: Identifier | Literal["*"] = "*"
    frames_per_s: Annotated[Number, Field(gt=0, le=120)] = 15.0
    detection: DetectionParameters = DetectionParameters()


class RenderedView(Part):
    """A camera whose pictures are drawn and served, for the real camera service to look at."""

    level: Literal["video"]
    camera: Identifier | Literal["*"] = "*"
    video: VideoParameters = VideoParameters()


class FileView(Part):
    """A camera whose detections come from a file."""

    level: Literal["file"]
    camera: Identifier
    file: SitePath
    detections: FileDetectionParameters = FileDetectionParameters()


View = Annotated[DetectedView | RenderedView | FileView, Field(discriminator="level")]


class Scenario(Part):
    """Everything the scenario file says."""

    format: Literal["atrium-scenario/1"]
    scenario: Identifier
    about: str = ""
    site: SitePath = Field(default="site.yaml", validate_default=True)
    duration: Annotated[Number, Field(gt=0, le=86_400)] = 600.0
    """Seconds of an off-line run; live, the world goes on."""
    seeds: Seeds
    people: Annotated[WalkingPeople | RecordedPeople, Field(discriminator="kind")]
    views: list[View] = []
    """Cameras without a view are real ones: the twin leaves them alone."""
    phones: Annotated[list[FleetParameters], Field(min_length=1)] = []
    radio: RadioParameters = RadioParameters()
    magnetic: MagneticParameters = MagneticParameters()
    faults: list[Fault] = []
