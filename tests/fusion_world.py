"""A small hall with two cameras and six access points, people who walk in it, and what cameras and phones tell."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.chunks import PERIOD, Chunker, ChunkerSettings
from services.fusion.tracker import Chunk
from services.simulator.radio.radio_world import RadioWorld
from shared.messages import DetectionFrame, MotionBatch, RadioScan, TrackFrame
from shared.site import Site, load_site

SITE = """
format: atrium-site/1
site: test-hall
floors:
  - {id: ground, outline: [[0, 0], [24, 0], [24, 14], [0, 14]]}
  - {id: first, level: 1, outline: [[0, 0], [24, 0], [24, 14], [0, 14]]}
areas:
  - {id: hall, floor: ground}
  - {id: gallery, floor: first}
cameras:
  - id: west
    area: hall
    source: {device: 0}
    geometry: {kind: pose, image_size: [960, 720], position: [12, -4, 9], look_at: [12, 7, 0], horizontal_fov: 90}
  - id: east
    area: hall
    source: {device: 1}
    geometry: {kind: pose, image_size: [960, 720], position: [12, 18, 9], look_at: [12, 7, 0], horizontal_fov: 90}
access_points:
  - {id: ap-1, floor: ground, position: [0.3, 0.3, 2.8]}
  - {id: ap-2, floor: ground, position: [12, 0.3, 2.8]}
  - {id: ap-3, floor: ground, position: [23.7, 0.3, 2.8]}
  - {id: ap-4, floor: ground, position: [23.7, 13.7, 2.8]}
  - {id: ap-5, floor: ground, position: [12, 13.7, 2.8]}
  - {id: ap-6, floor: ground, position: [0.3, 13.7, 2.8]}
  - {id: upstairs, floor: first, position: [12, 7, 6.8]}
"""


def make_site(folder: Path) -> Site:
    path = folder / "site.yaml"
    path.write_text(SITE)
    return load_site(path)


def make_view(folder: Path) -> AreaView:
    return AreaView.of(make_site(folder), "hall")


def frame(
    t: float,
    places: Sequence[Sequence[float]] | NDArray[np.float64] = (),
    camera: str = "west",
    seq: int = 0,
    confidence: float = 0.8,
    floor: str = "ground",
    sigma: float = 0.15,
) -> DetectionFrame:
    spots = np.asarray(places, float).reshape(-1, 2)
    count = len(spots)
    return DetectionFrame(
        t=t,
        camera=camera,
        floor=floor,
        seq=seq,
        x=spots[:, 0].tolist(),
        y=spots[:, 1].tolist(),
        covariance=[(sigma**2, 0.0, sigma**2)] * count,
        confidence=[confidence] * count,
        box=[(0.0, 0.0, 1.0, 1.0)] * count,
    )


def chunk(*frames: DetectionFrame, scans: Sequence[RadioScan] = (), motions: Sequence[MotionBatch] = ()) -> Chunk:
    index = math.floor(max(f.t for f in frames) / PERIOD + 1e-6)
    return Chunk(index, index * PERIOD, (index + 1) * PERIOD, frames, tuple(scans), tuple(motions))


@dataclass
class Walk:
    """A person on a Lissajous curve, with pauses where both speeds are small."""

    centre: tuple[float, float]
    size: tuple[float, float]
    period: tuple[float, float]
    phase: float

    def at(self, t: float) -> NDArray[np.float64]:
        return np.array(
            [
                self.centre[i] + self.size[i] * math.sin(2 * math.pi * t / self.period[i] + self.phase * (1 + i))
                for i in (0, 1)
            ]
        )


@dataclass
class World:
    """People, phones and cameras of one seeded run.

    Every person carries a phone named after their number.
    """

    site: Site
    seed: int = 0
    people: int = 5
    seconds: float = 30.0
    rate: float = 7.0
    cameras: tuple[str, ...] = ("west",)
    t0: float = 1_000_000.0
    walks: list[Walk] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        for number in range(self.people):
            self.walks.append(
                Walk(
                    centre=(4.0 + 16.0 * (number + 0.5) / self.people, 7.0 + rng.uniform(-1, 1)),
                    size=(rng.uniform(1.5, 3.0), rng.uniform(2.0, 4.0)),
                    period=(rng.uniform(14, 22), rng.uniform(18, 30)),
                    phase=rng.uniform(0, 6),
                )
            )

    def places(self, t: float) -> NDArray[np.float64]:
        return np.array([walk.at(t - self.t0) for walk in self.walks])

    def frames(self) -> list[DetectionFrame]:
        rng = np.random.default_rng(self.seed + 1)
        made = []
        for number in range(int(self.seconds * self.rate)):
            for index, camera in enumerate(self.cameras):
                t = self.t0 + number / self.rate + 0.01 * index
                seen = self.places(t)[rng.random(self.people) < 0.93]
                seen = seen + rng.normal(0, 0.12, seen.shape)
                made.append(frame(t, seen, camera, number))
        return made

    def scans(self) -> list[RadioScan]:
        radio = RadioWorld(self.site, self.seed)
        made = []
        for number in range(self.people):
            phone = radio.phone(str(number))
            for second in range(int(self.seconds)):
                t = self.t0 + second + 0.17 * number
                level = phone.scan([t - self.t0], self.places(t)[number], "ground")[0]
                heard = np.isfinite(level)
                names = [name for name, ok in zip(radio.access_points, heard, strict=True) if ok]
                made.append(
                    RadioScan(t=t, device=str(number), seq=second, access_point=names, rssi=level[heard].tolist())
                )
        return sorted(made, key=lambda scan: (scan.t, scan.device))

    def motions(self) -> list[MotionBatch]:
        rng = np.random.default_rng(self.seed + 2)
        made = []
        for number in range(self.people):
            bias = rng.normal(0, math.radians(15))
            for second in range(int(self.seconds) - 1):
                start = self.t0 + second + 0.11 * number
                spots = np.array([self.places(start + part)[number] for part in (0.0, 0.5, 1.0)])
                steps = np.diff(spots, axis=0)
                heading = np.arctan2(steps[:, 1], steps[:, 0]) + bias + rng.normal(0, 0.15, 2)
                made.append(
                    MotionBatch(
                        t=start + 1.0,
                        t_start=start,
                        device=str(number),
                        seq=second,
                        activity="walking",
                        step_t=[start + 0.49, start + 0.99],
                        length=np.hypot(*steps.T).tolist(),
                        length_variance=[0.01, 0.01],
                        heading=heading.tolist(),
                        heading_variance=[0.03, 0.03],
                    )
                )
        return sorted(made, key=lambda batch: (batch.t, batch.device))

    def chunks(self, *, motion: bool = True, period: float = PERIOD) -> list[Chunk]:
        """All of it through a chunker, phones half a second late."""
        events: list[tuple[float, int, DetectionFrame | RadioScan | MotionBatch]] = []
        events += [(f.t, 2, f) for f in self.frames()]
        events += [(s.t + 0.5, 0, s) for s in self.scans()]
        events += [(m.t + 0.5, 1, m) for m in self.motions()] if motion else []
        chunker, closed = Chunker(ChunkerSettings(period=period)), []
        for number, (_, kind, message) in enumerate(sorted(events, key=lambda event: event[:2])):
            if isinstance(message, DetectionFrame):
                closed += chunker.add_frame(message, f"{kind}-{number}")
            elif isinstance(message, RadioScan):
                chunker.add_scan(message, f"{kind}-{number}")
            else:
                chunker.add_motion(message, f"{kind}-{number}")
        return [one.chunk for one in closed]

    def located_share(self, frames: Sequence[TrackFrame], after: float = 0.0) -> float:
        """Share of person-time, ``after`` seconds on, in which the track named after a person is within a metre."""
        hits = []
        for tracks in frames:
            if tracks.t < self.t0 + after:
                continue
            truth = self.places(tracks.t)
            found = {device: (x, y) for device, x, y in zip(tracks.device, tracks.x, tracks.y, strict=True) if device}
            for number in range(self.people):
                place = found.get(str(number))
                hits.append(place is not None and float(np.hypot(*(truth[number] - place))) < 1.0)
        return float(np.mean(hits))
