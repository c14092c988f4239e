"""How does this person walk? Step thresholds and a stride line from trial walks [self-calibrating-rss-thesis §3.6].

The first walk, whose steps its walker has counted, gives the two step thresholds. With these the steps of both are
found, and a second, faster walk gives the line ``length = slope x cadence + offset`` through the two.

Unlike the thesis, which takes the distance between ``start`` and ``end`` along the plan's axes (Manhattan), it is that
of the straight line between them: trial walks are straight here, in any direction. ``distance`` comes before both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from services.gateway.devices.storage import Walker
from services.gateway.errors import RequestError, refuse
from services.gateway.phones.batch_check import Limits, check_batch
from services.gateway.protocol import Batch, FieldError, TrialWalk, TrialWalks, WalkFound
from services.gateway.reckoning.hops import Array
from services.gateway.reckoning.resampling import InertialSamples, Resampler, SingleHop, stack
from services.gateway.steps.thresholds import PersonalThresholds, TrialError, personalise
from shared.walking.stride import StrideLine
from shared.walking.stride_calibration import StrideCalibrationError, two_walks
from shared.walking.stride_calibration import TrialWalk as CalibrationWalk

__all__ = ["learn_from"]

SHORTEST, LONGEST = 3.0, 100.0
"""m, of a trial walk."""
FEWEST_STEPS = 5
"""Detected; fewer give no cadence."""
MISCOUNT = 0.2
"""Share of a walker's own count by which the detected steps may differ."""
STILL = 3
"""Seconds after which every step has been told."""


@dataclass(frozen=True, slots=True)
class _Recorded:
    distance: float
    hops: list[SingleHop]


def learn_from(body: TrialWalks, limits: Limits) -> tuple[Walker, list[WalkFound]]:
    """Return what trial walks tell of a person, and what was found in each.

    Args:
        body: one or two walks.
        limits: of the samples of each.

    Raises:
        RequestError: 422 naming the walk and why nothing can be learned from it.
    """
    for index, walk in enumerate(body.walks):
        if walk.steps is None and index == 0:
            refuse("walks[0].steps", "is missing", allowed="the steps of the first walk, as its walker counted them")
    recorded = [_record(walk, f"walks[{index}]", limits) for index, walk in enumerate(body.walks)]
    first = np.concatenate([hop.values[: hop.count, :3] for hop in recorded[0].hops])
    try:
        peak, mean = personalise(first, body.walks[0].steps or 0)
    except TrialError as error:
        refuse("walks[0]", "no step thresholds can be learned from it", str(error))
    detector = PersonalThresholds(peak, mean)
    walks = [CalibrationWalk(walk.distance, _steps(walk, detector)) for walk in recorded]
    found = [_found(walk, f"walks[{index}]", body.walks[index].steps) for index, walk in enumerate(walks)]
    if len(walks) == 1:
        return Walker(peak=peak, mean=mean), found
    line = _line(*walks)
    return Walker(peak, mean, float(line.slope), float(line.offset), float(line.scale_variance)), found


def _line(first: CalibrationWalk, second: CalibrationWalk) -> StrideLine:
    try:
        return two_walks(first, second)
    except StrideCalibrationError as error:
        walk, _, reason = str(error).partition(" walk: ")
        refuse("walks[1]" if walk == "second" else "walks[0]", "gives no stride line", reason)


def _record(walk: TrialWalk, place: str, limits: Limits) -> _Recorded:
    if walk.steps is not None and not 1 <= walk.steps <= 1000:
        refuse(f"{place}.steps", "is no count of steps", walk.steps, "1 to 1000")
    return _Recorded(_distance(walk, place), _hops(_samples(walk, place, limits), place))


def _found(walk: CalibrationWalk, place: str, counted: int | None) -> WalkFound:
    steps = len(walk.step_t)
    if steps < FEWEST_STEPS:
        refuse(place, "too few steps were found", steps, f"{FEWEST_STEPS} or more; did the phone record the walk?")
    if counted is not None and abs(steps - counted) > max(2.0, MISCOUNT * counted):
        refuse(f"{place}.steps", "is far from what was detected", counted, f"about {steps}")
    cadence = (steps - 1) / float(walk.step_t[-1] - walk.step_t[0])
    return WalkFound(steps=steps, cadence=cadence, step_length=walk.distance / steps)


def _distance(walk: TrialWalk, place: str) -> float:
    distance = walk.distance
    if distance is None:
        if walk.start is None or walk.end is None:
            refuse(f"{place}.distance", "is missing", allowed="distance, or start and end")
        distance = math.dist(walk.start, walk.end)
    if not SHORTEST <= distance <= LONGEST:
        refuse(f"{place}.distance", "is out of range", distance, f"{SHORTEST:g} to {LONGEST:g} m")
    return distance


def _samples(walk: TrialWalk, place: str, limits: Limits) -> InertialSamples:
    try:
        samples = check_batch(Batch(sent=max(walk.imu.t, default=0.0), seq=0, imu=walk.imu), limits)
    except RequestError as error:
        problems = [
            FieldError(field=f"{place}.{each.field}", problem=each.problem, found=each.found, allowed=each.allowed)
            for each in error.reply.detail
        ]
        raise RequestError(error.status, *problems) from error
    if samples is None:
        refuse(f"{place}.imu", "is missing", allowed="required")
    return samples


def _hops(samples: InertialSamples, place: str) -> list[SingleHop]:
    resampler = Resampler()
    hops = resampler.push(samples) + resampler.finish()
    if sum(hop.fresh for hop in hops) != 1:
        refuse(f"{place}.imu.t", "has holes", allowed="samples at 25 Hz and more, from beginning to end")
    return hops


def _steps(walk: _Recorded, detector: PersonalThresholds) -> Array:
    """Return the times of steps, s; after its end the phone is thought to be still until every step has been told."""
    state = np.zeros(1, detector.STATE)
    last = walk.hops[-1]
    rest = np.repeat(last.values[None, last.count - 1], len(last.values), axis=0)
    still = [SingleHop(last.t + 1.0 + second, len(rest), fresh=False, values=rest) for second in range(STILL)]
    return np.concatenate([detector.advance(state, stack([hop])).t for hop in (*walk.hops, *still)])
