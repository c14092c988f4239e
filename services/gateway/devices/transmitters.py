"""Whose transmitter is this? Addresses are compared as keyed digests: the address itself is stored nowhere.

Only what one transmitter alone sends can be enrolled: a hardware address, an iBeacon's numbers, an identity key.
Fingerprints that many devices share (ESPresense's ``apple:…``, ``msft:…``) would locate strangers.
"""

from __future__ import annotations

import hashlib
import hmac
import re

__all__ = ["FORMS", "can_be_enrolled", "digest_of"]

FORMS = "AA:BB:CC:DD:EE:FF, iBeacon:UUID-MAJOR-MINOR or irk:32 hexadecimal digits"

_ADDRESS = re.compile(r"[0-9a-f]{2}(?:([:-]?)[0-9a-f]{2})(?:\1[0-9a-f]{2}){4}")
_BEACON = re.compile(r"ibeacon:([0-9a-f]{8})-?([0-9a-f]{4})-?([0-9a-f]{4})-?([0-9a-f]{4})-?([0-9a-f]{12})-(\d+)-(\d+)")
_IDENTITY = re.compile(r"irk:[0-9a-f]{32}")


def can_be_enrolled(name: str) -> bool:
    """Whether a transmitter's name is one that no other transmitter shares."""
    text = _lower(name)
    return any(form.fullmatch(text) for form in (_ADDRESS, _BEACON, _IDENTITY))


def digest_of(name: str, key: str) -> str:
    """Return the digest of a transmitter's name; case does not matter, nor do the separators of a hardware address."""
    return hmac.new(key.encode(), _plain(name).encode(errors="replace"), hashlib.sha256).hexdigest()


def _lower(name: str) -> str:
    return name.strip().lower()


def _plain(name: str) -> str:
    text = _lower(name)
    if _ADDRESS.fullmatch(text):
        return text.replace(":", "").replace("-", "")
    beacon = _BEACON.fullmatch(text)
    if beacon:
        *uuid, major, minor = beacon.groups()
        return f"ibeacon:{''.join(uuid)}-{major}-{minor}"
    return text
