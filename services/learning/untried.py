"""Proposals that wait for a trial: of each kind and subject the newest, for learners tell each once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from services.learning.activation.kinds import PERSONAL
from services.learning.proposal import Proposal
from services.learning.trials import Key, key_of

__all__ = ["Untried"]

MOST = 1000


class Untried:
    """What nobody could try yet, oldest first."""

    def __init__(self) -> None:
        self._proposals: OrderedDict[Key, Proposal] = OrderedDict()

    def keys(self) -> list[Key]:
        """Return of what there are proposals."""
        return list(self._proposals)

    def keep(self, proposal: Proposal) -> None:
        """Keep a proposal in the place of an older one of its kind and subject."""
        key = key_of(proposal)
        self._proposals.pop(key, None)
        self._proposals[key] = proposal
        if len(self._proposals) > MOST:
            self._proposals.popitem(last=False)

    def keep_again(self, proposal: Proposal) -> None:
        """Keep a proposal that was taken out to be tried, unless there is a newer one."""
        self._proposals.setdefault(key_of(proposal), proposal)

    def ruled(self, proposal: Proposal) -> None:
        """Keep a proposal no more, but a newer one in its place."""
        key = key_of(proposal)
        if self._proposals.get(key) is proposal:
            del self._proposals[key]

    def drop(self, key: Key) -> None:
        """Keep none of this kind and subject."""
        self._proposals.pop(key, None)

    def forget(self, device: str) -> None:
        """Forget what is of one phone."""
        for kind in PERSONAL:
            self.drop((kind, device))

    def ready(self, may_begin: Callable[[Key], bool], sensor_time: Callable[[str], float]) -> list[Proposal]:
        """Return what may be tried; what was taught after ``sensor_time`` of its area goes.

        Time ran back there: nothing will judge it soon.
        """
        for key, one in list(self._proposals.items()):
            if one.trained_until > sensor_time(one.area):
                del self._proposals[key]
        return [one for key, one in self._proposals.items() if may_begin(key)]
