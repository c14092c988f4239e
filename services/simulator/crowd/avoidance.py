"""Who gives way to whom on one floor? JuPedSim's anticipation velocity model, asked by the crowd's own numbers.

JuPedSim's agent numbers count through the whole process and the order of its agents is nobody's promise; neither is
used for anything. Ways are planned by the crowd, so that targets are near and JuPedSim's own routing is cheap.
Source of the model: Xu, Chraibi, Seyfried, Transportation Research Part C 133 (2021) 103464.
"""

from __future__ import annotations

from collections.abc import Sequence

import jupedsim
import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["APART", "Avoidance"]

Array = NDArray[np.float64]

APART = 0.45
"""Metres that must be free round the place of somebody who enters."""
_FINE, _COARSE = 0.05, 0.1  # seconds of the model's step
_MANY = 100  # people from which the coarse step is taken
_RADIUS = 0.2
_NOTICED = 0.02  # m/s


class Avoidance:
    """The people on one floor.

    Args:
        room: where they can walk.
        seed: of the model's own draws.
        most: how many people there may be; for many, steps are coarser.
    """

    def __init__(self, room: shapely.Polygon, seed: int, most: int) -> None:
        self._room = room
        self._dt = _FINE if most < _MANY else _COARSE
        self._simulation = jupedsim.Simulation(
            model=jupedsim.AnticipationVelocityModel(rng_seed=seed), geometry=room, dt=self._dt
        )
        self._stage = self._simulation.add_direct_steering_stage()
        self._journey = self._simulation.add_journey(jupedsim.JourneyDescription([self._stage]))
        self._agents: dict[int, int] = {}
        self._pace: dict[int, float] = {}

    def add(self, person: int, place: Array) -> bool:
        """Put a person at (2,) and say whether there was room for them."""
        x, y = float(place[0]), float(place[1])
        if not shapely.contains_xy(self._room, x, y):
            return False
        if self._agents and np.hypot(*(self.positions(list(self._agents)) - place).T).min() < APART:
            return False
        try:
            agent = self._simulation.add_agent(
                jupedsim.AnticipationVelocityModelAgentParameters(
                    position=(x, y), journey_id=self._journey, stage_id=self._stage, desired_speed=0.0, radius=_RADIUS
                )
            )
        except RuntimeError:  # too near a wall
            return False
        self._simulation.agent(agent).target = (x, y)
        self._agents[person], self._pace[person] = agent, 0.0
        return True

    def remove(self, person: int) -> None:
        """Take a person off the floor."""
        self._simulation.mark_agent_for_removal(self._agents.pop(person))

    def positions(self, persons: Sequence[int]) -> Array:
        """Return where people are, (n, 2)."""
        simulation, agents = self._simulation, self._agents
        return np.array([simulation.agent(agents[person]).position for person in persons]).reshape(-1, 2)

    def aim(self, person: int, target: Array) -> None:
        """Let a person walk towards (2,), which must lie in the room."""
        self._simulation.agent(self._agents[person]).target = (float(target[0]), float(target[1]))

    def pace(self, persons: Sequence[int], speeds: Sequence[float]) -> None:
        """Set the speed each person would like to have, m/s; changes nobody would notice are let be."""
        simulation, agents, pace = self._simulation, self._agents, self._pace
        for person, speed in zip(persons, speeds, strict=True):
            if abs(speed - pace[person]) > (_NOTICED if speed > 0.0 else 0.0):
                pace[person] = speed
                simulation.agent(agents[person]).model.desired_speed = speed

    def walk(self, seconds: float) -> None:
        """Let time pass."""
        self._simulation.iterate(round(seconds / self._dt))
