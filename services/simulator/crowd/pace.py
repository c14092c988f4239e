"""How fast would somebody walk just now? Moods, unequal steps, pauses: nobody walks at constant velocity.

Visitors and passers hold a speed that wanders with their mood and differs a little from step to step; workers take
every step anew, 0.3 to 0.8 m long, in a rhythm of their own [ravel-thesis §14].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.simulator.crowd.walker_parameters import Behaviour
from services.simulator.seeds import generator

__all__ = ["Pace"]

Array = NDArray[np.float64]

_MOOD_SECONDS = 7.0
_MOOD = {"visitors": 0.12, "workers": 0.12, "passers": 0.08}  # standard deviation of the mood's factor
_UNEQUAL = 0.05  # standard deviation of one step's speed, visitors and passers
_STEP_LENGTH = (0.3, 0.8)  # metres, workers
_STEP_SECONDS = (0.45, 0.75)  # workers
_PAUSES = {"visitors": 1 / 70, "workers": 1 / 45, "passers": 1 / 250}  # a second of walking
_PAUSE_SECONDS = 2.5  # mean
_FASTEST = 2.4  # m/s


class Pace:
    """The wished speeds of everybody.

    Args:
        cruise: (p,) usual speed of each, m/s.
        behaviour: how they walk.
        seed: of the world.
    """

    def __init__(self, cruise: Array, behaviour: Behaviour, seed: int) -> None:
        self.cruise = cruise
        self._irregular = behaviour == "workers"
        self._hazard = _PAUSES[behaviour]
        self._rng = generator(seed, "crowd", "pace")
        self._spread = _MOOD[behaviour]
        self._mood = self._rng.normal(0.0, self._spread, len(cruise))
        self._left = np.zeros(len(cruise))  # seconds of the present step
        self._step = np.ones(len(cruise))
        self._pause = np.zeros(len(cruise))

    def next(self, walking: NDArray[np.bool_], dt: float) -> Array:
        """Return the speeds (p,) that people would like for the next ``dt`` seconds if nothing were in their way."""
        count = len(self.cruise)
        keep = np.exp(-dt / _MOOD_SECONDS)
        noise, chance, stop, first, second = self._rng.normal(size=count), *self._rng.random((4, count))
        self._mood = keep * self._mood + np.sqrt(1.0 - keep**2) * self._spread * noise
        self._left -= dt
        new = self._left <= 0.0
        if self._irregular:
            seconds = _STEP_SECONDS[0] + (_STEP_SECONDS[1] - _STEP_SECONDS[0]) * first
            length = _STEP_LENGTH[0] + (_STEP_LENGTH[1] - _STEP_LENGTH[0]) * second
            speed = length / seconds / 0.92  # in units of the mean: 0.55 m in 0.6 s
        else:
            seconds = 0.5 + 0.12 * first
            speed = 1.0 + _UNEQUAL * 3.46 * (second - 0.5)
        self._left = np.where(new, seconds, self._left)
        self._step = np.where(new, speed, self._step)
        self._pause = np.where(self._pause > 0.0, self._pause - dt, 0.0)
        pausing = walking & (chance < self._hazard * dt)
        self._pause = np.where(pausing, 0.8 - _PAUSE_SECONDS * np.log(np.maximum(stop, 1e-3)), self._pause)
        wished: Array = np.minimum(self.cruise * np.exp(self._mood) * self._step, _FASTEST)
        return np.where(self._pause > 0.0, 0.0, wished)
