"""What do Theengs Gateway and OpenMQTTGateway publish? ``…/GATEWAY/BTtoMQTT/AABBCCDDEEFF`` with ``{id, rssi, …}``.

The level of the topic before ``BTtoMQTT`` is the receiver's name. Of an iBeacon the message holds ``uuid``, ``major``
and ``minor``, which stay while its address changes; where ``id`` is the UUID, the address is in ``mac``. Messages
without ``rssi`` (a decoded sensor's values) say nothing of where it is. No time is told that could be relied on.

Source: docs.openmqttgateway.com (use/ble), gateway.theengs.io (use).
"""

from __future__ import annotations

from typing import Any

import msgspec

from services.gateway.adapters.adapter import RSSI, Report, names_of, number
from services.gateway.errors import read_json
from services.gateway.phones.heard import Heard

__all__ = ["Theengs"]

MARK = "BTtoMQTT"


class _Body(msgspec.Struct, frozen=True):
    rssi: int | float | None = None
    id: Any = None
    mac: Any = None
    uuid: Any = None
    major: Any = None
    minor: Any = None


class Theengs:
    """Turns the messages of Theengs Gateway and OpenMQTTGateway into readings."""

    name = "theengs"

    def decode(self, topic: str, payload: bytes) -> Report | None:
        """Return the one reading of a message, None where the topic is not theirs.

        Raises:
            RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
        """
        parts = topic.split("/")
        if len(parts) < 3 or parts[-2] != MARK:
            return None
        body = read_json(payload, _Body)
        if body.rssi is None:
            return Report([], {"entry without its values": 1})
        level = number(body.rssi, "rssi", RSSI)
        major, minor = _whole(body.major), _whole(body.minor)
        known = isinstance(body.uuid, str) and body.uuid and major is not None and minor is not None
        beacon = f"iBeacon:{body.uuid}-{major}-{minor}" if known else ""
        names = names_of(body.id, body.mac, beacon, parts[-1])
        return Report([Heard(parts[-3], "ble", names, level)])


def _whole(value: Any) -> int | None:
    """Return a whole number, also where it is written with a decimal point."""
    return int(value) if type(value) is int or (type(value) is float and value.is_integer()) else None
