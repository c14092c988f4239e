"""Who walks with whom? Groups come together, one of them chooses the way, and sometimes they part."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["Companions"]


class Companions:
    """The groups; the first member leads."""

    def __init__(self) -> None:
        self._group: dict[int, list[int]] = {}

    def form(self, members: Sequence[int]) -> None:
        """Let people go together from now on."""
        group = list(members)
        if len(group) > 1:
            for person in group:
                self._group[person] = group

    def leader(self, person: int) -> int | None:
        """Return who leads this person's group; None for who walks alone."""
        group = self._group.get(person)
        return group[0] if group else None

    def of(self, person: int) -> list[int]:
        """Return all members of this person's group, the person too; nobody for who walks alone."""
        return list(self._group.get(person, ()))

    def groups(self) -> list[list[int]]:
        """Return all groups."""
        return [group for person, group in self._group.items() if group[0] == person]

    def lead(self, person: int) -> None:
        """Let this member lead."""
        group = self._group[person]
        group.remove(person)
        group.insert(0, person)

    def leave(self, person: int) -> list[int]:
        """Take a person out and return who must decide for themselves now and did not before."""
        group = self._group.pop(person, None)
        if group is None:
            return []
        led = group[0] == person
        group.remove(person)
        if len(group) == 1:
            del self._group[group[0]]
            return group
        return group[:1] if led else []
