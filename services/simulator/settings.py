"""What the simulator can be told. What happens in its world stands in the scenario file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field, SecretStr

from shared.settings import ServiceSettings
from shared.site.site_file import expand_environment

__all__ = ["SimulatorSettings"]


def _expanded(path: Path | None) -> Path | None:
    return None if path is None else Path(expand_environment(str(path))).expanduser()


class SimulatorSettings(ServiceSettings):
    """Settings of the simulator."""

    secrets: ClassVar[tuple[str, ...]] = ("enrolment_key",)

    scenario: Annotated[Path | None, AfterValidator(_expanded)] = Field(
        None, description="what happens at the site; empty: scenario.yaml beside the site file"
    )
    seed: int | None = Field(None, ge=0, description="same seed, same world; empty: the scenario's test seed")
    gateway_url: str = Field("http://127.0.0.1:8080", pattern="^https?://", description="where phones post")
    enrolment_key: SecretStr = Field(SecretStr("demo-enrolment-key"), description="with which phones enrol")
    video_host: str = Field("127.0.0.1", description="where rendered cameras are served")
    video_port: int = Field(8090, ge=0, le=65535, description="0: any free port, printed at start")
    truth: bool = Field(True, description="publish where everybody really is, for benchmarks")

    def scenario_file(self) -> Path:
        """Return where the scenario stands."""
        return self.scenario or self.site_file.parent / "scenario.yaml"
