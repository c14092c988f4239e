"""What the history service can be told."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, SecretStr, model_validator

from services.history.retention import Retention
from shared.kept import Kept
from shared.settings import ServiceSettings

__all__ = ["HistorySettings", "default_history_database_url"]

DEFAULT_DATABASE = "sqlite:///atrium-history.db"


def default_history_database_url() -> str:
    """Return ``ATRIUM_HISTORY_DATABASE_URL``, else ``ATRIUM_DATABASE_URL``, else a file in the working directory."""
    variables = ("ATRIUM_HISTORY_DATABASE_URL", "ATRIUM_DATABASE_URL")
    return next((url for name in variables if (url := os.environ.get(name))), DEFAULT_DATABASE)


class HistorySettings(ServiceSettings):
    """Settings of history: how much of the past is kept, and for how long."""

    history_database_url: SecretStr = Field(
        default_factory=lambda: SecretStr(default_history_database_url()),
        description="sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME; the gateway's may be shared",
    )
    history_spool: Path = Field(
        Path("atrium-history-spool"), description="folder where what is not in the database yet waits on disk"
    )
    history_spool_megabytes: float = Field(
        4000.0, ge=1, le=1_000_000, description="how much may wait while the database is away"
    )
    history_interval: float = Field(1.0, ge=0.05, le=60, description="seconds between two kept positions of anybody")
    history_write_every: float = Field(5.0, ge=0.1, le=300, description="seconds between two writes into the database")
    history_phone_days: float = Field(30.0, gt=0, le=3660, description="days positions of named devices are kept")
    history_people_days: float = Field(
        90.0, gt=0, le=3660, description="days positions of people without names are kept"
    )
    history_detail_days: float = Field(
        30.0, gt=0, le=3660, description="days after which positions that are kept longer are thinned"
    )
    history_coarse_interval: float = Field(10.0, ge=1, le=60, description="seconds between thinned positions")
    history_alert_days: float = Field(90.0, gt=0, le=3660, description="days alerts are kept")
    history_count_days: float = Field(730.0, gt=0, le=3660, description="days counts of people per minute are kept")

    @model_validator(mode="after")
    def _thinner(self) -> HistorySettings:
        if self.history_coarse_interval < self.history_interval:
            raise ValueError(
                f"history_coarse_interval: found {self.history_coarse_interval:g}; allowed: history_interval "
                f"({self.history_interval:g}) or more"
            )
        return self

    def retention(self) -> Retention:
        """For how long what is kept."""
        day = 86400.0
        return Retention(
            phones=self.history_phone_days * day,
            people=self.history_people_days * day,
            detail=self.history_detail_days * day,
            coarse=self.history_coarse_interval,
            alerts=self.history_alert_days * day,
            counts=self.history_count_days * day,
        )

    def kept(self) -> list[Kept]:
        """What history keeps of people."""
        kept = self.retention()
        every = f"one position every {self.history_interval:g} s"
        thinned = f"{every}, after {self.history_detail_days:g} days every {self.history_coarse_interval:g} s"
        how_dense = ("history_detail_days", "history_interval", "history_coarse_interval")
        return [
            Kept(
                what="where phones were",
                settings=("history_phone_days", *how_dense),
                seconds=kept.phones,
                note=thinned if kept.phones > kept.detail else every,
            ),
            Kept(
                what="where people without names were",
                settings=("history_people_days", *how_dense),
                seconds=kept.people,
                note=thinned if kept.people > kept.detail else every,
            ),
            Kept(
                what="alerts",
                settings=("history_alert_days",),
                seconds=kept.alerts,
                note="which phone they are about no longer than where phones were" if kept.alerts > kept.phones else "",
            ),
            Kept(
                what="how many people were where, by the minute",
                settings=("history_count_days",),
                seconds=kept.counts,
                note="nobody by name",
            ),
        ]
