"""Where a word still stands in what a service keeps in memory."""

from collections import deque
from collections.abc import Mapping
from typing import Any

__all__ = ["traces"]


def traces(kept: Any, word: str, but: tuple[type, ...] = ()) -> list[str]:
    """Return the paths from ``kept`` to every text that holds ``word``, through objects of our own and containers.

    Args:
        kept: any object.
        word: what is looked for.
        but: types whose objects are not looked into.
    """
    found: list[str] = []
    _search(kept, "kept", word, but, set(), found)
    return found


def _search(kept: Any, path: str, word: str, but: tuple[type, ...], seen: set[int], found: list[str]) -> None:
    if id(kept) in seen or isinstance(kept, but):
        return
    seen.add(id(kept))
    if isinstance(kept, str | bytes):
        if word in (kept if isinstance(kept, str) else kept.decode(errors="replace")):
            found.append(path)
    elif isinstance(kept, Mapping):
        for key, value in kept.items():
            _search(key, f"{path}.keys", word, but, seen, found)
            _search(value, f"{path}[{key!r}]", word, but, seen, found)
    elif isinstance(kept, list | tuple | set | frozenset | deque):
        for number, value in enumerate(kept):
            _search(value, f"{path}[{number}]", word, but, seen, found)
    elif type(kept).__module__.partition(".")[0] in ("services", "shared"):
        slots = (name for kind in type(kept).__mro__ for name in getattr(kind, "__slots__", ()))
        for name in {*getattr(kept, "__dict__", {}), *slots}:
            _search(getattr(kept, name, None), f"{path}.{name}", word, but, seen, found)
