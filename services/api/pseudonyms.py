"""Other names for devices that were erased, for what must stay: that a rule was about one phone, that staff looked
one up. Which device a name stands for is held in memory only, so that nothing still under way writes the id down again.
"""

from __future__ import annotations

import re
import secrets
import threading
from collections import OrderedDict

__all__ = ["ERASED", "Pseudonyms"]

ERASED = "erased-"
"""How they begin."""
KEPT = 100_000
"""Device ids are never given twice: the oldest can be forgotten once nothing of theirs is under way."""

_WORD = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9_.-]*[A-Za-z0-9_-])?")
"""As identifiers (``shared.keys``), but for a full stop at the end, which is a sentence's."""


class Pseudonyms:
    """Random names, one per erased device; from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: OrderedDict[str, str] = OrderedDict()

    def add(self, device: str) -> None:
        """Give an erased device a name, unless it has one."""
        with self._lock:
            self._names.setdefault(device, ERASED + secrets.token_hex(6))
            if len(self._names) > KEPT:
                self._names.popitem(last=False)

    def of(self, device: str) -> str:
        """Return the name of an erased device, and any other id as it is."""
        return self._names.get(device, device)

    def without(self, text: str) -> str:
        """Return a text with the names in the place of erased devices' ids."""
        return _WORD.sub(lambda word: self.of(word[0]), text) if self._names else text
