"""Does a map learned on some walks foretell the readings of others? Real ones: a beacon carried through a room.

Each walk in turn is left out; constants and shadowing of the twelve receivers are learned from the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.radio_recordings import Readings
from shared.radio import PathLoss, RadioLearner, RadioPrior, novelty
from shared.radio.path_loss import DEVICE_HEIGHT

__all__ = ["held_out_sigma"]

Array = NDArray[np.float64]

PRIOR = RadioPrior(power=10.0, exponent=0.7)
"""The beacon's strength is not known beforehand."""
GUESS = (-60.0, 2.0)
FEWEST = 5
SPREAD = 0.1
"""Metres to which the places of ``ble-positions`` are known."""


def held_out_sigma(readings: Readings, prior: RadioPrior = PRIOR) -> Mapping[str, float]:
    """Return the standard deviation in dB of the readings of walks left out, about what the other walks foretell.

    ``constants``: by path loss alone, its constants learned; ``map``: with shadowing; both again with ``_mean``, of the
    mean of five and more readings in a metre of a walk, which the fading of single readings does not drown.
    ``deviation``: root mean square of a reading's error over what the model says it is; 1 where it is honest.

    Raises:
        ValueError: it is not known where the transmitters are.
    """
    if readings.place is None:
        raise ValueError("a path loss needs the places of the transmitters")
    count = readings.transmitters
    guess = PathLoss(
        names=tuple(str(number) for number in range(count)),
        positions=readings.place + np.array([0.0, 0.0, DEVICE_HEIGHT]),
        power_1m=np.full(count, GUESS[0]),
        exponent=np.full(count, GUESS[1]),
    )
    without = replace(prior, shadowing=0.01, white=float(np.hypot(prior.white, prior.shadowing)))
    names = ("constants", "constants_mean", "map", "map_mean", "deviation")
    errors: dict[str, list[Array]] = {name: [] for name in names}
    for walk in np.unique(readings.walk):
        test = readings.walk == walk
        for name, believed in (("constants", without), ("map", prior)):
            error, sigma = _foretold(readings, guess, ~test, test, believed)
            errors[name].append(error)
            errors[f"{name}_mean"].append(_means(error, readings.transmitter[test], readings.position[test]))
            if name == "map":
                errors["deviation"].append(error / sigma)
    return {name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in errors.items()}


def _foretold(
    readings: Readings, guess: PathLoss, teach: NDArray[np.bool_], test: NDArray[np.bool_], prior: RadioPrior
) -> tuple[Array, Array]:
    """Return by how much each tested reading is off, and by how much it should be, dB."""
    places = readings.position
    learner = RadioLearner.over(guess, places.min(axis=0) - 1.0, places.max(axis=0) + 1.0, prior=prior)
    for walk in np.unique(readings.walk[teach]):
        for number in range(readings.transmitters):
            mine = np.flatnonzero((readings.walk == walk) & (readings.transmitter == number))
            residual = readings.rssi[mine] - guess.rssi(places[mine])[:, number]
            spread = np.full(len(mine), SPREAD)
            learner.learn(places[mine], spread, readings.transmitter[mine], residual, novelty(places[mine]))
    model = learner.solve()
    point = readings.transmitter[test]
    rows = np.arange(len(point))
    mean, variance = model.shadowing.at(places[test])
    expected = model.path_loss.rssi(places[test])[rows, point] + mean[rows, point]
    sigma: Array = np.sqrt(variance[rows, point] + prior.white**2)
    return readings.rssi[test] - expected, sigma


def _means(error: Array, point: NDArray[np.int64], places: Array) -> Array:
    """Return the mean error of each transmitter in each square metre with at least ``FEWEST`` readings."""
    key = np.column_stack([point, np.floor(places)])
    _, group, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    mean: Array = np.bincount(group.ravel(), error) / count
    return mean[count >= FEWEST]
