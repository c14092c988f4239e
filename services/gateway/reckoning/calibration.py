"""What do gyroscope and compass show that the world does not? The gyroscope's bias and the phone's own iron.

The field in the phone is ``m = Rᵀ E + h``: the Earth's and the building's E stands still while the phone turns by R,
and the iron's h does not. The gyroscope tells R, but for its bias. A walk that turns a few corners tells both, yet not
one without the other: who takes the gyroscope for right puts its bias into the iron, and who takes the field for right
its iron into the bias. So one error-state Kalman filter follows both, at rest and on the way.

On the traces of ``indoor-location`` h is 12 µT, the same in every trace that turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.angles import unit
from services.gateway.reckoning.complementary import GRAVITY, trusted_field, turned_since
from services.gateway.reckoning.hops import HOP, Array, Hops, State

__all__ = ["Calibration"]

_ANGLE, _BIAS, _IRON, _EARTH = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
_ERRORS = 12
"""Of R (rotation vector on the ground's side), the gyroscope's bias, iron and E."""
_DIAGONAL = np.arange(_ERRORS)
_FIELD, _GRAVITY, _REST = slice(0, 3), slice(3, 5), slice(5, 8)
_MEASURED = np.arange(8)
_IGNORED = 1e9
"""Variance of what was not measured."""


class Calibration:
    """Follows bias and iron of each phone; a hop is one step of the filter.

    Measured are the mean field and the mean acceleration of a hop, which is gravity, and where the phone lies still its
    rotation, which is bias. A second counts as still where neither acceleration nor rotation vary beyond their noise
    and the rotation is no more than a bias can be.

    Args:
        iron_sigma: µT, of each component of what a phone's own calibration leaves; 0 leaves the iron in.
        compass_tau: s, for which the attitude filter follows a gyroscope against the compass: that long a bias that is
            not known turns headings.
    """

    STATE = np.dtype(
        [
            ("frame", np.float64, (3, 3)),
            ("bias", np.float64, (3,)),
            ("iron", np.float64, (3,)),
            ("earth", np.float64, (3,)),
            ("covariance", np.float64, (_ERRORS, _ERRORS)),
            ("gyroscope", np.int64),
        ]
    )
    """R at the end of the last hop, from the phone's axes to level ones; rad/s; µT; E in the level axes, µT; whether it
    has ever turned, as a phone without gyroscope has not."""
    BIAS_SIGMA = 0.005
    """rad/s, 1000 °/h, of a phone of which nothing is known."""
    LARGEST_BIAS = 0.08
    """rad/s; no consumer gyroscope is off by more."""
    LEVEL_SIGMA = 0.1
    """rad, of R about level axes when a walk begins; about the vertical it is what E is told against."""
    EARTH_SIGMA = 40.0
    """µT, of E when a walk begins."""
    FIELD_SIGMA = 10.0
    """µT, of a hop's field: buildings bend it, from one second to the next alike."""
    GRAVITY_SIGMA = 0.4
    """m/s², of a hop's mean acceleration."""
    REST_SIGMA = 0.001
    """rad/s, of the mean of a still hop."""
    STILL = 0.10, 0.012
    """m/s² and rad/s: standard deviations at rest; sensors' noise is 0.02-0.08 and 0.002-0.008."""
    WANDERS = np.array([0.004] * 3 + [0.0001] * 3 + [0.03] * 3 + [0.3] * 3)
    """Of the errors in a second: rad, rad/s, µT, µT."""
    TURN_ERROR = 0.01
    """Of a turn, as a share of it."""
    WEAKEST = 10.0
    """µT; a weaker horizontal field is taken for this strong."""

    def __init__(self, iron_sigma: float = 6.0, compass_tau: float = 15.0) -> None:
        self._compass_tau = compass_tau
        level = [self.LEVEL_SIGMA, self.LEVEL_SIGMA, 0.0]
        begin = [*level, *[self.BIAS_SIGMA] * 3, *[iron_sigma] * 3, *[self.EARTH_SIGMA] * 3]
        self._begin_variance = np.square(begin)
        self._wanders = self.WANDERS**2
        if iron_sigma == 0.0:
            self._wanders[_IRON] = 0.0

    def advance(self, state: State, hops: Hops) -> tuple[Array, Hops]:
        """Take one hop of each of p phones and change ``state`` (p,) in place.

        Args:
            state: (p,) of ``STATE``; kept where a hop is fresh, since bias and iron belong to the phone.
            hops: the samples.

        Returns:
            (p, HOP, 3) rad/s without bias, and the hops without iron.
        """
        rate = hops.rotation - state["bias"][:, None]
        turned = turned_since(rate)
        use = hops.measured() & trusted_field(hops.field)
        share = use / np.maximum(use.sum(axis=1, keepdims=True), 1)
        seen: NDArray[np.bool_] = np.any(use, axis=1)
        mean_turned = np.einsum("pn,pnij->pij", share, turned)
        field = np.einsum("pnij,pnj->pi", turned, share[..., None] * np.where(use[..., None], hops.field, 0.0))
        gravity = np.einsum("pnij,pnj->pi", turned, hops.acceleration) / HOP
        self._begin(state, hops.fresh, gravity)
        error = self._correct(state, hops, seen, field, mean_turned, gravity)
        self._predict(state, turned, error)
        # Without a gyroscope nobody knows how the phone turned, and what looks like iron is none.
        state["gyroscope"] |= hops.rotation.any(axis=(1, 2))
        iron = np.where(state["gyroscope"][:, None] > 0, state["iron"], 0.0)
        return rate, replace(hops, field=hops.field - iron[:, None])

    def heading_variance(self, state: State) -> Array:
        """Return how far compass headings of p phones may be turned by what is not known of both, (p,) rad²."""
        frame, earth = state["frame"], state["earth"]
        strength = np.maximum(np.hypot(earth[:, 0], earth[:, 1]), self.WEAKEST)
        # Iron that lies across the horizontal field turns the compass; a bias about the vertical runs ahead of it.
        across = (earth[:, 1:2] * frame[:, 0] - earth[:, :1] * frame[:, 1]) / (strength**2)[:, None]
        turns = np.concatenate([self._compass_tau * frame[:, 2], across], axis=1)
        covariance = state["covariance"][:, 3:9, 3:9]
        variance: Array = np.einsum("pi,pij,pj->p", turns, covariance, turns)
        variance = np.where(state["gyroscope"] > 0, variance, self._begin_variance[_IRON][0] / strength**2)
        return np.where(state["covariance"][:, 0, 0] > 0.0, variance, 0.0)

    def drift_variance(self, state: State) -> Array:
        """Return by how much headings of p phones drift in a second where no compass holds them, (p,) (rad/s)²."""
        vertical = state["frame"][:, 2]
        variance: Array = np.einsum("pi,pij,pj->p", vertical, state["covariance"][:, _BIAS, _BIAS], vertical)
        return variance

    def _begin(self, state: State, fresh: NDArray[np.bool_], gravity: Array) -> None:
        """Forget where phones were turned to that begin anew, not their bias and iron."""
        unknown = state["covariance"][:, 3, 3] == 0.0
        anew = fresh | unknown
        if not anew.any():
            return
        state["covariance"][unknown] = np.diag(self._begin_variance)
        covariance = state["covariance"][anew]
        for part in (_ANGLE, _EARTH):
            covariance[:, part] = covariance[:, :, part] = 0.0
            covariance[:, _DIAGONAL[part], _DIAGONAL[part]] = self._begin_variance[part]
        state["covariance"][anew] = covariance
        state["earth"][anew] = 0.0
        up = unit(gravity[anew] + [0.0, 0.0, 1e-9])  # a phone that falls must be turned some way too
        ahead = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        level = unit(ahead - np.sum(ahead * up, axis=1, keepdims=True) * up)
        state["frame"][anew] = np.stack([level, np.cross(up, level), up], axis=1)

    def _correct(
        self, state: State, hops: Hops, seen: NDArray[np.bool_], field: Array, mean_turned: Array, gravity: Array
    ) -> Array:
        """Take what a hop measured into all but R; return the errors found, (p, 12)."""
        phones, frame = len(state), state["frame"]
        iron_turned = frame @ mean_turned
        jacobian = np.zeros((phones, len(_MEASURED), _ERRORS))
        ground = np.einsum("pij,pj->pi", frame, field) - np.einsum("pij,pj->pi", iron_turned, state["iron"])
        first = seen & ~state["earth"].any(axis=1)
        state["earth"][first] = ground[first]
        x, y, z = state["earth"].T
        jacobian[:, 0, 1], jacobian[:, 0, 2], jacobian[:, 1, 2] = -z, y, -x
        jacobian[:, 1, 0], jacobian[:, 2, 0], jacobian[:, 2, 1] = z, -y, x
        jacobian[:, _FIELD, _IRON] = iron_turned
        jacobian[:, _FIELD, _EARTH] = np.eye(3)
        jacobian[:, 3, 1], jacobian[:, 4, 0] = -GRAVITY, GRAVITY
        jacobian[:, _REST, _BIAS] = np.eye(3)
        missed = np.empty((phones, len(_MEASURED)))
        missed[:, _FIELD] = ground - state["earth"]
        missed[:, _GRAVITY] = np.einsum("pij,pj->pi", frame[:, :2], gravity)
        mean = hops.rotation.mean(axis=1)
        missed[:, _REST] = mean - state["bias"]
        still = self._still(hops, mean)
        variance = np.empty((phones, len(_MEASURED)))
        variance[:, _FIELD] = np.where(seen, self.FIELD_SIGMA**2, _IGNORED)[:, None]
        variance[:, _GRAVITY] = self.GRAVITY_SIGMA**2
        variance[:, _REST] = np.where(still, self.REST_SIGMA**2, _IGNORED)[:, None]
        missed[variance == _IGNORED] = 0.0
        known = jacobian @ state["covariance"]
        scatter = known @ np.swapaxes(jacobian, 1, 2)
        scatter[:, _MEASURED, _MEASURED] += variance
        gain = np.swapaxes(np.linalg.solve(scatter, known), 1, 2)
        error: Array = (gain @ missed[..., None])[..., 0]
        state["covariance"] -= gain @ known
        state["bias"] = np.clip(state["bias"] + error[:, _BIAS], -self.LARGEST_BIAS, self.LARGEST_BIAS)
        state["iron"] += error[:, _IRON]
        state["earth"] += np.where(seen[:, None], error[:, _EARTH], 0.0)
        return error

    def _predict(self, state: State, turned: Array, error: Array) -> None:
        """Correct R by ``error`` and turn it on to the end of the hop; doubt grows."""
        frame = Rotation.from_rotvec(error[:, _ANGLE]).as_matrix() @ state["frame"]
        drift = -frame @ turned.mean(axis=1)  # of R, by a bias in a second
        late = Rotation.from_rotvec(np.einsum("pij,pj->pi", drift, error[:, _BIAS])).as_matrix()
        after = late @ frame @ turned[:, -1]
        covariance = state["covariance"]
        covariance[:, _ANGLE] += drift @ covariance[:, _BIAS]
        covariance[:, :, _ANGLE] += covariance[:, :, _BIAS] @ np.swapaxes(drift, 1, 2)
        turn = np.einsum("pij,pij->p", after, frame)  # 1 + 2 cos of the angle
        covariance[:, _DIAGONAL, _DIAGONAL] += self._wanders
        of_turn = self.TURN_ERROR**2 * np.maximum(3.0 - turn, 0.0)
        covariance[:, _DIAGONAL[_ANGLE], _DIAGONAL[_ANGLE]] += of_turn[:, None]
        state["covariance"] = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
        state["frame"] = after

    def _still(self, hops: Hops, mean: Array) -> NDArray[np.bool_]:
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        still: NDArray[np.bool_] = (
            (hops.count == HOP)
            & (norm.std(axis=1) < self.STILL[0])
            & (hops.rotation.std(axis=1) < self.STILL[1]).all(axis=1)
            & (np.abs(mean) < self.LARGEST_BIAS).all(axis=1)
        )
        return still
