"""How often may passwords be guessed? Rations that a stranger uses up for themselves and for nobody else."""

from __future__ import annotations

import hashlib
import secrets

from itsdangerous import BadSignature, TimestampSigner

from shared.rate_limiter import RateLimiter

__all__ = ["AttemptLimit", "KnownBrowsers"]

KNOWN_DAYS = 180


class AttemptLimit:
    """Rations wrong passwords by name and source, and by source: an address, or a browser that is known.

    Args:
        of_a_name: wrong passwords for one name from one source at once, and seconds until there is another try.
        of_a_source: the same for all names together.
    """

    def __init__(self, of_a_name: tuple[int, float] = (5, 30.0), of_a_source: tuple[int, float] = (30, 5.0)) -> None:
        self._of_a_name, self._of_a_source = (RateLimiter(1.0 / s, tries) for tries, s in (of_a_name, of_a_source))

    def wait(self, name: str, source: str) -> float:
        """Return the seconds until ``source`` may try a password for ``name``; 0 if it may now."""
        return max(self._of_a_name.wait(f"{source}\n{name}"), self._of_a_source.wait(source))

    def count(self, name: str, source: str, tries: float = 1.0) -> None:
        """Count a try; -1: it was right, and is given back."""
        self._of_a_name.spend(f"{source}\n{name}", tries)
        self._of_a_source.spend(source, tries)


class KnownBrowsers:
    """Knows a browser again in which somebody signed in before, so that strangers' guesses are not counted as theirs.

    What it keeps opens nothing: it only gives the browser a ration of its own, for that one name (device cookies,
    OWASP). It is signed with a key of its own, made of password and API key, and outlives restarts.
    """

    def __init__(self, password: str, api_key: str) -> None:
        key = hashlib.scrypt(password.encode(), salt=b"atrium browsers " + api_key.encode(), n=2**14, r=8, p=1)
        self._signer = TimestampSigner(key, salt="browser", digest_method=hashlib.sha256)
        self.seconds = KNOWN_DAYS * 86400

    def issue(self, name: str) -> str:
        """Return what the browser of ``name`` is to keep."""
        return self._signer.sign(f"{_short(name)}-{secrets.token_hex(12)}").decode()

    def source(self, name: str, kept: str) -> str | None:
        """Return by what the tries of a known browser of ``name`` are counted, None if it is not known."""
        try:
            told = self._signer.unsign(kept, max_age=self.seconds).decode()
        except (BadSignature, UnicodeError):
            return None
        return f"browser {told}" if told.startswith(f"{_short(name)}-") else None


def _short(name: str) -> str:
    return hashlib.sha256(name.encode("utf-8", "replace")).hexdigest()[:16]
