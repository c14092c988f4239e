"""Where is the MQTT broker of the receivers, and how does it let one in? Read from one URL."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit

__all__ = ["Broker"]

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
