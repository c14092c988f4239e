"""One model, one tracker, the last minutes once more: where were the devices when the withheld scans were made?

Every second scan of each device is withheld from the tracker and scored at the place of the track that carried the
device's name at that time, by what earlier ones tell of its offset (``offsets.py``). Active model and candidate both
start from nothing, and the first part of the time does not count: a state learned under the active model would speak
for it.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.evidence.identity_settings import NOISE
from services.fusion.registry import make_tracker
from services.fusion.rescore.quality import Array, Heard, Integers, Score, null_of, places_at, score_scans, score_walks
from services.fusion.tracker import Chunk
from shared.messages import MotionBatch, RadioScan

__all__ = ["LEAST_SCANS", "WARM_UP", "run_trial", "withhold"]

WARM_UP = 60.0
"""Seconds, or a third of the time where that is less, in which the trackers find out who is who."""
LEAST_SCANS = 20
"""Withheld scans without which nothing can be said."""
LONGEST_WALK = 2.0
"""Seconds of steps whose sum is held against a straight way."""
BRIDGE = 0.6
"""Seconds over which a place between two frames is believed."""


@dataclasses.dataclass(frozen=True)
class Withheld:
    """One device's withheld readings.

    Attributes:
        scans: how many scans they are of.
        t, level: (n,) s and dBm.
        access_point: (n,) columns of the area's access points.
        walks: (w, 4) begin, end, metres and their variance of its stretches of steps, after the warm-up.
    """

    scans: int
    t: Array
    level: Array
    access_point: Integers
    walks: Array


def withhold(chunks: Sequence[Chunk], names: Sequence[str]) -> tuple[list[Chunk], dict[str, Withheld], float]:
    """Return the chunks without every second scan of each device, those after the warm-up, and the time they cover."""
    column = {name: index for index, name in enumerate(names)}
    begin, end = (chunks[0].t_start, chunks[-1].t_end) if chunks else (0.0, 0.0)
    scored_from = begin + min(WARM_UP, (end - begin) / 3.0)
    turn: dict[str, int] = defaultdict(int)
    kept: list[Chunk] = []
    withheld: dict[str, list[RadioScan]] = defaultdict(list)
    for chunk in chunks:
        scans = []
        for scan in chunk.scans:
            turn[scan.device] += 1
            if turn[scan.device] % 2:
                scans.append(scan)
            elif scan.t >= scored_from:
                withheld[scan.device].append(scan)
        kept.append(dataclasses.replace(chunk, scans=tuple(scans)))
    walks: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)
    for chunk in chunks:
        for batch in chunk.motions:
            if batch.t_start >= scored_from and batch.step_t and 0.5 <= batch.t - batch.t_start <= LONGEST_WALK:
                row = (batch.t_start, batch.t, sum(batch.length), sum(batch.length_variance))
                walks[batch.device].append(row)
    columns = {device: _columns(scans, column, walks[device]) for device, scans in sorted(withheld.items())}
    return kept, columns, end - scored_from


def run_trial(
    chunks: Sequence[Chunk],
    withheld: Mapping[str, Withheld],
    view: AreaView,
    tracker: str,
    seed: int,
    scale: Mapping[str, float],
) -> dict[str, Score]:
    """Return each device's score under one model.

    Args:
        chunks: what the tracker may know.
        withheld: what it may not, by device.
        view: the area with the model's radio.
        tracker: name of the tracker.
        seed: of it.
        scale: factors of devices' step lengths.
    """
    machine = make_tracker(tracker, view, seed)
    paths: dict[str, dict[float, tuple[float, float]]] = defaultdict(dict)
    for chunk in chunks:
        frame = machine.step(_scaled(chunk, scale))
        for row, device in enumerate(frame.device):
            # A device followed by radio alone would be scored at a place made of radio.
            if device is not None and device in withheld and frame.state[row] != "unseen":
                paths[device][frame.t] = (frame.x[row], frame.y[row])
    everything = list(withheld.values())
    if not everything:
        return {}
    level = np.concatenate([one.level for one in everything])
    points = np.concatenate([one.access_point for one in everything])
    null = null_of(level, points, len(view.radio.names), NOISE)
    ways = {
        device: np.array([(t, *spot) for t, spot in sorted(paths[device].items())], float).reshape(-1, 3)
        for device in withheld
    }
    heard = [
        Heard(one.t, one.level, one.access_point, places_at(one.t, ways[device][:, 0], ways[device][:, 1:], BRIDGE))
        for device, one in withheld.items()
    ]
    scans = score_scans(heard, null, view.radio, view.shadowing, NOISE)
    scores = {}
    for (device, one), radio in zip(withheld.items(), scans, strict=True):
        path = ways[device]
        begin, end, length, variance = one.walks.T
        way = places_at(end, path[:, 0], path[:, 1:], BRIDGE) - places_at(begin, path[:, 0], path[:, 1:], BRIDGE)
        factor = scale.get(device, 1.0)
        steps = score_walks(factor * length, factor**2 * variance, end - begin, np.hypot(way[:, 0], way[:, 1]))
        scores[device] = radio + steps
    return scores


def _columns(
    scans: Sequence[RadioScan], column: Mapping[str, int], walks: Sequence[tuple[float, float, float, float]]
) -> Withheld:
    rows = [
        (scan.t, level, column[name])
        for scan in sorted(scans, key=lambda scan: scan.t)
        for name, level in zip(scan.access_point, scan.rssi, strict=True)
        if name in column and -120.0 <= level <= 0.0
    ]
    t, level, points = np.array(rows, float).reshape(-1, 3).T
    return Withheld(len(scans), t, level, points.astype(np.int64), np.array(walks, float).reshape(-1, 4))


def _scaled(chunk: Chunk, scale: Mapping[str, float]) -> Chunk:
    if not scale:
        return chunk
    return dataclasses.replace(
        chunk, motions=tuple(_longer(batch, scale.get(batch.device, 1.0)) for batch in chunk.motions)
    )


def _longer(batch: MotionBatch, factor: float) -> MotionBatch:
    return msgspec.structs.replace(
        batch,
        length=[factor * length for length in batch.length],
        length_variance=[factor**2 * variance for variance in batch.length_variance],
    )
