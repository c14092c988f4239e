"""What the API answers about erasures, and about what is kept for how long."""

from __future__ import annotations

from services.api.replies import Reply

__all__ = ["ErasureReport", "Erasures", "KeptFor", "RetentionReport", "StoreErased"]


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


class KeptFor(Reply, frozen=True, kw_only=True):
    """One kind of thing that a service keeps."""

    service: str
    what: str
    settings: tuple[str, ...]
    """That decide it; none: it is always so."""
    seconds: float | None
    """For how long; null: until what ``note`` says."""
    note: str


class RetentionReport(Reply, frozen=True, kw_only=True):
    """What running services keep of people."""

    t: float
    kept: list[KeptFor]
    silent: list[str]
    """Services that should run and did not answer."""
