"""Passwords of staff: what is kept is a salted scrypt hash that names its own costs, so that they can grow."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
import unicodedata

__all__ = ["LONGEST", "NOBODY", "SHORTEST", "hash_password", "is_password"]

SHORTEST, LONGEST = 10, 200
LOG2_N, R, P = 15, 8, 1
"""32 MiB and about a tenth of a second for each guess (OWASP's password storage cheat sheet)."""


def hash_password(password: str) -> str:
    """Return what may be stored of a password: ``scrypt$log2 N$r$p$salt$hash``."""
    salt = secrets.token_bytes(16)
    parts = (base64.b64encode(part).decode() for part in (salt, _scrypt(password, salt, LOG2_N, R, P)))
    return "$".join(["scrypt", str(LOG2_N), str(R), str(P), *parts])


def is_password(password: str, stored: str) -> bool:
    """Whether ``stored`` was made of this password; the time taken does not tell how much of it is right.

    Raises:
        ValueError: ``stored`` is none of ours.
    """
    name, log2_n, r, p, salt, kept = stored.split("$")
    if name != "scrypt":
        raise ValueError(f"a password hash of an unknown kind {name!r}")
    made = _scrypt(password, base64.b64decode(salt), int(log2_n), int(r), int(p))
    return hmac.compare_digest(made, base64.b64decode(kept))


def _scrypt(password: str, salt: bytes, log2_n: int, r: int, p: int) -> bytes:
    # The same letters may be typed as different code points, by another keyboard.
    letters = unicodedata.normalize("NFKC", password).encode()
    return hashlib.scrypt(letters, salt=salt, n=2**log2_n, r=r, p=p, maxmem=2 * 128 * r * 2**log2_n, dklen=32)


NOBODY = hash_password(secrets.token_hex(16))
"""For names that nobody has: trying them takes as long."""
