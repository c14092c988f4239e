"""What the API answers about erasures."""

from __future__ import annotations

from services.api.replies import Reply

__all__ = ["ErasureReport", "Erasures", "StoreErased"]


class StoreErased(Reply, frozen=True, kw_only=True):
    """A service that has nothing more of a device, and since when."""

    service: str
    t: float


class ErasureReport(Reply, frozen=True, kw_only=True):
    """One device whose consent was withdrawn."""

    device: str
    t: float
    done: list[StoreErased]
    waiting: list[str]
    """Services that have not said yet that nothing is left."""


class Erasures(Reply, frozen=True, kw_only=True):
    """The devices whose consent was withdrawn, the latest first."""

    t: float
    erasures: list[ErasureReport]
