"""What did a fixed receiver hear? The form in which every adapter for receivers hands its readings on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

__all__ = ["Heard"]


@dataclass(frozen=True, slots=True)
class Heard:
    """One transmitter, heard once. It may be a stranger's: its names show in no text made of this object."""

    receiver: str
    """Name under which the receiver reports; the site file says at which access point it stands."""
    kind: Literal["wifi", "ble"]
    names: tuple[str, ...] = field(repr=False)
    """Addresses and ids the transmitter was heard under, any of which may be enrolled."""
    rssi: float
    """dBm."""
    t: float | None = None
    """Receiver's clock, s since 1970; None where its payload bears no stamp."""
