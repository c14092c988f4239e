"""The scenario file: what may stand in the YAML document that says what happens at a site.

``docs/scenarios.md`` is the guide for its author, ``docs/scenario-reference.md`` the list of all keys. Each part of the
twin owns its own parameters; here they meet.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from services.simulator.cameras.detection_files import FileDetectionParameters
from services.simulator.cameras.detection_parameters import DetectionParameters
from services.simulator.crowd.crowd import WalkerParameters
from services.simulator.faults import Fault
from services.simulator.phones.fleet import FleetParameters
from services.simulator.phones.magnetic import MagneticParameters
from services.simulator.radio.radio_world import RadioParameters
from services.simulator.video.video_light import VideoParameters
from shared.site.site_file import Identifier, Number, Part, SitePath

__all__ = ["DetectedView", "FileView", "RecordedPeople", "RenderedView", "Scenario", "Seeds", "View", "WalkingPeople"]


class Seeds(Part):
    """Two seeds everybody may know; results are told for ``test``, nothing is ever tuned on it."""

    train: Annotated[int, Field(ge=0, description="of the world on which one may tune")]
    test: Annotated[int, Field(ge=0, description="of the world on which results are told")]

    @model_validator(mode="after")
    def _differ(self) -> Seeds:
        if self.train == self.test:
            raise ValueError(
                f"train and test must differ: nothing is tuned on the world that results are told of (both {self.test})"
            )
        return self


class WalkingPeople(Part):
    """People who walk on the site's plan."""

    kind: Literal["walkers"]
    walkers: WalkerParameters = Field(description="who walks, and how")


class RecordedPeople(Part):
    """People who follow a recorded file."""

    kind: Literal["recorded"]
    file: SitePath = Field(description="beside the scenario file, or absolute; ${NAME:-default} is replaced")
    format: Literal["csv", "mot", "eth"] = Field(
        "csv", description="csv: t,id,x,y; mot: PETS truth at 7 frames/s; eth: obsmat of eth-walking"
    )
    floor: Identifier | None = Field(None, description="where they walk; null: the site's first floor")
    camera: Identifier | None = Field(
        None,
        description="a real camera whose clip the file belongs to: live, second zero is when that clip begins",
    )


class DetectedView(Part):
    """A camera of which only the detections are made."""

    level: Literal["detections"]
    camera: Identifier | Literal["*"] = Field("*", description="a camera of the site; *: each of them")
    frames_per_s: Number = Field(15.0, gt=0, le=120, description="frames a second")
    detection: DetectionParameters = Field(DetectionParameters(), description="how well it sees")


class RenderedView(Part):
    """A camera whose pictures are drawn and served, for the real camera service to look at."""

    level: Literal["video"]
    camera: Identifier | Literal["*"] = Field("*", description="a camera of the site; *: each of them")
    video: VideoParameters = Field(VideoParameters(), description="what its pictures are like")


class FileView(Part):
    """A camera whose detections come from a file."""

    level: Literal["file"]
    camera: Identifier = Field(description="a camera of the site")
    file: SitePath = Field(description="beside the scenario file, or absolute; ${NAME:-default} is replaced")
    detections: FileDetectionParameters = Field(FileDetectionParameters(), description="how the file is read")


View = Annotated[DetectedView | RenderedView | FileView, Field(discriminator="level")]


class Scenario(Part):
    """Everything the scenario file says."""

    format: Literal["atrium-scenario/1"] = Field(description="of this file")
    scenario: Identifier = Field(description="its name")
    about: str = Field("", description="what it is, in a line, for people")
    site: SitePath = Field("site.yaml", validate_default=True, description="the site file, beside this one or absolute")
    duration: Number = Field(600.0, gt=0, le=86_400, description="of an off-line run, s; live, the world goes on")
    seeds: Seeds = Field(description="of two worlds that everybody may know")
    people: Annotated[WalkingPeople | RecordedPeople, Field(discriminator="kind", description="who is there")]
    views: list[View] = Field(
        [], description="what cameras see; those without a view are real: the twin leaves them alone"
    )
    phones: list[FleetParameters] = Field(min_length=1, description="who carries which phone; one for a person at most")
    radio: RadioParameters = Field(RadioParameters(), description="how radio spreads")
    magnetic: MagneticParameters = Field(MagneticParameters(), description="what compasses read")
    faults: list[Fault] = Field([], description="what goes wrong, and when")
