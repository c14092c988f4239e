"""The people before the ETH's main building, and what a camera above them would have detected.

The recording gives hand-marked positions 2.5 times a second and no detections; these are made: positions between the
marks, errors that last, misses that last, false detections here and there.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from benchmarks.phones_on_tracks import Recording, ring_of
from services.simulator.seeds import generator
from shared.messages import DetectionFrame
from shared.settings import data_folder
from shared.site import Site

__all__ = ["FRAMES_PER_S", "ORIGIN", "eth_carriers", "eth_recording"]

Array = NDArray[np.float64]

ORIGIN = 1_000_000.0
FRAMES_PER_S = 7.5
MARKS_PER_S, VIDEO_FRAMES_PER_S = 2.5, 15.0
"""Of the hand-marked positions, and of the video whose frames number them."""
OUTLINE = [(-10.0, -6.5), (16.5, -6.5), (16.5, 16.5), (-10.0, 16.5)]
"""The floor, metres: all marked positions and a little around them."""
IMAGE = [(0.0, 0.0), (640.0, 0.0), (0.0, 480.0), (640.0, 480.0)]
LOW, HIGH, HEIGHT = (-8.5, -4.5), (15.0, 14.5), 3.0
"""Corners of the rectangle on whose edges the access points hang, and how high, metres."""
ERROR_SIGMA, ERROR_TIME, WHITE_SIGMA = 0.12, 1.0, 0.08
"""Errors of a detection along each axis: lasting (metres, seconds), and from frame to frame (metres)."""
MISSED, MISS_TIME = 0.08, 0.3
"""Share of frames in which somebody is not found, and how long this lasts, seconds."""
FALSE = 0.1
"""False detections per frame."""
CONFIDENCE, FALSE_CONFIDENCE = 0.8, 0.4
SHARE = 0.2
"""Of the people carry a phone; half of these walk in company, and no two in the same."""
SEED = 0
"""Of the detections, which are the same whatever phones are tried on them."""


def eth_recording(points: int = 6, data: Path | None = None) -> Recording:
    """Return the people of ``eth-walking/seq_eth``, with so many access points around the scene."""
    folder = (data or data_folder()) / "eth-walking" / "seq_eth"
    rows = np.loadtxt(folder / "obsmat.txt")
    when = (rows[:, 0] - rows[0, 0]) / VIDEO_FRAMES_PER_S
    t = np.arange(math.ceil(FRAMES_PER_S * when[-1]) + 1) / FRAMES_PER_S
    people = np.unique(rows[:, 1]).astype(int)
    position = np.full((len(t), len(people), 2), np.nan)
    for column, person in enumerate(people):
        mine = rows[:, 1] == person
        there = (t >= when[mine][0] - 1e-6) & (t <= when[mine][-1] + 1e-6)
        position[there, column] = CubicSpline(when[mine], rows[mine][:, [2, 4]])(t[there])
    site = _site(np.loadtxt(folder / "H.txt"), points)
    names = [str(person) for person in people]
    return Recording(site, "square", _detections(position, ORIGIN + t), ORIGIN + t, names, position)


def eth_carriers(seed: int, data: Path | None = None) -> list[str]:
    """Return who carries a phone: a fifth of the people, half of them in company."""
    folder = (data or data_folder()) / "eth-walking" / "seq_eth"
    people = np.unique(np.loadtxt(folder / "obsmat.txt")[:, 1]).astype(int).tolist()
    groups = [[int(one) for one in line.split()] for line in (folder / "groups.txt").read_text().splitlines()]
    together = [sorted(set(group) & set(people)) for group in groups]
    together = [group for group in together if len(group) > 1]
    accompanied = {person for group in together for person in group}
    alone = [person for person in people if person not in accompanied]
    rng = generator(seed, "carriers")
    count = round(SHARE * len(people))
    chosen = rng.permutation(alone)[: count - count // 2].tolist()
    for number in rng.permutation(len(together)).tolist():
        group = together[number]
        if len(chosen) < count and not set(group) & set(chosen):
            chosen.append(int(rng.choice(group)))
    return [str(person) for person in sorted(chosen)]


def _site(homography: Array, points: int) -> Site:
    # The recording's matrix takes (row, column, 1) to metres.
    plan = []
    for u, v in IMAGE:
        x, y, scale = homography @ [v, u, 1.0]
        plan.append((x / scale, y / scale))
    return Site.model_validate(
        {
            "format": "atrium-site/1",
            "site": "eth-walking",
            "floors": [{"id": "ground", "outline": OUTLINE}],
            "areas": [{"id": "square", "floor": "ground"}],
            "cameras": [
                {
                    "id": "roof",
                    "area": "square",
                    "source": {"device": 0},
                    "geometry": {"kind": "points", "image_size": [640, 480], "image": IMAGE, "plan": plan},
                }
            ],
            "access_points": ring_of("ground", LOW, HIGH, points, HEIGHT),
        }
    )


def _detections(position: Array, t: Array) -> list[DetectionFrame]:
    """Return a frame at each of (n,) times, of (n, p, 2) positions."""
    rng = generator(SEED, "detections")
    count = position.shape[1]
    kept = math.exp(-1.0 / (ERROR_TIME * FRAMES_PER_S))
    begin = 1.0 / (MISS_TIME * FRAMES_PER_S)
    begin, end = begin * MISSED / (1.0 - MISSED), begin
    error = rng.normal(0.0, ERROR_SIGMA, (count, 2))
    missed: NDArray[np.bool_] = np.asarray(rng.random(count) < MISSED)
    covariance = (ERROR_SIGMA**2 + WHITE_SIGMA**2, 0.0, ERROR_SIGMA**2 + WHITE_SIGMA**2)
    low, high = np.array(LOW), np.array(HIGH)
    frames = []
    for number, when in enumerate(t.tolist()):
        error = kept * error + math.sqrt(1.0 - kept**2) * rng.normal(0.0, ERROR_SIGMA, (count, 2))
        draw = rng.random((2, count))
        missed = np.asarray((missed & (draw[0] >= end)) | (~missed & (draw[1] < begin)))
        white = rng.normal(0.0, WHITE_SIGMA, (count, 2))
        seen = np.isfinite(position[number, :, 0]) & ~missed
        false = rng.uniform(low, high, (rng.poisson(FALSE), 2))
        places = np.concatenate([(position[number] + error + white)[seen], false])
        confidence = [CONFIDENCE] * int(seen.sum()) + [FALSE_CONFIDENCE] * len(false)
        order = rng.permutation(len(places))
        frames.append(
            DetectionFrame(
                t=when,
                camera="roof",
                floor="ground",
                seq=number,
                x=places[order, 0].tolist(),
                y=places[order, 1].tolist(),
                covariance=[covariance] * len(places),
                confidence=[confidence[index] for index in order],
                box=[(0.0, 0.0, 1.0, 1.0)] * len(places),
            )
        )
    return frames
