"""What does a token say? Signed with HS256 (RFC 7519): whose it is, what it may do, until when; no database needed.

That it has not been revoked only the database knows: ``known_tokens`` remembers its answer for a while.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import jwt

__all__ = ["MANAGE", "POST", "READ", "SCOPES", "WITHDRAWABLE", "Claims", "TokenSigner", "keys_of"]

POST: Final = "post"
"""Post batches."""
READ: Final = "read"
"""Read the phone's own position, zones and alerts."""
MANAGE: Final = "manage"
"""Change or withdraw the enrolment, hand out and revoke tokens, send trial walks."""
SCOPES: Final = (POST, READ, MANAGE)
WITHDRAWABLE: Final = 30 * 86_400.0
"""Seconds after its end during which a token may still withdraw the consent, and nothing else."""


@dataclass(frozen=True, slots=True)
class Claims:
    """What a token says of itself."""

    id: str
    device: str
    scopes: frozenset[str]
    expires: float
    """Server clock, s."""


def keys_of(text: str) -> list[str]:
    """Return the keys of a setting that holds one or several, separated by commas."""
    return [key for part in text.split(",") if (key := part.strip())]


class TokenSigner:
    """Makes and reads tokens.

    Args:
        keys: the first signs; all of them verify, so that keys can be exchanged without voiding tokens.
    """

    def __init__(self, keys: list[str]) -> None:
        self._keys = {_name_of(key): key for key in keys}
        self._signing = _name_of(keys[0])

    def sign(self, device: str, token_id: str, scopes: Iterable[str], expires: float) -> str:
        """Return a token."""
        claims = {"sub": device, "jti": token_id, "scope": " ".join(scopes), "exp": int(expires)}
        return jwt.encode(claims, self._keys[self._signing], "HS256", headers={"kid": self._signing})

    def read(self, token: str, now: float) -> Claims | None:
        """Return what a token says; None where no key of ours signed it, ``now`` is past its end, or it is none."""
        try:
            key = self._keys[jwt.get_unverified_header(token)["kid"]]
            said = jwt.decode(
                token,
                key,
                algorithms=["HS256"],
                options={"require": ["sub", "jti", "exp"], "verify_exp": False},
            )
            claims = Claims(said["jti"], said["sub"], frozenset(said["scope"].split()), float(said["exp"]))
        except (jwt.InvalidTokenError, KeyError, TypeError, ValueError, AttributeError):
            return None
        return claims if now < claims.expires else None


def _name_of(key: str) -> str:
    """Name a key without telling it: which of several signed a token."""
    return hashlib.sha256(b"atrium token key" + key.encode()).hexdigest()[:8]
