"""Who may look: one password, signed sessions, and a limit to guessing."""

from __future__ import annotations

import hashlib
import hmac
from collections import deque

from itsdangerous import BadSignature, TimestampSigner

__all__ = ["AttemptLimit", "Sessions"]


class Sessions:
    """Checks the password and signs session tokens with a key derived from it.

    The key depends on password and API key only: sessions outlive a restart and end when either changes.
    """

    def __init__(self, password: str, api_key: str, hours: float) -> None:
        self._password = password.encode()
        key = hashlib.scrypt(self._password, salt=b"atrium dashboard " + api_key.encode(), n=2**14, r=8, p=1)
        self._signer = TimestampSigner(key, salt="session", digest_method=hashlib.sha256)
        self.seconds = int(hours * 3600)

    @property
    def open(self) -> bool:
        """Whether no password is set and everybody may look."""
        return not self._password

    def right(self, password: str) -> bool:
        """Whether this is the password; takes the same time either way."""
        return hmac.compare_digest(password.encode(), self._password)

    def issue(self) -> str:
        """Return a token for a browser that gave the password."""
        return self._signer.sign(b"operator").decode()

    def valid(self, token: str) -> bool:
        """Whether ``token`` was issued here and is not too old."""
        try:
            self._signer.unsign(token, max_age=self.seconds)
        except (BadSignature, UnicodeError):
            return False
        return True


class AttemptLimit:
    """Counts wrong passwords in a sliding minute, by address and altogether.

    Args:
        per_address: wrong passwords one address may send in a minute.
        altogether: wrong passwords all addresses may send in a minute; bounds the memory, too.
    """

    def __init__(self, per_address: int = 5, altogether: int = 60, window: float = 60.0) -> None:
        self._per_address = per_address
        self._altogether = altogether
        self._window = window
        self._failures: deque[tuple[float, str]] = deque()

    def wait(self, address: str, now: float) -> float:
        """Return the seconds until ``address`` may try again; 0 if it may now. ``now`` is any monotonic clock."""
        while self._failures and self._failures[0][0] <= now - self._window:
            self._failures.popleft()
        own = [t for t, who in self._failures if who == address]
        blocking = []
        if len(own) >= self._per_address:
            blocking.append(own[-self._per_address])
        if len(self._failures) >= self._altogether:
            blocking.append(self._failures[-self._altogether][0])
        return max((t + self._window - now for t in blocking), default=0.0)

    def failed(self, address: str, now: float) -> None:
        """Count one wrong password."""
        self._failures.append((now, address))
