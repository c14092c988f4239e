"""What the learning service can be told."""

from __future__ import annotations

import os

from pydantic import Field, SecretStr

from services.learning.trials import Pace
from shared.kept import Kept
from shared.settings import ServiceSettings

__all__ = ["LearningSettings", "default_learning_database_url"]

DEFAULT_DATABASE = "sqlite:///atrium-learning.db"
REST, URGENT_REST = 10.0, 4.0
"""Times what a trial took before the next: trials take a tenth of a core, a fifth where something changed."""


def default_learning_database_url() -> str:
    """Return ``ATRIUM_LEARNING_DATABASE_URL``, else ``ATRIUM_DATABASE_URL``, else a file in the working directory."""
    variables = ("ATRIUM_LEARNING_DATABASE_URL", "ATRIUM_DATABASE_URL")
    return next((url for name in variables if (url := os.environ.get(name))), DEFAULT_DATABASE)


class LearningSettings(ServiceSettings):
    """Settings of learning. Longer times and wider margins mean fewer, surer changes."""

    areas: list[str] = Field([], description="ids of the areas that are learned of; empty: all of the site")
    activate: bool = Field(
        True, description="models that win go live by themselves; false: they are tried and told of only"
    )
    learning_database_url: SecretStr = Field(
        default_factory=lambda: SecretStr(default_learning_database_url()),
        description="sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME; the gateway's may be shared",
    )
    learn_every: float = Field(
        60.0, gt=0, le=86400, description="seconds between two looks for candidates that deserve a trial"
    )
    held_out_minutes: float = Field(
        4.0, ge=1, le=30, description="the newest minutes: they teach nothing yet, candidates are tried on them"
    )
    patience: float = Field(330.0, gt=0, le=3600, description="seconds fusion may take to try a candidate")
    save_every: float = Field(300.0, gt=0, le=86400, description="seconds between two times what is known is saved")

    def pace(self) -> Pace:
        """How often what is done."""
        held_out = 60.0 * self.held_out_minutes
        return Pace(
            propose=self.learn_every,
            held_out=held_out,
            after_refusal=held_out,
            after_roll_back=15.0 * held_out,
            save=self.save_every,
            rest=REST,
            urgent_rest=URGENT_REST,
        )

    def kept(self) -> list[Kept]:
        """What learning keeps of people."""
        return [
            Kept(
                what="how long somebody's steps are, how their phone is turned and how well it hears",
                note="by phone, until the consent is taken back",
            )
        ]
