"""How does an access point stand? How well the live model explains what is heard of it, and what to tell of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.radio.changes import Change
from services.learning.radio.placing import NEEDED
from services.learning.radio.wording import UNTIL, doubted_words, placed_words, silent_words, unplaced_words
from shared.learning_report import AccessPointFit, AccessPointState
from shared.radio import PathLoss

__all__ = ["Known", "robust_sigma", "standing"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Known:
    """What is known of an access point beside how it is heard.

    Attributes:
        filed: whether the site file says where it hangs.
        visits: how many are kept of it.
        silent: since when it is, seconds since the epoch.
        change: what was found lately.
        doubted: whether the live model no longer goes by it, somewhere or anywhere.
        place: x, y, z where it was located, metres, and ``place_error``, standard deviation of that.
        place_error: see above; of one that is not located, where that is too large.
    """

    filed: bool
    visits: int
    silent: float | None
    change: Change | None
    doubted: bool
    place: tuple[float, float, float] | None
    place_error: float | None


def standing(point: int, live: PathLoss, error: Array, enough: int, known: Known) -> AccessPointFit:
    """Return how an access point stands.

    Args:
        point: its number.
        live: the live path loss.
        error: (n,) heard − expected lately, dB; none where the live model does not place it.
        enough: errors from which anything is said of them.
        known: see there.
    """
    told, placed = len(error) >= enough, bool(live.placed[point])
    state, words = _words(live.names[point], known, placed=placed, told=told)
    return AccessPointFit(
        access_point=live.names[point],
        power_1m=float(live.power_1m[point]),
        path_loss_exponent=float(live.exponent[point]),
        sigma=robust_sigma(error) if told else None,
        bias=float(np.median(error)) if told else None,
        readings=len(error) if placed else known.visits,
        state=state,
        position=known.place,
        position_error=None if known.place is None else known.place_error,
        words=words,
    )


def robust_sigma(error: Array) -> float:
    """Return the robust standard deviation of (n,) errors about their median, dB."""
    return float(1.4826 * np.median(np.abs(error - np.median(error)))) if len(error) else 0.0


def _words(name: str, known: Known, *, placed: bool, told: bool) -> tuple[AccessPointState, str]:
    if not placed and known.place is None:
        return "not placed", unplaced_words(name, known.visits, NEEDED, known.place_error)
    if not placed:
        return "not placed", placed_words(name, live=False)
    if known.silent is not None:
        return "silent", silent_words(name, known.silent)
    if known.change is not None and known.change.state != "placed":
        return known.change.state, known.change.words + (f"; {UNTIL}" if known.doubted else "")
    if known.doubted:
        return "changed", doubted_words(name)
    return "fine" if told else "few readings", "" if known.filed else placed_words(name, live=True)
