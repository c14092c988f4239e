"""Is this the phone's own track? What a high score hides: a name that moved, a phone that lies, people nobody can tell.

A track that swapped identity early can still score high [ravel-thesis §8, traps], because cameras' detections make most
of the score. So the phone is held against everybody else who was about, over the whole stretch and part by part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from services.learning.tracks.compare import Comparison

__all__ = ["AMBIGUOUS", "CONTRADICTIONS", "doubt"]

STEADY = "the phone's readings are steadier than any radio's"
JUMPY = "the phone's readings jump more than any radio's"
MISPLACED = "the phone's radio does not fit this place"
RADIO_OF_ANOTHER = "the phone's radio fits another person better"
STEPS_OF_ANOTHER = "the phone's steps fit another person better"
AMBIGUOUS = "radio and steps do not tell who of several people it is"
CONTRADICTIONS = frozenset({STEADY, JUMPY, MISPLACED, RADIO_OF_ANOTHER})
"""What speaks against a phone's radio itself, if it is said too often."""

BETTER = 2.0
"""Nats by which another person must fit better over the whole stretch to be the likelier carrier …"""
BETTER_PART = 4.0
"""… and over a part of it, of which there are several."""
BETTER_RADIO = 5.0
"""The same of radio alone: steps that fit do not make up for it, or a phone could tell what it likes."""
SURE = 0.8
"""Probability that the stretch alone must give to its own track."""
WORSE_PART = -12.0
"""Nats of a part's radio and steps below which it is no part of this person's way."""
QUICK = (0.4, 7.0)
"""dB; no receiver's readings are steadier from second to second, rounding alone sees to that, and none that is carried
about wilder."""
MISFIT = 1.8
"""Squared residuals, in units of what is usual of them, beyond which readings are not of this place or not real."""


def doubt(whole: Comparison, parts: Sequence[Comparison], usual_misfit: float = 1.0) -> str:
    """Return why the stretch may not teach, in plain words; empty where nothing speaks against it.

    Args:
        whole: the phone against everybody, over the stretch.
        parts: over its parts, in order of time.
        usual_misfit: what the squared residuals of most stretches are, in units of what is expected of them.
    """
    if whole.fit is None:
        return "the phone told no radio"
    if whole.fit.quick < QUICK[0]:
        return STEADY
    if whole.fit.quick > QUICK[1]:
        return JUMPY
    reason = _rival(whole, BETTER)
    if reason:
        return reason
    if whole.radio[0] < 0.0 or whole.fit.chi2[0] > MISFIT * usual_misfit * whole.fit.readings:
        return MISPLACED
    for part in parts:
        if _rival(part, BETTER_PART) or part.total[0] < WORSE_PART:
            return "the phone fits only part of the way"
    if whole.own_probability < SURE:
        return AMBIGUOUS
    return ""


def _rival(comparison: Comparison, margin: float) -> str:
    others = comparison.others
    if not len(others):
        return ""
    # Among many people one fits better by luck: the best of n is held against n times the odds.
    luck = math.log(len(others)) if len(others) > 4 else 0.0
    radio = comparison.radio[others] - comparison.radio[0]
    walk = comparison.walk[others] - comparison.walk[0]
    best = int((radio + walk).argmax())
    if radio.max() > BETTER_RADIO + luck or (radio[best] + walk[best] > margin + luck and radio[best] >= walk[best]):
        return RADIO_OF_ANOTHER
    return STEPS_OF_ANOTHER if radio[best] + walk[best] > margin + luck else ""
