"""The lessons of ``services/learning`` as the ladder takes them: from a training part to models, without truth.

The one place where experiments meet the learners.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion_run import FusionRun, chunks_of
from benchmarks.radio_training import learn_from_run, warmed_up
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.chunks import period_of
from services.fusion.registry import make_tracker
from services.fusion.rescore.quality import total
from services.fusion.rescore.trial import run_trial, withhold
from services.learning.tracks.stretch import Stretch
from shared.walking.stride import StrideLine
from shared.walking.stride_learning import fit_line

__all__ = ["detection_score", "learned_radio", "learned_strides"]

Array = NDArray[np.float64]

STEP = 0.35, 1.0
"""Seconds between which a step follows the one before."""
FEWEST = 60
"""Pairs of cadence and length without which a phone keeps the universal line."""
SURE = 0.5


def detection_score(record: WorldRecord, tracker: str, view: AreaView) -> float:
    """Return how well the tracks of these detections explain the scans withheld from them, nats per reading."""
    chunks = list(chunks_of(record, period_of(make_tracker(tracker, view).cycle)))
    kept, withheld, _ = withhold(chunks, view.radio.names)
    return total(list(run_trial(kept, withheld, view, tracker, 0, {}).values())).per_reading


def learned_radio(record: WorldRecord, run: FusionRun, view: AreaView) -> AreaView:
    """Return the view with the radio that a run's own tracks teach."""
    return warmed_up(view, learn_from_run(run, record.scans, view, record.site.site))


def learned_strides(stretches: Iterable[Stretch], fewest: int = FEWEST) -> Mapping[str, StrideLine]:
    """Return the line of each device that was seen to take ``fewest`` steps or more."""
    pairs: dict[str, list[Array]] = defaultdict(list)
    for stretch in stretches:
        if np.median(stretch.probability) >= SURE:
            pairs[stretch.device].append(_pairs(stretch))
    lines = {}
    for device, tables in pairs.items():
        cadence, length = np.concatenate(tables).T
        if len(cadence) >= fewest:
            lines[device] = fit_line(cadence, length)
    return lines


def _pairs(stretch: Stretch) -> Array:
    """Return (n, 2) cadence, steps/s, and length, m, of the steps that a camera watched from one end to the other."""
    t = stretch.step_t
    interval = np.diff(t)
    together = np.diff(stretch.walk) == 0
    place = np.column_stack([np.interp(t, stretch.t, stretch.place[:, axis]) for axis in (0, 1)])
    length = np.linalg.norm(np.diff(place, axis=0), axis=1)
    seen = np.interp(t, stretch.t, stretch.seen.astype(float)) > 0.99
    fine = together & (interval >= STEP[0]) & (interval <= STEP[1]) & seen[1:] & seen[:-1]
    return np.column_stack([1.0 / interval[fine], length[fine]])
