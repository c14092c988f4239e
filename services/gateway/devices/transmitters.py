"""Whose transmitter is this? Addresses are compared as keyed digests: the address itself is stored nowhere."""

from __future__ import annotations

import hashlib
import hmac

__all__ = ["digest_of"]


def digest_of(address: str, key: str) -> str:
    """Return the digest of an address; case, spaces around it and the separators ``:`` and ``-`` do not matter."""
    plain = address.strip().lower().replace(":", "").replace("-", "")
    return hmac.new(key.encode(), plain.encode(), hashlib.sha256).hexdigest()
