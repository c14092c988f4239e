"""What do FIND3's apps and scanners post? ``{d, f, t, l, s: {wifi: {address: rssi}, bluetooth: {address: rssi}}}``.

``d`` names the device, ``f`` the family (a site), ``l`` a place to learn, ``t`` the time in milliseconds since 1970. To
``/data`` a phone posts what it heard; to ``/passive`` a fixed receiver posts which transmitters it heard, and ``d`` is
the receiver's name. Each kind of ``s`` that is not radio (any is allowed) is ignored, and so are ``f`` and ``l``.

Source: FIND3's documentation (github.com/schollz/find3, doc/api.md; find3-cli-scanner).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal

import msgspec

from services.gateway.adapters.adapter import RSSI, Push, Report, number
from services.gateway.errors import read_json, refuse
from services.gateway.phones.batch_check import LATEST_CLOCK, Limits
from services.gateway.phones.heard import Heard
from services.gateway.protocol import Batch, RadioReadings

__all__ = ["Find3", "Find3Post", "read_passive"]

KINDS: dict[str, Literal["wifi", "ble"]] = {"wifi": "wifi", "bluetooth": "ble"}
EARLIEST = 1e11
"""ms: March 1973; a time before it is in seconds."""


class Find3Post(msgspec.Struct, frozen=True):
    """Body of FIND3's posts, as far as it is used."""

    d: str
    """Name of the device; of the receiver in passive mode."""
    t: int | float
    """ms since 1970."""
    s: dict[str, Any]
    """``wifi`` and ``bluetooth``: address to level in dBm."""


class Find3:
    """Turns what a phone heard (``/data``) into a batch of one scan per kind of radio."""

    name = "find3"

    def decode(self, payload: bytes, limits: Limits) -> Push:
        """Return the batch that a post holds; it is sent at ``t``, when its scan ended.

        Raises:
            RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
        """
        body, ignored = _read(payload)
        scans: list[RadioReadings] = []
        t = body.t / 1000.0
        for name, kind in KINDS.items():
            readings = list(_readings(body, name, limits.readings, limits.address_length))
            if readings:
                address, rssi = zip(*readings, strict=True)
                scans.append(RadioReadings(t=t, kind=kind, address=list(address), rssi=list(rssi)))
        batch = Batch(sent=t, seq=0, radio=scans) if scans else None
        return Push(batch, (str(body.t),), ignored)


def read_passive(payload: bytes, most: int, address_length: int) -> tuple[str, Report]:
    """Return the receiver's name and what it heard.

    Args:
        payload: body of ``POST /passive``.
        most: readings of each kind.
        address_length: characters.

    Raises:
        RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
    """
    body, ignored = _read(payload)
    heard = [
        Heard(body.d, kind, (address,), rssi, body.t / 1000.0)
        for name, kind in KINDS.items()
        for address, rssi in _readings(body, name, most, address_length)
    ]
    return body.d, Report(heard, ignored)


def _read(payload: bytes) -> tuple[Find3Post, dict[str, int]]:
    body = read_json(payload, Find3Post)
    number(body.t, "t", (EARLIEST, LATEST_CLOCK * 1000.0, "ms since 1970"))
    other = len(body.s.keys() - KINDS.keys())
    return body, dict(Counter({"sensor of no use here": other})) if other else {}


def _readings(body: Find3Post, name: str, most: int, address_length: int) -> Iterator[tuple[str, float]]:
    """Yield addresses and levels; a place is told by its number, lest a stranger's address stands in an answer."""
    found = body.s.get(name)
    if found is None:
        return
    if not isinstance(found, dict):
        refuse(f"s.{name}", "is no map of addresses to levels", type(found).__name__, "{address: dBm}")
    if len(found) > most:
        refuse(f"s.{name}", "too many readings", len(found), f"at most {most}")
    for index, (address, level) in enumerate(found.items()):
        if not 0 < len(address) <= address_length:
            allowed = f"1 to {address_length} characters"
            refuse(f"s.{name}[{index}]", "is no address", f"{len(address)} characters", allowed)
        yield address, number(level, f"s.{name}[{index}]", RSSI)
