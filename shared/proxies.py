"""Behind which proxies does a server stand? The addresses whose word on who asks is believed."""

from __future__ import annotations

import ipaddress
from typing import Annotated

from pydantic import AfterValidator

__all__ = ["ProxyAddresses"]


def _networks(value: list[str]) -> list[str]:
    for text in value:
        ipaddress.ip_network(text)
    return value


ProxyAddresses = Annotated[list[str], AfterValidator(_networks)]
"""Addresses and networks, such as ``127.0.0.1`` and ``172.16.0.0/12``; for the setting of a service."""
