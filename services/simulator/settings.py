"""What the simulator can be told."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, SecretStr

from shared.settings import ServiceSettings
from shared.site.site_file import expand_environment

__all__ = ["SimulatorSettings"]


def _as_text(value: object) -> object:
    """Take a number or a list from a settings file too."""
    if isinstance(value, list):
        return ",".join(str(part) for part in value) + ","
    return str(value) if isinstance(value, int) else value


def _phones(text: str) -> str:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 1 and not parts[0].isdigit():
        raise ValueError("must be a number of phones, or ids of people separated by commas (one id: 'visitor-1,')")
    return text


def _expanded(path: Path | None) -> Path | None:
    return None if path is None else Path(expand_environment(str(path))).expanduser()


class SimulatorSettings(ServiceSettings):
    """Settings of the simulator."""

    secrets: ClassVar[tuple[str, ...]] = ("enrolment_key",)

    seed: int = Field(1, ge=0, description="same seed, same world")
    walkers: str = Field("", description="area or floor where simulated visitors walk; empty: the first floor")
    people: int = Field(8, ge=0, le=500, description="simulated visitors")
    trajectories: Annotated[Path | None, AfterValidator(_expanded)] = Field(
        None, description="follow this file instead of simulated visitors; relative to the site file"
    )
    trajectory_format: Literal["csv", "mot"] = Field("csv", description="csv: t,id,x,y; mot: PETS truth at 7 frames/s")
    trajectory_camera: str = Field("", description="camera whose clip the trajectories belong to; empty: the first")
    phones: Annotated[str, BeforeValidator(_as_text), AfterValidator(_phones)] = Field(
        "6", description="how many people carry phones (those longest present), or their ids separated by commas"
    )
    carrying: Literal["hand", "pocket", "mixed"] = Field("hand", description="how phones are carried")
    scan_interval: float = Field(1.0, ge=0.1, le=600.0, description="seconds between a phone's radio scans")
    radio_shadowing: float = Field(4.0, ge=0, le=20, description="standard deviation of shadowing, dB")
    radio_shadowing_length: float = Field(3.0, gt=0, le=100, description="metres over which shadowing stays alike")
    radio_noise: float = Field(2.2, ge=0, le=20, description="standard deviation of one reading, dB")
    gateway_url: str = Field("http://127.0.0.1:8080", pattern="^https?://", description="where phones post")
    enrolment_key: SecretStr = Field(SecretStr("demo-enrolment-key"), description="with which phones enrol")
    video_host: str = Field("127.0.0.1", description="where rendered cameras are served")
    video_port: int = Field(8090, ge=0, le=65535, description="0: any free port, printed at start")
    frames_per_s: float = Field(15.0, gt=0, le=60, description="of rendered cameras")
    truth: bool = Field(True, description="publish where everybody really is, for benchmarks")

    def explicit_phones(self) -> list[str] | None:
        """Return the ids of people who carry phones, or None where only their number is given."""
        parts = [part.strip() for part in self.phones.split(",")]
        return None if len(parts) == 1 else [part for part in parts if part]
