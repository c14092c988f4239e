"""Walks of which all is known: what a phone on the thigh or in the hand measures, and where its carrier went.

Two generators that share no code: the twin's own gait (``services.simulator.phones``) on the park and garden routes of
[nonvisual-visual-fusion-dissertation §7.2], and the minimal swinging thigh of §8 there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.reckoning.recent import RECENT, Recent, remember
from services.gateway.steps.detector import Steps
from services.simulator.phones.carrying import Carrying, CarryingParameters
from services.simulator.phones.gait import PhoneSensors, SensorParameters
from services.simulator.seeds import generator

__all__ = ["GARDEN", "PARK", "Walk", "hops_of", "replay", "rested", "swinging_thigh", "twin_walk", "yaw_error"]

Array = NDArray[np.float64]

PARK = [
    (130.0, 90.0),
    (87.5, 90.0),
    (130.0, 90.0),
    (87.5, 180.0),
    (87.5, -90.0),
    (130.0, -90.0),
    (87.5, -90.0),
    (130.0, 0.0),
]
"""870 m: anticlockwise round a rectangle, then turn round and back. Metres, and degrees turned to the left after."""
GARDEN = [
    *[
        (22.0, 45.0),
        (31.0, 90.0),
        (12.0, -45.0),
        (26.0, -90.0),
        (18.0, -90.0),
        (35.0, 45.0),
        (15.0, 45.0),
        (28.0, 135.0),
    ],
    *[(40.0, -45.0), (9.0, -90.0), (24.0, 90.0), (33.0, 90.0), (20.0, -45.0), (17.0, 45.0), (30.0, -90.0), (55.0, 0.0)],
]
"""415 m with many turns."""
FIELD = np.array([0.0, 20.0, -45.0])
"""µT, of the Earth in plan axes, of which y is north here."""


@dataclass(frozen=True, slots=True)
class Walk:
    """One walk at ``RATE``; all of it begins at t = 0.

    Attributes:
        acceleration: (n, 3) m/s², phone axes.
        rate: (n, 3) rad/s.
        field: (n, 3) µT.
        truth: (n, 3, 3) true rotations from the phone's axes to (east, north, up).
        attitude: the same as a filter would tell them.
        heading: (n,) where the walk leads, radians clockwise from north, unwrapped.
        walked: (n,) m.
        steps: (k,) times of footfalls, s.
        offset: (n,) of the phone's top against the walk, left positive, radians; meaningless in a pocket.
    """

    acceleration: Array
    rate: Array
    field: Array
    truth: Array
    attitude: Array
    heading: Array
    walked: Array
    steps: Array
    offset: Array

    def heading_at(self, t: Array) -> Array:
        """Return the mean heading of the steps that end at ``t``: that in the middle of them."""
        return np.interp(t - 0.27, np.arange(len(self.heading)) / RATE, self.heading)

    def lengths(self, t: Array) -> Array:
        """Return how far steps that end at ``t`` led, m."""
        walked = np.interp(t, np.arange(len(self.walked)) / RATE, self.walked)
        return np.diff(walked, prepend=walked[:1] - 0.7)


def yaw_error(rng: np.random.Generator, n: int, sigma: float, seconds: float = 20.0) -> Array:
    """Return a slowly varying error (n,), of standard deviation ``sigma``, whose memory is ``seconds``."""
    keep = math.exp(-1.0 / (seconds * RATE))
    kicks = rng.normal(0.0, sigma * math.sqrt(1.0 - keep * keep), n)
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks, zi=[keep * rng.normal(0.0, sigma)])[0])


def swinging_thigh(
    rng: np.random.Generator,
    seconds: float = 120.0,
    swing: float = 22.0,
    forward: float = 1.2,
    lateral: float = 1.2,
    yaw_sigma: float = 3.0,
) -> Walk:
    """Return a walk by the minimal generator of [nonvisual-visual-fusion-dissertation §8].

    Args:
        rng: decides period, route, mounting and noise.
        seconds: how long.
        swing: of the thigh, degrees.
        forward: amplitude of the footfalls, m/s².
        lateral: of the sway, m/s².
        yaw_sigma: of the attitude, degrees.
    """
    n, period = int(seconds * RATE), float(rng.uniform(0.98, 1.15))
    t = np.arange(n) / RATE
    phase = 2.0 * math.pi * t / period
    turning = 2.0 * math.pi / period
    big, small = math.radians(swing), math.radians(6.0)
    pitch = big * np.sin(phase) + small * np.sin(2.0 * phase + 0.7)
    rate = turning * (big * np.cos(phase) + 2.0 * small * np.cos(2.0 * phase + 0.7))
    turn = -(turning**2) * (big * np.sin(phase) + 4.0 * small * np.sin(2.0 * phase + 0.7))
    arm = 0.35
    ahead = arm * (turn * np.cos(pitch) - rate**2 * np.sin(pitch)) + forward * np.sin(2.0 * phase + 0.3)
    up = arm * (turn * np.sin(pitch) + rate**2 * np.cos(pitch)) + 2.0 * np.sin(2.0 * phase + 1.5) + 9.81
    left = lateral * np.sin(phase + 1.1)
    speed = 1.4 / period
    heading = _smooth_turns(t, *_random_turns(rng, seconds))  # counter-clockwise from east
    cos, sin = np.cos(heading), np.sin(heading)
    world = np.column_stack([cos * ahead - sin * left, sin * ahead + cos * left, up])
    # The thigh's lower end swings forward: a turn by -pitch about the left.
    thigh = Rotation.from_euler("ZY", np.column_stack([heading, -pitch])) * Rotation.random(random_state=rng)
    truth = thigh.as_matrix()
    relative = (thigh[:-1].inv() * thigh[1:]).as_rotvec() * RATE
    noise = rng.normal(0.0, 0.8, (n, 3))
    yaw = Rotation.from_euler("Z", yaw_error(rng, n, math.radians(yaw_sigma))[:, None])
    field = np.einsum("nij,i->nj", truth, FIELD)
    return Walk(
        acceleration=np.einsum("nij,ni->nj", truth, world) + noise,
        rate=np.concatenate([relative[:1], relative]),
        field=field,
        truth=truth,
        attitude=(yaw * thigh).as_matrix(),
        heading=math.pi / 2.0 - heading,
        walked=speed * t,
        steps=np.arange(1.0, int(2.0 * seconds / period)) * (0.5 * period),
        offset=np.zeros(n),
    )


def twin_walk(
    seed: int,
    route: Sequence[tuple[float, float]],
    carrying: Carrying = "pocket",
    yaw_sigma: float = 3.0,
    sensors: SensorParameters | None = None,
    habits: CarryingParameters | None = None,
) -> Walk:
    """Return a walk along ``route`` by the twin's gait.

    Args:
        seed: of walker, phone and noise.
        route: (metres, degrees turned to the left after them).
        carrying: where the phone is.
        yaw_sigma: of ``attitude``, degrees.
        sensors: of the phone.
        habits: of the walker.
    """
    rng = generator(seed, "gait walk", carrying)
    speed = float(rng.uniform(1.1, 1.5))
    seconds = sum(length for length, _ in route) / speed
    t = np.arange(int(seconds * RATE)) / RATE
    paces = speed * (1.0 + yaw_error(rng, len(t), 0.05, 8.0))
    walked = np.cumsum(paces) / RATE
    at = np.cumsum([length for length, _ in route])[:-1] / walked[-1] * sum(length for length, _ in route)
    times = np.interp(at, walked, t)
    heading = _smooth_turns(t, times, np.radians([turn for _, turn in route[:-1]])) + float(rng.uniform(0, 2 * math.pi))
    phone = PhoneSensors(generator(seed, "phone sensors"), carrying, RATE, sensors, None, habits)
    samples = phone.sample(t, heading, paces, walked, np.broadcast_to(FIELD, (len(t), 3)))
    yaw = Rotation.from_euler("Z", yaw_error(rng, len(t), math.radians(yaw_sigma))[:, None]).as_matrix()
    return Walk(
        acceleration=samples.acceleration,
        rate=samples.rotation,
        field=samples.field,
        truth=samples.attitude,
        attitude=yaw @ samples.attitude,
        heading=math.pi / 2.0 - heading,
        walked=walked,
        steps=samples.steps.t,
        offset=samples.carried.offset,
    )


def rested(walk: Walk, rng: np.random.Generator, seconds: float, noise: tuple[float, float] = (0.08, 0.008)) -> Walk:
    """Return the walk after the phone has lain still as at its beginning, as in a trial phase: its gyroscope is off by
    as much as in the walk.

    Args:
        walk: what follows.
        rng: of the noise.
        seconds: how long it lies.
        noise: of accelerometer and gyroscope, m/s² and rad/s.
    """
    n = round(seconds * RATE)
    turned = Rotation.from_matrix(walk.truth)
    bias = np.mean(walk.rate[1:] - (turned[:-1].inv() * turned[1:]).as_rotvec() * RATE, axis=0)
    return Walk(
        acceleration=np.concatenate([9.81 * walk.truth[0, 2] + rng.normal(0.0, noise[0], (n, 3)), walk.acceleration]),
        rate=np.concatenate([bias + rng.normal(0.0, noise[1], (n, 3)), walk.rate]),
        field=np.concatenate([np.repeat(walk.field[:1], n, axis=0), walk.field]),
        truth=np.concatenate([np.repeat(walk.truth[:1], n, axis=0), walk.truth]),
        attitude=np.concatenate([np.repeat(walk.attitude[:1], n, axis=0), walk.attitude]),
        heading=np.concatenate([np.full(n, walk.heading[0]), walk.heading]),
        walked=np.concatenate([np.zeros(n), walk.walked]),
        steps=walk.steps + seconds,
        offset=np.concatenate([np.full(n, walk.offset[0]), walk.offset]),
    )


def hops_of(walks: Sequence[Walk]) -> Iterator[Hops]:
    """Return the walks as hops of as many phones; where one has ended its last second repeats itself."""
    last = np.array([len(walk.acceleration) // HOP - 1 for walk in walks])
    for hop in range(int(last.max()) + 1):
        at = [slice(HOP * min(hop, end), HOP * (min(hop, end) + 1)) for end in last.tolist()]
        acceleration, rate, field = (
            np.stack([getattr(walk, name)[rows] for walk, rows in zip(walks, at, strict=True)])
            for name in ("acceleration", "rate", "field")
        )
        count = np.full(len(walks), HOP)
        fresh = np.full(len(walks), hop == 0)
        yield Hops(np.full(len(walks), hop * HOP / RATE), count, fresh, acceleration, rate, field)


def replay(
    walks: Sequence[Walk], steps: Sequence[Array] | None = None, delay: float = 0.3
) -> Iterator[tuple[Recent, Steps]]:
    """Return second by second what a method is given.

    Args:
        walks: one per phone; they end together with the shortest.
        steps: times of the steps of each; default the true ones.
        delay: seconds after which a step is told.
    """
    recent = np.zeros(len(walks), RECENT)
    times = [walk.steps for walk in walks] if steps is None else steps
    phone = np.repeat(np.arange(len(walks)), [len(each) for each in times])
    t = np.concatenate(list(times))
    told = np.floor((t + delay) * RATE / HOP).astype(int)
    periods = np.concatenate([np.append(np.diff(each)[:1], np.diff(each)) for each in times])
    shortest = min(len(walk.acceleration) for walk in walks) // HOP
    for hop, hops in enumerate(hops_of(walks)):
        if hop >= shortest:
            return
        rows = slice(hop * HOP, (hop + 1) * HOP)
        now = remember(recent, hops, hops.rotation, np.stack([walk.attitude[rows] for walk in walks]))
        mine = told == hop
        period = np.zeros(len(walks))
        period[phone[mine]] = periods[mine]
        yield now, Steps(phone[mine], t[mine], period > 0.0, period)


def _random_turns(rng: np.random.Generator, seconds: float) -> tuple[Array, Array]:
    times = np.cumsum(rng.uniform(8.0, 20.0, int(seconds / 8.0)))
    turns = rng.choice([-90.0, -45.0, 45.0, 90.0], len(times))
    return times[times < seconds - 3.0], np.radians(turns[times < seconds - 3.0])


def _smooth_turns(t: Array, times: Array, turns: Array, seconds: float = 1.5) -> Array:
    """Return a heading (n,) that turns by ``turns`` about ``times``."""
    share = np.clip((t[:, None] - times) / seconds + 0.5, 0.0, 1.0)
    return (share * share * (3.0 - 2.0 * share)) @ turns
