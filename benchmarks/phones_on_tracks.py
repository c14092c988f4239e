"""What would phones have heard and felt in the pockets of people whose paths were really recorded?

Real trajectories, emulated phones: radio from the twin's radio world (its constants and shadowing unknown to the
tracker), steps and headings with the errors dead reckoning has. Phones live longer than the view: eight seconds before
and after it they are heard as well, walking straight on.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from benchmarks.world_record import Truth, WorldRecord
from services.simulator.radio.radio_world import RadioParameters, RadioWorld
from services.simulator.seeds import generator
from shared.messages import DetectionFrame, MotionBatch, RadioScan
from shared.site import AccessPoint, Site

__all__ = [
    "AROUND",
    "HARSH",
    "RADIO",
    "Recording",
    "between",
    "only_phones",
    "phones_on",
    "ring_of",
    "with_site_points",
    "without_motion",
]

Array = NDArray[np.float64]

AROUND = 8.0
"""Seconds before and after its view in which a phone is heard too."""
RADIO = RadioParameters(
    shadowing_sigma=4.0,
    shadowing_length=3.0,
    noise_sigma=2.2,
    wall_loss=0.0,
    body_loss=0.0,
    facing_sigma=0.0,
    antenna_sigma=0.0,
    drift_sigma=0.0,
    rice_factor=1000.0,
    flicker_sigma=0.0,
    sensitivity=-88.0,
    sensitivity_slope=3.0,
)
"""Path loss whose constants are off by 3 dB and 0.2, shadowing of 4 dB over 3 m, white noise of 2.2 dB, phones that
differ by 3 dB."""

HARSH = RADIO.model_copy(
    update={"shadowing_sigma": 6.0, "shadowing_length": 1.5, "noise_sigma": 3.5, "device_sigma": 3.5}
)
"""Radio that is worse than trackers assume."""

FINE = 20.0
"""Points a second of the paths phones are carried along."""
SMOOTH = 0.4
"""Seconds over which hand-marked positions are smoothed before a phone follows them."""
WALKING = 0.3
"""Metres per second below which nobody makes steps."""
PAUSE = 1.5
"""Seconds without a step after which the next walk begins."""
STEP_MISSED, STEP_FALSE = 0.04, 0.02
"""Share of steps not detected; false steps per second."""
SCALE_SIGMA, LENGTH_SIGMA = 0.08, 0.08
"""Relative error of step length: of a person, and of each step."""
BIAS_SIGMA, WANDER_SIGMA, WANDER_TIME, HEADING_SIGMA = math.radians(12.0), math.radians(5.0), 10.0, math.radians(8.0)
"""Error of headings: of a walk, wandering (and within how many seconds), and of each step."""
STEP_T_SIGMA = 0.02
LATE = {"frame": 0.05, "radio": 0.4, "motion": 0.6}
"""Seconds after its measurement at which a message reaches the bus."""


@dataclass(frozen=True)
class Recording:
    """People who were really there, and what one camera saw of them.

    Attributes:
        site: with the access points the phones hear; ``area``: whose camera it is.
        area: see above.
        frames: detections, in order.
        t: (n,) times at which positions are known, seconds since the epoch.
        person: p ids.
        position: (n, p, 2) metres; NaN out of view.
    """

    site: Site
    area: str
    frames: Sequence[DetectionFrame]
    t: Array
    person: Sequence[str]
    position: Array


@dataclass(frozen=True)
class _Path:
    """Where one phone was: ``t`` (n,), ``place`` (n, 2), ``velocity`` (n, 2), at ``FINE`` points a second."""

    t: Array
    place: Array
    velocity: Array


def phones_on(
    recording: Recording,
    carriers: Sequence[str],
    seed: int,
    *,
    every: float = 1.0,
    parameters: RadioParameters = RADIO,
) -> WorldRecord:
    """Return the recording with a phone on each of ``carriers``.

    A person's phone depends on seed and person alone: that others carry one as well changes nothing about it. The truth
    holds where phones are out of view too, as long as they are heard.

    Args:
        recording: the people.
        carriers: ids of those with a phone; their devices are called ``phone-ID``.
        seed: of radio world and phones.
        every: seconds between a phone's scans.
        parameters: of the radio world.
    """
    radio = RadioWorld(recording.site, seed, parameters)
    floor = recording.site.area(recording.area).floor
    begin = float(recording.t[0]) - AROUND - 1.0
    scans: dict[str, list[RadioScan]] = {}
    motions: dict[str, list[MotionBatch]] = {}
    position = recording.position.copy()
    for person in carriers:
        device, column = f"phone-{person}", recording.person.index(person)
        paths = _paths(recording.t, recording.position[:, column])
        position[:, column] = _all_along(recording.t, recording.position[:, column], paths)
        rng = generator(seed, "phone", person)
        phase_radio, phase_motion = rng.random(2)
        walking = _Walking(device, rng)
        scans[device], motions[device] = [], []
        phone = radio.phone(device)
        for path in paths:
            times = path.t[0] + every * (phase_radio + np.arange(math.ceil((path.t[-1] - path.t[0]) / every)))
            times = times[times <= path.t[-1]]
            places = np.column_stack([np.interp(times, path.t, path.place[:, axis]) for axis in (0, 1)])
            readings = phone.scan(times - begin, places, floor)
            for t, levels in zip(times.tolist(), readings, strict=True):
                heard = np.flatnonzero(np.isfinite(levels)).tolist()
                scans[device].append(
                    RadioScan(
                        t=t,
                        device=device,
                        seq=len(scans[device]),
                        access_point=[radio.access_points[point] for point in heard],
                        rssi=levels[heard].tolist(),
                    )
                )
            motions[device] += walking.along(path, phase_motion)
    known: NDArray[np.bool_] = np.isfinite(recording.position[..., 0])
    heard_all = sorted((scan for mine in scans.values() for scan in mine), key=lambda scan: (scan.t, scan.device))
    walked = sorted((batch for mine in motions.values() for batch in mine), key=lambda batch: (batch.t, batch.device))
    told: list[list[tuple[float, DetectionFrame | RadioScan | MotionBatch]]] = [
        [(frame.t + LATE["frame"], frame) for frame in recording.frames],
        [(scan.t + LATE["radio"], scan) for scan in heard_all],
        [(batch.t + LATE["motion"], batch) for batch in walked],
    ]
    corners = np.array(recording.site.floor(floor).outline)
    carried = set(carriers)
    return WorldRecord(
        site=recording.site,
        area=recording.area,
        arrivals=list(heapq.merge(*told, key=lambda entry: entry[0])),
        frames=recording.frames,
        scans=scans,
        motions=motions,
        truth=Truth(
            recording.t,
            recording.person,
            [f"phone-{person}" if person in carried else None for person in recording.person],
            position,
            known,
        ),
        view=corners,
    )


def between(record: WorldRecord, start: float, end: float) -> WorldRecord:
    """Return the part of a record from ``start`` to ``end``, in seconds since the epoch."""
    truth = record.truth
    times = (truth.t >= start) & (truth.t < end)
    return WorldRecord(
        site=record.site,
        area=record.area,
        arrivals=[arrival for arrival in record.arrivals if start <= arrival[0] < end],
        frames=[frame for frame in record.frames if start <= frame.t < end],
        scans={device: [scan for scan in scans if start <= scan.t < end] for device, scans in record.scans.items()},
        motions={device: [one for one in mine if start <= one.t < end] for device, mine in record.motions.items()},
        truth=Truth(truth.t[times], truth.person, truth.device, truth.position[times], truth.in_view[times]),
        view=record.view,
    )


def only_phones(record: WorldRecord, devices: Collection[str]) -> WorldRecord:
    """Return the record as if nobody but the carriers of ``devices`` had a phone; all people are still there."""
    truth = record.truth
    return WorldRecord(
        site=record.site,
        area=record.area,
        arrivals=[
            arrival
            for arrival in record.arrivals
            if isinstance(arrival[1], DetectionFrame) or arrival[1].device in devices
        ],
        frames=record.frames,
        scans={device: scans for device, scans in record.scans.items() if device in devices},
        motions={device: mine for device, mine in record.motions.items() if device in devices},
        truth=Truth(
            truth.t,
            truth.person,
            [device if device in devices else None for device in truth.device],
            truth.position,
            truth.in_view,
        ),
        view=record.view,
    )


def without_motion(record: WorldRecord) -> WorldRecord:
    """Return the record as if phones told nothing but what they hear."""
    return WorldRecord(
        site=record.site,
        area=record.area,
        arrivals=[arrival for arrival in record.arrivals if not isinstance(arrival[1], MotionBatch)],
        frames=record.frames,
        scans=record.scans,
        motions={device: [] for device in record.motions},
        truth=record.truth,
        view=record.view,
    )


def ring_of(floor: str, lower: Sequence[float], upper: Sequence[float], count: int, height: float) -> list[AccessPoint]:
    """Return ``count`` access points spread evenly along the edges of a rectangle, the first in its lower left."""
    (x0, y0), (x1, y1) = lower, upper
    width, depth = x1 - x0, y1 - y0
    points = []
    for number in range(count):
        along = 2.0 * (width + depth) * number / count
        if along < width:
            x, y = x0 + along, y0
        elif along < width + depth:
            x, y = x1, y0 + along - width
        elif along < 2.0 * width + depth:
            x, y = x1 - (along - width - depth), y1
        else:
            x, y = x0, y1 - (along - 2.0 * width - depth)
        points.append(AccessPoint(id=f"ap-{number + 1}", floor=floor, position=(x, y, height)))
    return points


def with_site_points(site: Site, points: Sequence[AccessPoint]) -> Site:
    """Return the site with these access points and no others."""
    return site.model_copy(update={"access_points": list(points)})


# -- paths -----------------------------------------------------------------------------------------------------------


def _paths(t: Array, position: Array) -> list[_Path]:
    """Return where a phone goes, in pieces: what was recorded, short gaps bridged, and straight on before and after."""
    known = np.flatnonzero(np.isfinite(position[:, 0]))
    pieces = np.split(known, np.flatnonzero(np.diff(t[known]) > 2.0 * AROUND) + 1)
    paths = []
    for piece in pieces:
        if len(piece) < 2:
            continue
        steps = round(FINE * (t[piece[-1]] - t[piece[0]]))
        times = t[piece[0]] + np.arange(steps + 1) / FINE
        place = np.column_stack([np.interp(times, t[piece], position[piece, axis]) for axis in (0, 1)])
        place = gaussian_filter1d(place, SMOOTH * FINE, axis=0, mode="nearest")
        ahead = np.arange(1, round(AROUND * FINE) + 1)[:, None] / FINE
        last = min(len(place) - 1, round(FINE))
        if last > 0:
            leaving = (place[-1] - place[-1 - last]) * FINE / last
            coming = (place[last] - place[0]) * FINE / last
        else:
            leaving = coming = np.zeros(2)
        place = np.concatenate([place[0] - coming * ahead[::-1], place, place[-1] + leaving * ahead])
        place = gaussian_filter1d(place, SMOOTH * FINE, axis=0, mode="nearest")
        times = times[0] - AROUND + np.arange(len(place)) / FINE
        paths.append(_Path(times, place, np.gradient(place, 1.0 / FINE, axis=0)))
    return paths


def _all_along(t: Array, position: Array, paths: Sequence[_Path]) -> Array:
    """Return (n, 2) positions, out of view those of the phone's path; NaN where it has none."""
    whole = position.copy()
    for path in paths:
        rows = np.flatnonzero(np.isnan(position[:, 0]) & (t >= path.t[0]) & (t <= path.t[-1]))
        whole[rows] = np.column_stack([np.interp(t[rows], path.t, path.place[:, axis]) for axis in (0, 1)])
    return whole


# -- steps -----------------------------------------------------------------------------------------------------------


class _Walking:
    """What dead reckoning makes of one person's walk: a report each second."""

    def __init__(self, device: str, rng: np.random.Generator) -> None:
        self._device, self._rng = device, rng
        self._stride = math.exp(rng.normal(0.0, 0.08))
        self._scale = math.exp(rng.normal(0.0, SCALE_SIGMA))
        self._walk = self._seq = 0

    def along(self, path: _Path, phase: float) -> list[MotionBatch]:
        """Return the reports of one piece of the person's way."""
        rng = self._rng
        speed = np.hypot(*path.velocity.T)
        length = self._stride * (0.4 + 0.25 * np.minimum(speed, 2.5))
        moving = speed > WALKING
        grown = np.cumsum(np.where(moving, speed / length, 0.0)) / FINE
        at = np.flatnonzero(np.diff(np.floor(grown)) > 0) + 1
        at = at[rng.random(len(at)) >= STEP_MISSED]
        false = rng.integers(0, len(path.t), rng.poisson(STEP_FALSE * (path.t[-1] - path.t[0])))
        at = np.sort(np.concatenate([at, false]))
        when = path.t[at] + rng.normal(0.0, STEP_T_SIGMA, len(at))
        order = np.argsort(when)
        at, when = at[order], when[order]
        walk = np.cumsum(np.diff(when, prepend=-math.inf) > PAUSE)
        bias = rng.normal(0.0, BIAS_SIGMA, int(walk.max(initial=0)) + 1)[walk]
        wander = _wandering(when, rng)
        heading = np.arctan2(path.velocity[at, 1], path.velocity[at, 0])
        heading = heading + bias + wander + rng.normal(0.0, HEADING_SIGMA, len(at))
        heading = (heading + math.pi) % (2.0 * math.pi) - math.pi
        told = self._scale * length[at] * (1.0 + rng.normal(0.0, LENGTH_SIGMA, len(at)))
        batches: list[MotionBatch] = []
        for start in np.arange(path.t[0] + phase, path.t[-1] - 1.0, 1.0).tolist():
            mine = np.flatnonzero((when > start) & (when <= start + 1.0))
            here = slice(np.searchsorted(path.t, start), np.searchsorted(path.t, start + 1.0))
            batches.append(
                MotionBatch(
                    t=start + 1.0,
                    device=self._device,
                    seq=self._seq + len(batches),
                    t_start=start,
                    activity="walking" if moving[here].mean() > 0.5 else "still",
                    step_t=when[mine].tolist(),
                    step_t_variance=[STEP_T_SIGMA**2] * len(mine),
                    length=told[mine].tolist(),
                    length_variance=((SCALE_SIGMA**2 + LENGTH_SIGMA**2) * told[mine] ** 2).tolist(),
                    heading=heading[mine].tolist(),
                    heading_variance=[BIAS_SIGMA**2 + WANDER_SIGMA**2 + HEADING_SIGMA**2] * len(mine),
                    walk=self._walk + int(walk[mine[-1]] if len(mine) else 0),
                    heading_bias_variance=BIAS_SIGMA**2,
                    length_scale_variance=SCALE_SIGMA**2,
                )
            )
        self._walk += int(walk.max(initial=0)) + 1
        self._seq += len(batches)
        return batches


def _wandering(when: Array, rng: np.random.Generator) -> Array:
    """Return an Ornstein-Uhlenbeck process at (n,) increasing times."""
    kept = np.exp(-np.diff(when, prepend=-math.inf) / WANDER_TIME)
    fresh = rng.normal(0.0, WANDER_SIGMA, len(when))
    value, values = 0.0, np.zeros(len(when))
    for index, (share, new) in enumerate(zip(kept.tolist(), fresh.tolist(), strict=True)):
        value = share * value + math.sqrt(1.0 - share**2) * new
        values[index] = value
    return values
