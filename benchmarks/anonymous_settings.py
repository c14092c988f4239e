"""Are the anonymous tracker's defaults the best there are on worlds made for training? Each setting changed by itself.

Run it with ``atrium bench anonymous-settings``; nothing here looks at a clip or a seed by which the tracker is judged.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from scipy.optimize import linear_sum_assignment

from benchmarks.eth_recording import eth_recording
from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.fusion_run import chunks_of
from benchmarks.track_reading import newest_frames
from benchmarks.tracking_metrics import score_record
from benchmarks.world_record import Truth
from benchmarks.world_run import load, record_world
from services.fusion.area_view import AreaView
from services.fusion.evidence.tracker import AnonymousTracker
from services.fusion.positions.settings import AnonymousSettings
from services.fusion.tracker import Chunk
from shared.messages import TrackFrame, covariances, positions

__all__ = ["ALTERNATIVES", "EXPERIMENT", "Trial", "main", "score", "trials_of"]

Array = NDArray[np.float64]

WORLDS = (("museum", 11, "hall"), ("construction-1", 31, "west"), ("construction-2", 41, "east"))
"""Scenario, seed and area; training seeds."""
SECONDS = 240.0
"""How much of each world, and of the recording."""
TRUTH_EVERY = 5
"""Every so many-th time of the truth is scored."""
FRESH = 2.0
"""Seconds; what was told longer ago says nothing of who is there now."""
SAME = 0.04
"""Seconds within which a frame is of a time of the truth."""
FAR = 3.0
"""Metres beyond which a track is of nobody: wide, so that large errors are not taken for none."""
CHI_SQUARE_95 = 5.991
"""Of two degrees of freedom."""
ALTERNATIVES: Mapping[str, Sequence[float]] = {
    "acceleration": (0.1, 0.4),
    "start_speed": (0.7, 1.4),
    "gate": (2.5, 4.0),
    "gate_distance": (1.5, 2.5),
    "rest_gate": (0.7, 1.4),
    "dearest": (10.0, 1e6),
    "tentative_penalty": (3.0, 9.0),
    "birth_confidence": (0.2, 0.4),
    "birth_exclusion": (0.6, 1.0),
    "confirm_confidence": (1.5, 3.0),
    "confirm_hits": (2, 5),
    "confirm_age": (0.3, 0.8),
    "tentative_patience": (0.15, 0.5),
    "report": (0.35, 0.8),
    "coast": (1.5, 3.0, 4.0),
    "coast_leaving": (0.3, 1.0),
    "rest_report": (3.0, 8.0),
    "rest": (10.0, 40.0),
    "still_time": (1.0, 2.5),
    "still_radius": (0.25, 0.5),
    "walked": (0.6, 1.5),
    "rose_distance": (1.0, 2.0),
    "rose_time": (1.0, 4.0),
    "leaving_depth": (0.15, 0.5),
    "slow_down": (1.4, 5.0),
    "told": (0.3, 0.6),
    "look_ahead": (0.0, 0.6),
    "lasting": (0.3, 0.9),
    "rest_diffusion": (0.001, 0.01),
    "forget": (5.0, 20.0),
    "set_back": (0.5, 2.0),
    "longest_interval": (0.5, 2.0),
}
"""What is tried of each setting instead of its default."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One area's frames, cut into chunks, and the truth."""

    name: str
    view: AreaView
    chunks: Sequence[Chunk]
    truth: Truth


def trials_of() -> list[Trial]:
    """Return the worlds and the recording that settings are chosen on."""
    trials = [_eth()]
    for name, seed, area in WORLDS:
        scenario, site = load(name)
        record = record_world(scenario, site, seed, seconds=SECONDS, motion=False)[area]
        trials.append(Trial(name, AreaView.of(site, area), list(chunks_of(record)), record.truth))
    return trials


def score(trials: Sequence[Trial], settings: AnonymousSettings) -> dict[str, float]:
    """Return the figures of each trial, ``NAME_mota`` …, and ``goal``: the mean of MOTA + IDF1 - counting error."""
    figures: dict[str, float] = {}
    goal = 0.0
    for trial in trials:
        tracker = AnonymousTracker(trial.view, settings)
        frames = [tracker.step(chunk) for chunk in trial.chunks]
        tracking = score_record(trial.truth, frames, TRUTH_EVERY)
        miscount, bias = counting(trial.truth, frames)
        goal += (tracking.mota + tracking.idf1 - miscount) / len(trials)
        figures |= {
            f"{trial.name}_mota": tracking.mota,
            f"{trial.name}_idf1": tracking.idf1,
            f"{trial.name}_switches": tracking.switches,
            f"{trial.name}_fragmentations": tracking.fragmentations,
            f"{trial.name}_count_error": miscount,
            f"{trial.name}_count_bias": bias,
        }
        within, lost = honest(trial.truth, frames)
        figures |= {f"{trial.name}_within_95": within, f"{trial.name}_tracks_of_nobody": lost}
    return {"goal": goal} | figures


def counting(truth: Truth, frames: Sequence[TrackFrame]) -> tuple[float, float]:
    """Return mean absolute error and mean error of the number of people told, as shares of those in view."""
    newest = newest_frames(truth.t, frames, FRESH)
    told = np.array([0 if place < 0 else len(frames[place].track) for place in newest])
    there = truth.in_view.sum(axis=1)
    return float(np.abs(told - there).mean() / there.mean()), float((told - there).mean() / there.mean())


def honest(truth: Truth, frames: Sequence[TrackFrame]) -> tuple[float, float]:
    """Return the share of tracks nearer to their person than their covariance allows 95 % of them, and of nobody's.

    Tracks and people in view are matched one to one, so that as many as can be are within ``FAR`` metres, the sum of
    distances being least; a track without a person is counted in the second share, of all tracks. Only times of the
    truth that a frame is of count.
    """
    place = np.searchsorted(truth.t, [frame.t - SAME for frame in frames])
    inside: list[bool] = []
    tracks = 0
    for frame, row in zip(frames, place.tolist(), strict=True):
        if row == len(truth.t) or abs(truth.t[row] - frame.t) > SAME:
            continue
        tracks += len(frame.track)
        people = truth.position[row][truth.in_view[row]]
        apart = people[None] - positions(frame)[:, None]
        distance = np.hypot(apart[..., 0], apart[..., 1])
        mine, whose = linear_sum_assignment(np.where(distance <= FAR, distance, 1e3 * FAR * (1 + len(people))))
        near = distance[mine, whose] <= FAR
        off = apart[mine, whose][near]
        error = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances(frame)[mine[near]]), off)
        inside += (error <= CHI_SQUARE_95).tolist()
    return float(np.mean(inside)), 1.0 - len(inside) / tracks


def run(options: Options, progress: Progress) -> Figures:
    """Return the figures with the defaults, and by how much the goal rises with each change."""
    default, trials = AnonymousSettings(), trials_of()
    figures = score(trials, default)
    task = progress.add_task("settings", total=sum(len(values) for values in ALTERNATIVES.values()))
    gains = {}
    for name, values in ALTERNATIVES.items():
        for value in values:
            goal = score(trials, replace(default, **{name: value}))["goal"]  # type: ignore[arg-type]
            gains[f"gain_{name}_{value:g}"] = goal - figures["goal"]
            progress.advance(task)
    return figures | {"largest_gain": max(gains.values())} | gains


def _eth() -> Trial:
    recording = eth_recording()
    end = float(recording.t[0]) + SECONDS
    view = AreaView.of(recording.site, recording.area)
    chunks = [
        Chunk(frame.seq, frame.t, frame.t + 1.0 / 15.0, frames=(frame,)) for frame in recording.frames if frame.t < end
    ]
    kept = recording.t < end
    position = recording.position[kept]
    there: NDArray[np.bool_] = np.asarray(np.isfinite(position).all(axis=2))
    nobody = [None] * len(recording.person)
    return Trial("eth", view, chunks, Truth(recording.t[kept], recording.person, nobody, position, there))


EXPERIMENT = Experiment(
    name="anonymous-settings",
    question="Is any single change to the anonymous tracker's defaults better on worlds made for training?",
    kind="twin",
    scenario="training worlds",
    run=run,
    seeds=False,
    at_most={"largest_gain": 0.02},
    made="""Four minutes each of the museum (seed 11), the first construction site's west (31), the second's east (41)
and of the people of `eth-walking` with made detections; test seeds and PETS have no part in it. `goal` is the mean over
the four of MOTA + IDF1 − the mean error of the number of people told as a share of those in view. Each setting is
changed by itself: `gain_SETTING_VALUE` is what the goal gains over the defaults. Defaults are kept where a change gains
less than 0.02, which is what chance makes of four minutes. `within_95`: share of tracks nearer to their person than
the 95 % ellipse of their covariance (0.95 would be honest to the point), tracks and people in view matched one to one
within 3 m; `tracks_of_nobody`: share of tracks left without a person. The second half of `eth-walking`, which
`eth-phones` scores, is another part of the same recording.""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
