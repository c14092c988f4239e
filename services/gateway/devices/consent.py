"""To what does a visitor agree? The site's own text and its version, from a file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from shared.runner import ServiceError

__all__ = ["ConsentText", "read_consent"]

SHIPPED = Path(__file__).with_name("consent.txt")


@dataclass(frozen=True, slots=True)
class ConsentText:
    """What is shown to a visitor before enrolling."""

    version: str
    text: str


def read_consent(path: Path | None) -> ConsentText:
    """Read a consent text: a first line ``version: NAME``, then the text; the shipped one where ``path`` is None.

    Raises:
        ServiceError: the file cannot be read, or holds no version or no text.
    """
    path = path or SHIPPED
    try:
        first, _, text = path.read_text(encoding="utf-8").partition("\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise ServiceError(f"consent_file: {path}: cannot be read: {reason}") from error
    named = re.fullmatch(r"version:\s*([\w.-]{1,64})\s*", first)
    if named is None:
        raise ServiceError(
            f"consent_file: {path}: the first line is {first[:60]!r}; it must be `version: NAME`, "
            "NAME of letters, digits, '_', '.' and '-'"
        )
    if not text.strip():
        raise ServiceError(f"consent_file: {path}: holds no text after its first line")
    return ConsentText(named[1], text.strip())
