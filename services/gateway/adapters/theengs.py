"""What do Theengs Gateway and OpenMQTTGateway publish? ``…/GATEWAY/BTtoMQTT/AABBCCDDEEFF`` with ``{id, rssi, …}``.

The level of the topic before ``BTtoMQTT`` is the receiver's name. Of an iBeacon the message holds ``uuid``, ``major``
and ``minor``, which stay while its address changes; where ``id`` is the UUID, the address is in ``mac``. Messages
without ``rssi`` (a decoded sensor's values) say nothing of where it is. No time is told that could be relied on.

Source: docs.openmqttgateway.com (use/ble), gateway.theengs.io (use).
"""

from __future__ import annotations

import msgspec

from services.gateway.adapters.adapter import RSSI, Report, number
from services.gateway.errors import read_json
from services.gateway.phones.heard import Heard

__all__ = ["Theengs"]

MARK = "BTtoMQTT"


class _Body(msgspec.Struct, frozen=True):
    rssi: int | float | None = None
    id: str = ""
    mac: str = ""
    uuid: str = ""
    major: int | None = None
    minor: int | None = None


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
        beacon = f"iBeacon:{body.uuid}-{body.major}-{body.minor}" if body.uuid and body.major is not None else ""
        names = tuple(dict.fromkeys(name for name in (body.id, body.mac, beacon, parts[-1]) if name))
        return Report([Heard(parts[-3], "ble", names, level)])
