"""Is a secret one that is guessed first? What the services refuse outside the demo."""

from __future__ import annotations

__all__ = ["why_weak"]

GUESSED_FIRST = (
    *("password", "passwort", "passw0rd", "atrium", "dashboard", "museum", "secret", "admin", "changeme", "default"),
    *("letmein", "welcome", "qwerty", "abcdef", "demo", "test", "1234567890", "12345678", "123456", "1234", "123"),
)
FEWEST_CHARACTERS = 5
"""Different ones."""
LEAST_REST = 4
"""Letters and digits beside such words."""


def why_weak(secret: str, shortest: int) -> str | None:
    """Return why ``secret`` is obviously weak, to follow its name in a sentence; None where it is not."""
    if len(secret) < shortest:
        return f"has {len(secret)} characters, at least {shortest} are needed"
    if len(set(secret)) < FEWEST_CHARACTERS:
        return "repeats the same few characters"
    rest = secret.lower()
    for word in GUESSED_FIRST:
        rest = rest.replace(word, "")
    if sum(letter.isalnum() for letter in rest) < LEAST_REST:
        return "is little more than words that are guessed first"
    return None
