"""What may a log show of a URL? Not the users, passwords and tokens in it."""

from __future__ import annotations

import re

__all__ = ["redact_url"]

_CREDENTIALS = re.compile(r"(?<=://)[^\s'\"]*@")
_SECRET_PARAMETER = re.compile(r"(?i)\b(\w*(?:user|usr|login|pass|pwd|pw|token|key|secret|auth)\w*=)[^&#\s'\"]*")


def redact_url(text: str) -> str:
    """Return the text with what URLs in it say of users, passwords and tokens hidden; made for logs and messages."""
    return _SECRET_PARAMETER.sub(r"\1***", _CREDENTIALS.sub("***@", text))
