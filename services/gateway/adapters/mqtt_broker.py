"""Where is the MQTT broker of the receivers, how does it let one in, and can these topics be asked of it?"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["Broker", "check_filter"]

PORTS = {"mqtt": 1883, "mqtts": 8883}
ALLOWED = "mqtt://USER:PASSWORD@HOST:PORT, or mqtts:// for TLS"


@dataclass(frozen=True, slots=True)
class Broker:
    """Where the broker is and how it lets one in."""

    host: str
    port: int
    encrypted: bool
    user: str = ""
    password: str = field(default="", repr=False)
    authorities: Path | None = None
    """PEM file of who may have signed its certificate; None: whom the system trusts."""

    @classmethod
    def of(cls, url: str, authorities: Path | None = None) -> Broker:
        """Read ``mqtt://USER:PASSWORD@HOST:PORT`` or ``mqtts://…``.

        Raises:
            ValueError: it is no such URL; the text holds no password.
        """
        try:
            parts = urlsplit(url)
            port = parts.port
        except ValueError as error:
            raise ValueError(f"is no URL; allowed: {ALLOWED}") from error
        if parts.scheme not in PORTS or not parts.hostname or parts.path.strip("/"):
            raise ValueError(f"is no broker's URL; allowed: {ALLOWED}")
        user, password = unquote(parts.username or ""), unquote(parts.password or "")
        return cls(parts.hostname, port or PORTS[parts.scheme], parts.scheme == "mqtts", user, password, authorities)


def check_filter(topic: str) -> str:
    """Return a topic filter that a broker can be asked for.

    Raises:
        ValueError: it is none (MQTT 5.0, sections 1.5.4 and 4.7).
    """
    levels = topic.split("/")
    if not topic or len(topic.encode()) > 65_535 or "\0" in topic:
        raise ValueError(f"{topic[:80]!r} is no topic; allowed: 1 to 65535 bytes, no NUL")
    if any("+" in level and level != "+" for level in levels):
        raise ValueError(f"{topic[:80]!r}: `+` stands for a whole level; allowed: such as home/+/BTtoMQTT/+")
    if any("#" in level and level != "#" for level in levels) or "#" in levels[:-1]:
        raise ValueError(f"{topic[:80]!r}: `#` stands for all levels at the end; allowed: such as home/#")
    return topic
