"""A small building site for the plain baselines: eleven by nine metres, five phones, three bystanders, one camera.

Set up as the numerical check of the method sheet [ravel-thesis §17]: 1 Hz, detection 0.85 moving and 0.3 still, camera
0.25 m, 0.5 false detections per frame, radio 4 dB.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.survey import Survey
from benchmarks.reference_world import DEPTH, WIDTH, ring, walk
from benchmarks.world_record import Truth, WorldRecord
from shared.messages import DetectionFrame, RadioScan
from shared.radio import PathLoss
from shared.site import Site

Array = NDArray[np.float64]

VIEW = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, DEPTH], [0.0, DEPTH]])


def make_site(access_points: int = 12) -> Site:
    return Site.model_validate(
        {
            "format": "atrium-site/1",
            "site": "small",
            "floors": [{"id": "ground", "outline": VIEW.tolist()}],
            "areas": [{"id": "yard", "floor": "ground"}],
            "access_points": [
                {"id": f"ap-{i}", "floor": "ground", "position": [*place, 2.5]}
                for i, place in enumerate(ring(access_points).tolist())
            ],
        }
    )


def sighted(t: float, places: Sequence[Sequence[float]] | Array, sigma: float = 0.25) -> DetectionFrame:
    return DetectionFrame(
        t=t,
        camera="cam",
        floor="ground",
        seq=round(t * 100),
        x=[float(place[0]) for place in places],
        y=[float(place[1]) for place in places],
        covariance=[(sigma**2, 0.0, sigma**2)] * len(places),
        confidence=[0.9] * len(places),
        box=[(0.0, 0.0, 20.0, 50.0)] * len(places),
    )


@dataclass
class SmallWorld:
    """Five carriers and three bystanders; what the camera and the phones tell of them."""

    seed: int = 1
    duration: float = 300.0
    frames_per_s: float = 1.0
    scans_per_s: float = 1.0
    carriers: int = 5
    bystanders: int = 3
    access_points: int = 12
    radio_sigma: float = 4.0
    camera_sigma: float = 0.25
    detected: tuple[float, float] = (0.85, 0.3)
    """Probability while moving and while still."""
    false_per_frame: float = 0.5
    site: Site = field(init=False)

    def __post_init__(self) -> None:
        self.site = make_site(self.access_points)
        self.model = PathLoss.of(self.site.access_points)

    def readings(self, rng: np.random.Generator, places: Array) -> Array:
        """Return readings (n, k) at places (n, 2); weak ones are missed."""
        power = self.model.rssi(places) + rng.normal(0.0, self.radio_sigma, (len(places), self.access_points))
        return np.where(power > -85.0, np.round(power), np.nan)

    def survey(self, spacing: float = 1.5, samples: int = 20) -> Survey:
        rng = np.random.default_rng([self.seed, 99])
        x, y = np.arange(0.5, WIDTH, spacing), np.arange(0.5, DEPTH, spacing)
        grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        readings = np.stack([self.readings(rng, grid) for _ in range(samples)], axis=1)
        return Survey([point.id for point in self.site.access_points], grid, readings)

    def record(self) -> WorldRecord:
        rng = np.random.default_rng(self.seed)
        people = self.carriers + self.bystanders
        t = np.arange(0.0, self.duration, 1.0 / self.frames_per_s)
        positions, moving = walk(rng, t, people)
        seen = rng.random(moving.shape) < np.where(moving, *self.detected)
        noisy = positions + rng.normal(0.0, self.camera_sigma, positions.shape)
        frames = []
        for i, now in enumerate(t):
            false = rng.uniform([0.0, 0.0], [WIDTH, DEPTH], (rng.poisson(self.false_per_frame), 2))
            places = np.concatenate([noisy[i, seen[i]], false])
            frames.append(sighted(float(now), rng.permutation(places), self.camera_sigma))
        devices = [f"phone-{i}" if i < self.carriers else None for i in range(people)]
        when = np.arange(0.0, self.duration, 1.0 / self.scans_per_s)
        scans = {}
        for person, device in enumerate(devices):
            if device is None:
                continue
            places = np.stack([np.interp(when, t, positions[:, person, axis]) for axis in range(2)], axis=1)
            scans[device] = [
                self._scan(device, now, i, row)
                for i, (now, row) in enumerate(zip(when, self.readings(rng, places), strict=True))
            ]
        truth = Truth(t, [f"p{i}" for i in range(people)], devices, positions, np.ones(moving.shape, bool))
        return WorldRecord(self.site, "yard", [], frames, scans, {}, truth, VIEW)

    def _scan(self, device: str, t: float, seq: int, row: Array) -> RadioScan:
        heard = np.flatnonzero(np.isfinite(row))
        names = [self.site.access_points[place].id for place in heard]
        return RadioScan(t=float(t), device=device, seq=seq, access_point=names, rssi=row[heard].tolist())
