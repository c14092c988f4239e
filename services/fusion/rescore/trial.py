"""One model, one tracker, the last minutes once more: where were the devices when the withheld scans were made?

Every second scan of each device is withheld from the tracker and scored at the place of the track that carried the
device's name at that time, by what earlier ones tell of its offset (``offsets.py``). Active model and candidate both
start from nothing, and the first part of the time does not count: a state learned under the active model would speak
for it. Nor does what lies outside the time that is asked about.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from services.fusion.evidence.identity_settings import NOISE
from services.fusion.registry import make_tracker
from services.fusion.rescore.quality import Array, Heard, Integers, Score, null_of, places_at, score_scans, score_walks
from services.fusion.rescore.setting import Setting, under
from services.fusion.rescore.sight import Sight, SightJudge
from services.fusion.tracker import Chunk
from shared.messages import RadioScan, TrackFrame

__all__ = ["LEAST_SCANS", "WARM_UP", "Held", "Paths", "Withheld", "run_trial", "score", "withhold"]

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
    """

    scans: int
    t: Array
    level: Array
    access_point: Integers


@dataclasses.dataclass(frozen=True)
class Held:
    """What a trial works on.

    Attributes:
        chunks: what the tracker may know.
        withheld: what it may not, by device.
        since: the time from which on is scored, seconds since the epoch …
        until: … up to this one.
    """

    chunks: Sequence[Chunk]
    withheld: Mapping[str, Withheld]
    since: float
    until: float

    @property
    def seconds(self) -> float:
        """How long is scored."""
        return max(self.until - self.since, 0.0)

    @property
    def scans(self) -> int:
        """How many scans are withheld."""
        return sum(one.scans for one in self.withheld.values())


def withhold(chunks: Sequence[Chunk], names: Sequence[str], since: float = -math.inf, until: float = math.inf) -> Held:
    """Withhold every second scan of each device, and score those after the warm-up and in the time asked about.

    Args:
        chunks: in order.
        names: ids of the area's access points.
        since: seconds since the epoch, what is asked about …
        until: … up to here; what was consumed later is left out.
    """
    column = {name: index for index, name in enumerate(names)}
    chunks = [chunk for chunk in chunks if chunk.t_start < until]
    begin, end = (chunks[0].t_start, chunks[-1].t_end) if chunks else (0.0, 0.0)
    scored_from = max(begin + min(WARM_UP, (end - begin) / 3.0), since)
    turn: dict[str, int] = defaultdict(int)
    kept: list[Chunk] = []
    withheld: dict[str, list[RadioScan]] = defaultdict(list)
    for chunk in chunks:
        scans = []
        for scan in chunk.scans:
            turn[scan.device] += 1
            if turn[scan.device] % 2:
                scans.append(scan)
            elif scored_from <= scan.t < until:
                withheld[scan.device].append(scan)
        kept.append(dataclasses.replace(chunk, scans=tuple(scans)))
    columns = {device: _columns(scans, column) for device, scans in sorted(withheld.items())}
    return Held(kept, columns, scored_from, min(end, until))


Paths = Mapping[str, Mapping[float, tuple[float, float]]]
"""By device and time, where the track was that bore its name, metres."""


def run_trial(
    held: Held, setting: Setting, tracker: str, seed: int, *, sight: bool = False
) -> tuple[Paths, Sight | None]:
    """Return where each device was under one side, and what cameras say of the tracks where that is asked.

    Args:
        held: what the tracker may know and what it may not.
        setting: the side.
        tracker: name of the tracker.
        seed: of it.
        sight: whether cameras are asked.
    """
    machine = make_tracker(tracker, setting.view, seed)
    judge = SightJudge(setting.view, held.since, held.until) if sight else None
    paths: dict[str, dict[float, tuple[float, float]]] = defaultdict(dict)
    before: TrackFrame | None = None
    for chunk in under(setting, held.chunks):
        if judge is not None and before is not None:
            judge.look(chunk.frames, before)
        before = frame = machine.step(chunk)
        for row, device in enumerate(frame.device):
            # A device followed by radio alone would be scored at a place made of radio.
            if device is not None and device in held.withheld and frame.state[row] != "unseen":
                paths[device][frame.t] = (frame.x[row], frame.y[row])
    return paths, None if judge is None else judge.sight()


def score(held: Held, setting: Setting, paths: Paths) -> dict[str, Score]:
    """Return each device's score, its withheld readings and steps held against ``paths`` by what one side believes."""
    everything = list(held.withheld.values())
    if not everything:
        return {}
    view = setting.view
    level = np.concatenate([one.level for one in everything])
    points = np.concatenate([one.access_point for one in everything])
    null = null_of(level, points, len(view.radio.names), NOISE)
    ways = {
        device: np.array([(t, *spot) for t, spot in sorted(paths.get(device, {}).items())], float).reshape(-1, 3)
        for device in held.withheld
    }
    heard = [
        Heard(one.t, one.level, one.access_point, places_at(one.t, ways[device][:, 0], ways[device][:, 1:], BRIDGE))
        for device, one in held.withheld.items()
    ]
    walks = _walks(under(setting, held.chunks), held)
    scores = {}
    for device, radio in zip(held.withheld, score_scans(heard, null, view.radio, view.shadowing, NOISE), strict=True):
        path = ways[device]
        begin, end, length, variance = np.array(walks[device], float).reshape(-1, 4).T
        way = places_at(end, path[:, 0], path[:, 1:], BRIDGE) - places_at(begin, path[:, 0], path[:, 1:], BRIDGE)
        scores[device] = radio + score_walks(end, length, variance, end - begin, np.hypot(way[:, 0], way[:, 1]))
    return scores


def _walks(chunks: Sequence[Chunk], held: Held) -> dict[str, list[tuple[float, float, float, float]]]:
    """Return begin, end, metres and their variance of each device's stretches of steps, in the time that is scored."""
    walks: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)
    for chunk in chunks:
        for batch in chunk.motions:
            inside = held.since <= batch.t_start and batch.t < held.until
            if inside and batch.step_t and 0.5 <= batch.t - batch.t_start <= LONGEST_WALK:
                row = (batch.t_start, batch.t, sum(batch.length), sum(batch.length_variance))
                walks[batch.device].append(row)
    return walks


def _columns(scans: Sequence[RadioScan], column: Mapping[str, int]) -> Withheld:
    rows = [
        (scan.t, level, column[name])
        for scan in sorted(scans, key=lambda scan: scan.t)
        for name, level in zip(scan.access_point, scan.rssi, strict=True)
        if name in column and -120.0 <= level <= 0.0
    ]
    t, level, points = np.array(rows, float).reshape(-1, 3).T
    return Withheld(len(scans), t, level, points.astype(np.int64))
