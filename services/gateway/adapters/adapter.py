"""What is an adapter? A pure function from another program's payload to what the gateway takes from anybody.

A payload of a later version still works: fields that are not known are ignored, entries that are not understood are
counted by reason. What is understood and wrong is refused, named in the words of the program that sent it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from services.gateway.errors import refuse
from services.gateway.phones.batch_check import STRONGEST, WEAKEST, Limits
from services.gateway.phones.heard import Heard
from services.gateway.protocol import Batch

__all__ = ["RSSI", "PhoneAdapter", "Push", "ReceiverAdapter", "Report", "names_of", "number"]

RSSI = (WEAKEST, STRONGEST, "dBm")


@dataclass(frozen=True, slots=True)
class Push:
    """What one payload of an app on a phone came to.

    Attributes:
        batch: None where nothing of the payload is of use. Its ``seq`` is 0: whoever posts it numbers it by ``key``.
        key: what makes this payload the same one when it is sent again.
        ignored: what was not used, counted by reason; the reasons are a fixed few.
    """

    batch: Batch | None
    key: tuple[str, ...]
    ignored: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Report:
    """What one payload of a fixed receiver came to."""

    heard: list[Heard]
    ignored: dict[str, int] = field(default_factory=dict)


class PhoneAdapter(Protocol):
    """Turns the payload of an app into a batch."""

    name: str

    def decode(self, payload: bytes, limits: Limits) -> Push:
        """Return what a payload holds.

        Raises:
            RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
        """
        ...


class ReceiverAdapter(Protocol):
    """Turns what receivers publish into readings."""

    name: str

    def decode(self, topic: str, payload: bytes) -> Report | None:
        """Return what a message holds, None where the topic is not one of this program's.

        Raises:
            RequestError: as above.
        """
        ...


def number(value: Any, place: str, allowed: tuple[float, float, str]) -> float:
    """Return a value that must be a number between two limits.

    Raises:
        RequestError: it is none, or not between them.
    """
    low, high, unit = allowed
    if type(value) is not float and type(value) is not int:
        refuse(place, "is no number", type(value).__name__, f"{low:g} to {high:g} {unit}")
    if not low <= value <= high:
        refuse(place, "is out of range", value, f"{low:g} to {high:g} {unit}")
    return float(value)


def names_of(*values: Any) -> tuple[str, ...]:
    """Return what of these can name a transmitter, each once; whatever else stands there names none."""
    return tuple(dict.fromkeys(value for value in values if isinstance(value, str) and value))
