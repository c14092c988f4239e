"""Did one of our own pages send this? What another site's page makes a signed-in browser send is refused."""

from __future__ import annotations

from collections.abc import Mapping
from urllib.parse import urlsplit

__all__ = ["from_here"]


def from_here(headers: Mapping[str, str]) -> bool:
    """Whether one of our own pages sent this: browsers say so in headers that pages cannot forge.

    Args:
        headers: of the request, by name in small letters.
    """
    site = headers.get("sec-fetch-site")
    if site is not None:
        return site == "same-origin"
    try:
        origin = urlsplit(headers.get("origin", "")).netloc
    except ValueError:
        return False
    return origin != "" and origin == headers.get("host")
