"""With what does a phone enrol? Keys compared in constant time, the QR code for staff."""

from __future__ import annotations

import hmac
import io
import json

import segno

__all__ = ["key_of", "qr_svg", "qr_text", "same_key"]


def same_key(given: str, wanted: str) -> bool:
    """Compare two keys in a time that tells nothing."""
    return hmac.compare_digest(given.encode(errors="replace"), wanted.encode(errors="replace"))


def qr_text(url: str, enrolment_key: str) -> str:
    """Return what the QR code holds: all an app needs to enrol."""
    return json.dumps({"atrium": 1, "url": url, "enrolment_key": enrolment_key}, separators=(",", ":"))


def key_of(given: str) -> str:
    """Return the enrolment key from what an app sent: the key itself, or the whole text of the QR code."""
    if given.startswith("{"):
        try:
            document = json.loads(given)
        except (ValueError, RecursionError):
            return given
        if isinstance(document, dict) and isinstance(document.get("enrolment_key"), str):
            return str(document["enrolment_key"])
    return given


def qr_svg(text: str) -> bytes:
    """Return a QR code as an SVG picture."""
    picture = io.BytesIO()
    segno.make(text, error="m", micro=False).save(picture, kind="svg", scale=8, border=4, light="white")
    return picture.getvalue()
