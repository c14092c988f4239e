"""What do ESPresense receivers publish? ``espresense/devices/ID/ROOM`` with ``{mac, id, rssi, distance, …}`` in JSON.

The room is the receiver's name. A transmitter has a hardware address (``mac``, without separators) and an ``id`` that
ESPresense makes of what it advertises (``iBeacon:UUID-MAJOR-MINOR``, ``irk:…``, ``apple:…``); either may be enrolled.
The payload bears no time.

Source: the firmware (github.com/ESPresense/ESPresense, lib/BleFingerprint).
"""

from __future__ import annotations

from typing import Any

import msgspec

from services.gateway.adapters.adapter import RSSI, Report, names_of, number
from services.gateway.errors import read_json
from services.gateway.phones.heard import Heard

__all__ = ["Espresense"]


class _Body(msgspec.Struct, frozen=True):
    rssi: int | float
    id: Any = None
    mac: Any = None


class Espresense:
    """Turns ESPresense's messages into readings."""

    name = "espresense"

    def decode(self, topic: str, payload: bytes) -> Report | None:
        """Return the one reading of a message, None where the topic is not ESPresense's.

        Raises:
            RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
        """
        parts = topic.split("/")
        if len(parts) != 4 or parts[:2] != ["espresense", "devices"]:
            return None
        body = read_json(payload, _Body)
        names = names_of(body.id, body.mac, parts[2])
        return Report([Heard(parts[3], "ble", names, number(body.rssi, "rssi", RSSI))])
