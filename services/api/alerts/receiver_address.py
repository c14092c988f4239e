"""Where may a webhook be sent? Never into private networks that nobody allowed, whatever its name resolves to, or when.

A name is resolved and checked when a webhook is made, and again for every connection, which then goes to the very
address that was checked: a name that answers differently the second time (DNS rebinding) gains nothing.
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Any
from urllib.parse import urlsplit

import httpcore

__all__ = ["AddressError", "CheckedNetwork", "Network", "Resolve", "check_url", "is_refused"]

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Resolve = Callable[[str, int], Awaitable[list[str]]]
"""A host's name and a port → its addresses."""

_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")


class AddressError(ValueError):
    """A webhook may not be sent there: the text says why."""


def is_refused(address: str, allowed: Sequence[Network]) -> bool:
    """Whether an address is private, loopback, link-local or otherwise of no public host, and not in ``allowed``."""
    found = ipaddress.ip_address(address.partition("%")[0])
    inner: ipaddress.IPv4Address | None = None
    if isinstance(found, ipaddress.IPv6Address):
        inner = found.ipv4_mapped or found.sixtofour or (found.teredo[1] if found.teredo else None)
        if inner is None and found in _NAT64:
            inner = ipaddress.IPv4Address(int(found) & 0xFFFFFFFF)
    # Packets to an address that carries one of version 4 end there.
    judged = inner or found
    if any(each in network for each in (found, judged) for network in allowed):
        return False
    site_local = isinstance(judged, ipaddress.IPv6Address) and judged.is_site_local
    return not judged.is_global or judged.is_multicast or judged.is_reserved or site_local


async def check_url(url: str, allowed: Sequence[Network], resolve: Resolve) -> None:
    """Refuse a URL to which no webhook may be sent.

    Raises:
        AddressError: it is no https URL (http is for allowed networks only), its host is not known, or one of its
            addresses is of a network that is refused.
    """
    if any(ord(character) <= 32 or ord(character) > 126 for character in url):
        raise AddressError("spaces and other than ASCII characters must be escaped")
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise AddressError(str(error)) from error
    if parts.scheme not in ("https", "http") or not host:
        raise AddressError("not a URL such as https://host/path")
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise AddressError("a URL with a user, a password or a fragment")
    if port == 0:
        raise AddressError("port 0")
    try:
        addresses = await resolve(host, port or (443 if parts.scheme == "https" else 80))
    except (OSError, UnicodeError, TimeoutError) as error:
        raise AddressError(f"the host {host} cannot be resolved") from error
    _checked(host, addresses, allowed)
    if parts.scheme == "http" and not all(_in(address, allowed) for address in addresses):
        raise AddressError("http sends alerts in plain text: only to networks allowed in webhook_networks")


class CheckedNetwork(httpcore.AsyncNetworkBackend):
    """Connects to addresses that were checked, and to no other.

    Args:
        allowed: networks that may be private.
        resolve: a host's name and port → its addresses.
    """

    def __init__(self, allowed: Sequence[Network], resolve: Resolve) -> None:
        self._allowed = allowed
        self._resolve = resolve
        self._network = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Resolve, check, and connect to the first address that answers."""
        try:
            addresses = await self._resolve(host, port)
            _checked(host, addresses, self._allowed)
        except (OSError, UnicodeError, TimeoutError) as error:
            raise httpcore.ConnectError(f"the host {host} cannot be resolved") from error
        except AddressError as error:
            raise httpcore.ConnectError(str(error)) from error
        for address in addresses[:-1]:
            try:
                return await self._network.connect_tcp(address, port, timeout, local_address, socket_options)
            except (httpcore.ConnectError, httpcore.ConnectTimeout):
                continue
        return await self._network.connect_tcp(addresses[-1], port, timeout, local_address, socket_options)

    async def connect_unix_socket(
        self, path: str, timeout: float | None = None, socket_options: Iterable[Any] | None = None
    ) -> httpcore.AsyncNetworkStream:
        """Refuse: a webhook has a host."""
        raise httpcore.ConnectError("a webhook goes to a host")

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)


def _checked(host: str, addresses: Sequence[str], allowed: Sequence[Network]) -> None:
    if not addresses:
        raise AddressError(f"the host {host} has no address")
    for address in addresses:
        if is_refused(address, allowed):
            raise AddressError(f"{host} is at {address}, in a network that webhooks may not be sent to")


def _in(address: str, networks: Sequence[Network]) -> bool:
    found = ipaddress.ip_address(address.partition("%")[0])
    return any(found in network for network in networks)
