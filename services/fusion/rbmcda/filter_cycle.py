"""One cycle of the identity filter, as arrays over (state, particle, device) [ravel-thesis §6.4, Alg. 2].

Each particle is a history of who was seen where; given it, every device is an unscented filter of its position and of
what the radio of each access point is off for it. The bias makes the original's *untrained models* bearable:
constants of access points and phones, and shadowing, are unknown by several dB, the same from scan to scan; as part
of the state they are learned while a camera sees the device and are no new evidence the second time.

Every device of the filter exists in every particle, in view or not. One that is out of view is moved by its steps and
its scans alone; to be born on a sighting, or found again, is the same event as to be seen once more, with a wider
Gaussian. So nobody has to be born on a stranger because their phone is heard.

The filter of a device follows from its history alone [ravel-thesis §6.1], and particles drawn from the same one share
it until they see the device as different people: each state is kept, and worked on, once.

Pure: the draws are handed in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.fusion.rbmcda.association import composites_of, draw_assignment, linked_to
from services.fusion.rbmcda.particles import Cycle, Draws, Estimate, Particles
from services.fusion.rbmcda.resampling import effective, systematic
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.unscented import BLOCK, camera_update, radio_update, sigma_points

__all__ = ["run_cycle"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KNOWN = 1.0
"""m²; forces are for those whose place is known to within a metre."""
LEAST = 1e-300
"""Weight that stands for none."""


@dataclass(frozen=True)
class _Bank:
    """The filters of a cycle: u states that some particle holds, each device's together.

    Attributes:
        mean: (S, u).
        covariance: (S, S, u).
        fed: (u,) whether a camera saw the device in the last cycle.
        owner: (u,) whose state it is.
        start: (X + 1,) where each device's states begin.
        state: (N, X) which each particle holds.
    """

    mean: Array
    covariance: Array
    fed: NDArray[np.bool_]
    owner: Indices
    start: Indices
    state: Indices

    @classmethod
    def of(cls, before: Particles, spare: NDArray[np.bool_], apart: bool) -> _Bank:
        """Copy the states that are held, and one more at the end of those of each device that is to have a ``spare``.

        Args:
            before: the particles of the cycle before.
            spare: (X,).
            apart: whether every particle is to have a state of its own.
        """
        particles, devices = before.state.shape
        if apart:
            held = before.state.T.ravel()
            state = np.arange(len(held)).reshape(devices, particles).T
        else:
            held, state = np.unique(before.state, return_inverse=True)
        owner, fed = np.empty(len(held), np.int64), np.empty(len(held), np.bool_)
        owner[state], fed[state] = np.arange(devices), before.fed
        end = np.cumsum(np.bincount(owner, minlength=devices))
        # Which of these each state is: the spare ones are copies until they are overwritten.
        source = np.insert(np.arange(len(held)), end[spare], end[spare] - 1)
        spares = np.cumsum(spare)
        return cls(
            mean=before.mean[:, held[source]],
            covariance=before.covariance[:, :, held[source]],
            fed=fed[source],
            owner=owner[source],
            start=np.concatenate([[0], end + spares]),
            state=state + (spares - spare),
        )


def run_cycle(before: Particles, cycle: Cycle, settings: RbmcdaSettings, draws: Draws) -> tuple[Particles, Estimate]:
    """Predict, take in scans and sightings, weigh, estimate, and draw the particles anew where too few count."""
    jumps = np.zeros(before.fed.shape, np.bool_)
    fresh = list(cycle.anew)
    rate = np.where(before.fed[:, fresh], settings.jump, settings.jump_unseen)
    jumps[:, fresh] = draws.jump[:, fresh] < rate
    jumpers = np.asarray(jumps.any(axis=0))
    bank = _Bank.of(before, jumpers, cycle.push is not None)
    _predict(bank, cycle)
    mean, covariance = bank.mean, bank.covariance
    alone = (mean, covariance) if settings.radio_only else (mean.copy(), covariance.copy())
    evidence = radio_update(mean, covariance, cycle.expected, cycle.reading, cycle.noise, bank.owner)
    spare = bank.start[1:] - 1
    for device in np.flatnonzero(jumpers).tolist():
        mean[:, spare[device]], covariance[:, :, spare[device]], evidence[spare[device]] = cycle.anew[device]
    state = np.where(jumps, spare, bank.state)
    hasty = covariance[:2, :2].copy()
    hasty[[0, 1], [0, 1]] += cycle.haste[bank.owner]
    seen_as, growth = draw_assignment(
        composites_of(mean[:2], hasty, bank.start, cycle.places, cycle.place_noise, settings.gate),
        state - bank.start[:-1],
        cycle.detection,
        _view_share(mean[:2], hasty, cycle.in_view)[state],
        cycle.density,
        settings.merged,
        linked_to(cycle.link, np.where(jumps, -1, before.link)),
        cycle.switched,
        cycle.favour,
        cycle.pickup,
        draws.order,
        draws.uniform,
    )
    growth += evidence[state]
    fed = seen_as >= 0
    # Whom no camera saw keeps the prediction where radio is no correction on its own.
    held = state if settings.radio_only else np.where(fed, state, bank.state)
    different = len(cycle.places) + 1
    keys, state = np.unique(held * different + seen_as + 1, return_inverse=True)
    source, sighting = keys // different, keys % different - 1
    mean, covariance = _looked(source, sighting, alone, (mean, covariance), hasty, cycle)
    weight = before.weight
    if not settings.separate:
        weight = np.broadcast_to(weight[:, :1], weight.shape)
        growth = np.broadcast_to(growth.sum(axis=1, keepdims=True), growth.shape)
    log_weight = np.log(np.maximum(weight, LEAST)) + growth
    weight = np.exp(log_weight - log_weight.max(axis=0, initial=-np.inf))
    weight /= weight.sum(axis=0)
    after = Particles(
        weight=weight,
        mean=mean,
        covariance=covariance,
        state=state,
        fed=fed,
        seen=np.where(fed, cycle.t, before.seen),
        link=np.where(fed, np.append(cycle.link, -1)[seen_as], -1),
    )
    estimate = _estimate(after, cycle, seen_as)
    poor = np.flatnonzero(effective(weight) < settings.resample_below * len(weight))
    if len(poor):
        lots = draws.resampling if settings.separate else np.full_like(draws.resampling, draws.resampling[0])
        after.redraw(systematic(weight[:, poor], lots[poor]), poor)
    return after, estimate


def _predict(bank: _Bank, cycle: Cycle) -> None:
    """Let the states move as in the cycle (eq. 4.2, 4.12)."""
    mean, covariance, owner = bank.mean, bank.covariance, bank.owner
    # Who was seen at the end of the last cycle was where the camera said, whatever had been guessed.
    mean[:2] += np.where(bank.fed, 0.0, cycle.owed[:, owner])
    if cycle.push is not None:
        known = covariance[0, 0] + covariance[1, 1] < KNOWN
        shift, slope = cycle.push(mean[:2, bank.state], known[bank.state])
        mean[:2, bank.state] += shift
        pushed = np.repeat(np.eye(2)[:, :, None], len(owner), axis=2)
        pushed[:, :, bank.state] = slope
        covariance[:2] = np.einsum("iju,jsu->isu", pushed, covariance[:2])
        covariance[:, :2] = np.einsum("iju,sju->siu", pushed, covariance[:, :2])
    mean[:2] += cycle.shift[:, owner]
    covariance[:2, :2] += cycle.spread[:, :, owner]
    usual, kept = cycle.usual[:, None], cycle.kept[owner]
    mean[2:] = usual + (mean[2:] - usual) * kept
    for begin in range(0, len(owner), BLOCK):
        left, of = kept[begin : begin + BLOCK], covariance[:, :, begin : begin + BLOCK]
        of[2:] *= left
        of[:, 2:] *= left
        of[2:, 2:] += cycle.bias[:, :, None] * (1.0 - left**2)


def _view_share(mean: Array, covariance: Array, in_view: Callable[[Array], Array]) -> Array:
    """Return (u,) how probably each state is in view."""
    points = sigma_points(mean, covariance)
    inside = in_view(points.transpose(0, 2, 1).reshape(-1, 2)).reshape(5, -1)
    share: Array = inside[0] / 3.0 + inside[1:].sum(axis=0) / 6.0
    return share


def _looked(
    source: Indices,
    sighting: Indices,
    alone: tuple[Array, Array],
    heard: tuple[Array, Array],
    hasty: Array,
    cycle: Cycle,
) -> tuple[Array, Array]:
    """Return the (S, v) and (S, S, v) states after cameras looked.

    Args:
        source: (v,) which state each was.
        sighting: (v,) as which it was seen; -1 for none.
        alone: the states of those not seen.
        heard: of those seen, before they were.
        hasty: (2, 2, u) their positions' covariance.
        cycle: what was seen.
    """
    mean, covariance = (np.empty((*each.shape[:-1], len(source))) for each in heard)
    for begin in range(0, len(source) if len(cycle.places) else 0, BLOCK):
        block = slice(begin, begin + BLOCK)
        x, p = heard[0][:, source[block]], heard[1][:, :, source[block]]
        p[:2, :2] = hasty[:, :, source[block]]
        # As if all had been seen; the others are put right below.
        noise = cycle.place_noise[sighting[block]].transpose(1, 2, 0)
        camera_update(x, p, cycle.places[sighting[block]].T, noise)
        mean[:, block], covariance[:, :, block] = x, p
    unseen = np.flatnonzero(sighting < 0)
    mean[:, unseen], covariance[:, :, unseen] = alone[0][:, source[unseen]], alone[1][:, :, source[unseen]]
    return mean, covariance


def _estimate(after: Particles, cycle: Cycle, seen_as: Indices) -> Estimate:
    weight = after.weight
    places, spreads = after.positions()
    mean = np.einsum("nx,inx->ix", weight, places)
    apart = places - mean[:, None, :]
    covariance = np.einsum("nx,ijnx->ijx", weight, spreads)
    covariance += np.einsum("nx,inx,jnx->ijx", weight, apart, apart)
    fed = (weight * after.fed).sum(axis=0)
    covariance[[0, 1], [0, 1]] += cycle.haste * (1.0 - fed)
    ever = np.isfinite(after.seen)
    share = (weight * ever).sum(axis=0)
    times = (weight * np.where(ever, after.seen - cycle.t, 0.0)).sum(axis=0)
    seen = np.where(share > 0.5, cycle.t + times / np.maximum(share, 0.5), -np.inf)
    agreed = (weight * (apart[0] ** 2 + apart[1] ** 2 < 1.0)).sum(axis=0)
    biases = np.einsum("nx,mnx->mx", weight, after.mean[2:, after.state])
    return Estimate(mean, covariance, biases, fed, seen, np.minimum(agreed, 1.0), seen_as, weight.copy())
