"""May this client enrol? Keys in constant time, attempts rationed by address, the QR code for staff."""

from __future__ import annotations

import hmac
import io
import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable

import segno

__all__ = ["AttemptLimiter", "key_of", "qr_svg", "qr_text", "same_key"]


def same_key(given: str, wanted: str) -> bool:
    """Compare two keys in a time that tells nothing."""
    return hmac.compare_digest(given.encode(), wanted.encode())


def qr_text(url: str, enrolment_key: str) -> str:
    """Return what the QR code holds: all an app needs to enrol."""
    return json.dumps({"atrium": 1, "url": url, "enrolment_key": enrolment_key}, separators=(",", ":"))


def key_of(given: str) -> str:
    """Return the enrolment key from what an app sent: the key itself, or the whole text of the QR code."""
    if given.startswith("{"):
        try:
            document = json.loads(given)
        except (ValueError, RecursionError):
            return given
        if isinstance(document, dict) and isinstance(document.get("enrolment_key"), str):
            return str(document["enrolment_key"])
    return given


def qr_svg(text: str) -> bytes:
    """Return a QR code as an SVG picture."""
    picture = io.BytesIO()
    segno.make(text, error="m", micro=False).save(picture, kind="svg", scale=8, border=4, light="white")
    return picture.getvalue()


class AttemptLimiter:
    """A token bucket per client address.

    Args:
        per_minute: attempts a minute in the long run.
        burst: attempts at once.
        clock: seconds that never run backwards.
        addresses: how many are remembered; the one longest unseen is forgotten first.
    """

    def __init__(
        self, per_minute: float, burst: int, clock: Callable[[], float] = time.monotonic, addresses: int = 10_000
    ) -> None:
        self._rate = per_minute / 60.0
        self._burst = float(burst)
        self._clock = clock
        self._addresses = addresses
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def wait(self, address: str) -> float:
        """Return 0 where this address may try now, else the seconds until it may."""
        with self._lock:
            missing = 1.0 - self._level(address)
        return max(0.0, missing / self._rate)

    def spend(self, address: str, cost: float = 1.0) -> None:
        """Count an attempt; the level may fall below zero."""
        with self._lock:
            self._buckets[address] = (self._level(address) - cost, self._clock())
            self._buckets.move_to_end(address)
            if len(self._buckets) > self._addresses:
                self._buckets.popitem(last=False)

    def _level(self, address: str) -> float:
        level, since = self._buckets.get(address, (self._burst, self._clock()))
        return min(self._burst, level + (self._clock() - since) * self._rate)
