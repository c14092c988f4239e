"""Whom does a ration of guesses belong to? The address somebody asks from, as far as it tells people apart."""

from __future__ import annotations

import ipaddress

__all__ = ["source_of"]

ONE_HOUSEHOLD = 64
"""Bits of an IPv6 address that a provider gives to one customer (RFC 6177): the rest is theirs to vary."""


def source_of(host: str) -> str:
    """Return an IPv4 address as it is, of an IPv6 address its network, of anything else the text itself."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, ONE_HOUSEHOLD), strict=False))
