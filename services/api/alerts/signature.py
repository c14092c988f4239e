"""How a receiver knows that a webhook is ours: signatures by the Standard Webhooks specification, version 1.

https://www.standardwebhooks.com: HMAC-SHA256 over ``id.timestamp.body``, in Base64; libraries for receivers exist.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets

__all__ = ["new_secret", "signed_headers"]

PREFIX = "whsec_"


def new_secret() -> str:
    """Return a fresh secret of 32 bytes, as receivers are given it."""
    return PREFIX + base64.b64encode(secrets.token_bytes(32)).decode()


def signed_headers(secret: str, message: str, timestamp: int, body: bytes) -> dict[str, str]:
    """Return the headers that prove a message ours, and when it was sent (s)."""
    key = base64.b64decode(secret.removeprefix(PREFIX))
    told = f"{message}.{timestamp}.".encode() + body
    proof = base64.b64encode(hmac.new(key, told, hashlib.sha256).digest()).decode()
    return {"webhook-id": message, "webhook-timestamp": str(timestamp), "webhook-signature": f"v1,{proof}"}
