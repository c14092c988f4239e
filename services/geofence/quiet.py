"""When was what last told of whom? So that the same is not told again for as long as a rule asks."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["Quiet", "name_of"]

_MANY = 10_000
"""Memories after which those that no longer matter are looked for."""


def name_of(area: str, who: int) -> str:
    """Return the name of somebody without a device; no device's id holds a ``/``."""
    return f"{area}/{who}"


class Quiet:
    """What was told of whom, by rule. A person goes by all names known of them: device, and person of an area."""

    def __init__(self) -> None:
        self._until: dict[str, dict[str, float]] = {}
        self._look_at = _MANY

    def allows(self, rule: str, names: Iterable[str], t: float, seconds: float) -> bool:
        """Return whether the rule may tell of somebody at ``t``, and note that it does."""
        if seconds <= 0.0:
            return True
        until = self._until.setdefault(rule, {})
        mine = list(names)
        if any(t < until.get(name, t) for name in mine):
            return False
        for name in mine:
            until[name] = t + seconds
        if sum(map(len, self._until.values())) > self._look_at:
            self._drop_past(t)
        return True

    def forget(self, name: str) -> None:
        """Forget a device."""
        for until in self._until.values():
            until.pop(name, None)

    def clear(self) -> None:
        """Forget all: time begins anew."""
        self._until.clear()

    def state(self) -> dict[str, dict[str, float]]:
        """Return what ``restore`` takes."""
        return {rule: dict(until) for rule, until in self._until.items() if until}

    def restore(self, state: dict[str, dict[str, float]]) -> None:
        """Be as another was when its ``state`` was taken."""
        self._until = {rule: dict(until) for rule, until in state.items()}

    def _drop_past(self, t: float) -> None:
        self._until = {
            rule: {name: end for name, end in until.items() if end > t} for rule, until in self._until.items()
        }
        self._look_at = max(_MANY, 2 * sum(map(len, self._until.values())))
