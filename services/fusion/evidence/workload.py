"""How much of what phones told is worked on in one step? Bursts are spread over the steps that follow.

Who is who is not decided at the cameras' rate, but positions are told at it: a hundred phones that report in the same
tenth of a second must not hold them up. What is taken depends on the messages alone, never on how fast the machine is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

from shared.messages import MotionBatch, RadioScan

__all__ = ["due_now"]

P = TypeVar("P", RadioScan, MotionBatch)

LEAST_SHARE = 0.25
"""Share of what is due that is taken however much it is, so that nothing waits for ever."""


def due_now(waiting: Sequence[P], t: float, most: int, kept: int) -> tuple[list[P], list[P]]:
    """Return what is to be worked on now, oldest first, and what goes on waiting.

    Args:
        waiting: in any order.
        t: time up to which anything is due.
        most: how many are taken, unless that is less than a quarter of what is due.
        kept: how many may go on waiting; the oldest beyond are lost.
    """
    due = sorted((one for one in waiting if one.t <= t), key=lambda one: (one.t, one.device, one.seq))
    taken = max(most, math.ceil(LEAST_SHARE * len(due)))
    rest = due[taken:] + [one for one in waiting if one.t > t]
    return due[:taken], rest[-kept:]
