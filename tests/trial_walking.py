"""Trial walks as an emulated phone records them: straight on, at one pace, from standing to standing."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from services.simulator.phones.gait import PhoneSensors
from services.simulator.seeds import generator

RATE = 50.0
STANDING = 2.0
"""Seconds before and after the walk."""


@dataclass(frozen=True)
class Recorded:
    """One walk, and what is true of it."""

    imu: dict[str, list[float]]
    steps: int
    distance: float
    cadence: float

    def body(self, **more: Any) -> dict[str, Any]:
        """The walk as an app sends it."""
        return {"imu": self.imu, "distance": self.distance, **more}


def trial_walk(person: int, speed: float, seconds: float) -> Recorded:
    """One person walks straight on with the phone in the hand."""
    t = np.arange(int((2 * STANDING + seconds) * RATE)) / RATE
    paces = np.where((t > STANDING) & (t < STANDING + seconds), speed, 0.0)
    walked = np.cumsum(paces) / RATE
    field = np.broadcast_to(np.array([0.0, 20.0, -45.0]), (len(t), 3))
    phone = PhoneSensors(generator(person, "trial walks"), "hand", RATE)
    samples = phone.sample(t, np.zeros(len(t)), paces, walked, field)
    columns = np.concatenate([samples.acceleration, samples.rotation, samples.field], axis=1)
    names = ("ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
    imu = {name: np.round(column, 4).tolist() for name, column in zip(names, columns.T, strict=True)}
    steps = samples.steps.t
    cadence = (len(steps) - 1) / float(steps[-1] - steps[0])
    return Recorded({"t": (100.0 + t).tolist(), **imu}, len(steps), float(samples.steps.length.sum()), cadence)
