"""Which way does somebody walk who holds the phone askew? Where it points, and how far it is off.

For people who are known to hold their phones turned; ``offset.py`` says why it is not the default.
"""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hand_heading import HandHeading
from services.gateway.reckoning.hops import State
from services.gateway.reckoning.offset import Offset
from services.gateway.reckoning.recent import Recent
from services.gateway.reckoning.step_heading import StepHeadings
from services.gateway.steps.detector import Steps
from shared.angles import wrap

__all__ = ["TurnedHandHeading"]


class TurnedHandHeading:
    """The heading of a phone in the hand plus its offset; ``other`` is the heading if the offset's sign is wrong.

    Args:
        offset: estimates it.
        least: radians; an offset below it is left alone, for there the sign is not to be trusted.
    """

    STATE = np.dtype([("hand", HandHeading.STATE), ("offset", Offset.STATE)])

    def __init__(self, offset: Offset | None = None, least: float = 0.0) -> None:
        self._hand = HandHeading()
        self._offset = offset or Offset()
        self._least = least

    def advance(self, state: State, recent: Recent, steps: Steps) -> StepHeadings:
        """Return the headings of ``steps``; see ``StepHeading``."""
        hand = self._hand.advance(state["hand"], recent, steps)
        found = self._offset.advance(state["offset"], recent, steps)
        used = (found.offset != 0.0) & (np.abs(found.offset) >= self._least)
        offset = np.where(used, found.offset, 0.0)
        bias = np.where(used, found.variance, hand.bias_variance)
        return StepHeadings(
            heading=wrap(hand.heading + offset),
            variance=hand.variance - hand.bias_variance + bias,
            bias_variance=bias,
            other=wrap(hand.heading - offset),
            other_probability=np.where(used, found.wrong_sign_probability, 0.0),
        )
