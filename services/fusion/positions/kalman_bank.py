"""All tracks' Kalman filters at once: constant velocity on the floor, as arrays.

State of each of n filters: x, y, vx, vy. Covariances are handled in closed form by 2 x 2 blocks, so that a step costs a
few array operations however many tracks there are, and gives the same bits wherever the arrays lie in memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["hold", "innovations", "predict", "start", "update"]

Array = NDArray[np.float64]

ADJUGATE = np.array([[1.0, -1.0], [-1.0, 1.0]])
"""Signs of the adjugate of a 2 × 2 matrix."""


def start(positions: Array, noise: Array, speed: float) -> tuple[Array, Array]:
    """Return mean (n, 4) and covariance (n, 4, 4) of filters that have seen one position each.

    Args:
        positions: (n, 2), metres.
        noise: (n, 2, 2), their covariances, m².
        speed: standard deviation of a person's velocity along each axis, m/s.
    """
    mean = np.zeros((len(positions), 4))
    mean[:, :2] = positions
    covariance = np.zeros((len(positions), 4, 4))
    covariance[:, :2, :2] = noise
    covariance[:, 2, 2] = covariance[:, 3, 3] = speed**2
    return mean, covariance


def predict(mean: Array, covariance: Array, dt: float, acceleration: float) -> None:
    """Carry all filters ``dt`` seconds forward, in place.

    Args:
        mean: (n, 4).
        covariance: (n, 4, 4).
        dt: seconds, not negative.
        acceleration: spectral density of the white acceleration, m²/s³.
    """
    mean[:, :2] += dt * mean[:, 2:]
    cross = covariance[:, :2, 2:]
    speed = covariance[:, 2:, 2:]
    covariance[:, :2, :2] += dt * (cross + cross.transpose(0, 2, 1)) + dt**2 * speed
    cross += dt * speed
    covariance += _white_acceleration(dt, acceleration)
    covariance[:, 2:, :2] = cross.transpose(0, 2, 1)


def hold(mean: Array, covariance: Array, dt: float, diffusion: float, speed: float) -> tuple[Array, Array]:
    """Return mean (n, 4) and covariance (n, 4, 4) of people who are taken to stay where they are for ``dt`` seconds.

    Args:
        mean: (n, 4).
        covariance: (n, 4, 4).
        dt: seconds, not negative.
        diffusion: by how much the variance of the place grows along each axis, m²/s.
        speed: standard deviation along each axis of the velocity with which they walk on, m/s.
    """
    held, spread = np.zeros_like(mean), np.zeros_like(covariance)
    held[:, :2] = mean[:, :2]
    spread[:, :2, :2] = covariance[:, :2, :2] + dt * diffusion * np.eye(2)
    spread[:, 2, 2] = spread[:, 3, 3] = speed**2
    return held, spread


def innovations(
    mean: Array, covariance: Array, positions: Array, noise: Array, lag: float = 0.0
) -> tuple[Array, Array, Array]:
    """Compare n filters with m measured positions.

    Args:
        mean: (n, 4).
        covariance: (n, 4, 4).
        positions: (m, 2), metres.
        noise: (m, 2, 2), m².
        lag: by how much the measurements are older than the filters, seconds.

    Returns:
        Squared distance in m², squared Mahalanobis distance, and log determinant of the innovation covariance,
        each (n, m).
    """
    expected, spread = _expectation(mean, covariance, lag)
    dx = positions[:, 0] - expected[:, 0, None]
    dy = positions[:, 1] - expected[:, 1, None]
    xx = spread[:, 0, 0, None] + noise[:, 0, 0]
    xy = spread[:, 0, 1, None] + noise[:, 0, 1]
    yy = spread[:, 1, 1, None] + noise[:, 1, 1]
    determinant = xx * yy - xy * xy
    mahalanobis: Array = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
    distance: Array = dx * dx + dy * dy
    log_determinant: Array = np.log(determinant)
    return distance, mahalanobis, log_determinant


def update(mean: Array, covariance: Array, positions: Array, noise: Array, lag: float = 0.0) -> tuple[Array, Array]:
    """Return mean (n, 4) and covariance (n, 4, 4) after filter i has seen position i.

    Args:
        mean: (n, 4).
        covariance: (n, 4, 4).
        positions: (n, 2), metres.
        noise: (n, 2, 2), m².
        lag: by how much the measurements are older than the filters, seconds; the motion in between is taken as
            straight.
    """
    expected, spread = _expectation(mean, covariance, lag)
    spread = spread + noise
    determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] ** 2
    # Of a symmetric matrix read backwards, the off-diagonal negated: the adjugate.
    inverse = spread[:, ::-1, ::-1] * ADJUGATE / determinant[:, None, None]
    towards = covariance[:, :, :2] if lag == 0.0 else covariance[:, :, :2] - lag * covariance[:, :, 2:]
    gain = towards[:, :, :1] * inverse[:, None, 0] + towards[:, :, 1:] * inverse[:, None, 1]
    surprise = positions - expected
    mean = mean + gain[:, :, 0] * surprise[:, :1] + gain[:, :, 1] * surprise[:, 1:]
    covariance = (
        covariance
        - gain[:, :, None, 0] * towards[:, None, :, 0]
        - gain[:, :, None, 1] * towards[:, None, :, 1]
    )  # fmt: skip
    return mean, 0.5 * (covariance + covariance.transpose(0, 2, 1))


def _expectation(mean: Array, covariance: Array, lag: float) -> tuple[Array, Array]:
    """Where the filters expect to have been ``lag`` seconds ago: (n, 2) and (n, 2, 2)."""
    if lag == 0.0:
        return mean[:, :2], covariance[:, :2, :2]
    cross = covariance[:, :2, 2:]
    spread: Array = covariance[:, :2, :2] - lag * (cross + cross.transpose(0, 2, 1)) + lag**2 * covariance[:, 2:, 2:]
    return mean[:, :2] - lag * mean[:, 2:], spread


def _white_acceleration(dt: float, density: float) -> Array:
    """Return the (4, 4) covariance that white acceleration of a spectral density adds over ``dt`` seconds."""
    place, both, speed = density * (dt**3 / 3.0), density * (dt**2 / 2.0), density * dt
    flat = [place, 0.0, both, 0.0, 0.0, place, 0.0, both, both, 0.0, speed, 0.0, 0.0, both, 0.0, speed]
    return np.array(flat).reshape(4, 4)
