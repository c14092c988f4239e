"""Which trackers there are: one line each, found by name."""

from __future__ import annotations

from collections.abc import Callable

from services.fusion.area_view import AreaView
from services.fusion.evidence.tracker import AnonymousTracker, EvidenceTracker
from services.fusion.rbmcda.tracker import ForcedRbmcdaTracker, RbmcdaTracker
from services.fusion.rbmcda.vision import VisionRbmcdaTracker
from services.fusion.tracker import Tracker

__all__ = ["DEFAULT_TRACKER", "TRACKERS", "make_tracker"]

Factory = Callable[[AreaView, int], Tracker]

TRACKERS: dict[str, Factory] = {
    AnonymousTracker.name: lambda view, seed: AnonymousTracker(view),
    EvidenceTracker.name: lambda view, seed: EvidenceTracker(view),
    RbmcdaTracker.name: RbmcdaTracker,
    ForcedRbmcdaTracker.name: ForcedRbmcdaTracker,
    VisionRbmcdaTracker.name: VisionRbmcdaTracker,
}
"""Each makes a tracker of an area; the seed is for those that draw random numbers."""

DEFAULT_TRACKER = EvidenceTracker.name


def make_tracker(name: str, view: AreaView, seed: int = 0) -> Tracker:
    """Return a new tracker.

    Raises:
        KeyError: no tracker has this name; the text lists those there are.
    """
    if name not in TRACKERS:
        raise KeyError(f"{name!r} is no tracker; allowed: {', '.join(sorted(TRACKERS))}")
    return TRACKERS[name](view, seed)
