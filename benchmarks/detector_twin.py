"""Do simulated detections err as the real detector does? Both look at the same people: those of PETS 2009.

The camera service watches the clip; the twin's detection model watches the clip's truth through the same camera. What
is compared is what trackers feel: how many are found and how many of the found are there, how far off and in which
direction, and how long misses and errors last. The defaults of ``DetectionParameters`` were chosen to come near; this
clip is therefore no test of them, but a check that stays. Run it with ``atrium bench detector-twin``.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from rich.progress import Progress
from scipy.optimize import linear_sum_assignment

from benchmarks.experiment import Experiment, Options
from benchmarks.pets_truth import FRAMES, FRAMES_PER_S, PetsTruth
from services.camera.pipeline import Pipeline, to_message
from services.camera.sources import open_source
from services.cli.demo import find_site
from services.simulator.cameras.detections import DetectionModel, DetectionParameters
from services.simulator.crowd.trajectories import Trajectories
from shared.messages import DetectionFrame, positions
from shared.settings import data_folder
from shared.site import Camera, Site, load_site

__all__ = ["EXPERIMENT", "main", "measure", "real_frames", "run", "twin_frames"]

Array = NDArray[np.float64]

GATE = 1.0
"""Metres within which a detection is of a person."""
SETTLED = 50
"""Frames after which the background is known well enough to be judged."""
TWINS = 3
"""Seeds whose figures are averaged."""


def real_frames(site: Site, progress: Progress) -> list[DetectionFrame]:
    """Return what the camera service makes of the clip."""
    camera = site.cameras[0]
    task = progress.add_task("camera service", total=FRAMES)
    pipeline = Pipeline(camera)
    frames = []
    for frame in open_source(camera, "fast").frames(threading.Event()):
        t = frame.seq / FRAMES_PER_S
        frames.append(
            to_message(camera.id, site.area(camera.area).floor, frame.seq, t, pipeline.process(frame.image, t))
        )
        progress.advance(task)
    return frames


def twin_frames(site: Site, seed: int) -> list[DetectionFrame]:
    """Return what the simulated camera makes of the clip's people."""
    camera = site.cameras[0]
    floor = site.floor(site.area(camera.area).floor)
    people = Trajectories.from_mot(data_folder() / "pets09-s2l1" / "gt" / "gt.txt", floor.id)
    model = DetectionModel(camera, floor, DetectionParameters(), FRAMES_PER_S, seed)
    return model.frames(people, 0.0, FRAMES / FRAMES_PER_S)


def measure(frames: Sequence[DetectionFrame], truth: PetsTruth, camera: Camera) -> dict[str, float]:
    """Return how often people in the area of interest are found, and how the errors hang together."""
    persons = np.unique(truth.person)
    where = np.full((FRAMES, len(persons), 2), np.nan)
    where[truth.frame, np.searchsorted(persons, truth.person)] = truth.position
    geometry = camera.geometry.build()
    feet = geometry.to_image(np.concatenate([where, np.zeros((FRAMES, len(persons), 1))], axis=2).reshape(-1, 3))
    interest = shapely.Polygon(camera.area_of_interest)
    inside = shapely.contains_xy(interest, feet[:, 0], feet[:, 1]).reshape(FRAMES, len(persons))
    error = np.full(where.shape, np.nan)
    false = 0
    for frame in frames[SETTLED:FRAMES]:
        there = np.flatnonzero(np.isfinite(where[frame.seq, :, 0]))
        found = positions(frame)
        distance = np.linalg.norm(found[:, None] - where[frame.seq, there], axis=2)
        rows, columns = linear_sum_assignment(np.where(distance < GATE, distance, 1e3))
        near = distance[rows, columns] < GATE
        false += len(found) - int(near.sum())
        error[frame.seq, there[columns[near]]] = found[rows[near]] - where[frame.seq, there[columns[near]]]
    hit = np.isfinite(error[..., 0])
    missed = np.where(inside, ~hit, np.nan)[SETTLED:]
    sight = where - geometry.position[:2]
    sight /= np.linalg.norm(sight, axis=2, keepdims=True)
    along = (error * sight).sum(axis=2)
    across = error[..., 1] * sight[..., 0] - error[..., 0] * sight[..., 1]
    return {
        "recall": 1.0 - float(np.nanmean(missed)),
        "precision": float(hit.sum() / (hit.sum() + false)),
        "rmse_m": float(np.sqrt(np.nanmean((error**2).sum(axis=2)))),
        "along_bias_m": float(np.nanmean(along)),
        "along_sd_m": float(np.nanstd(along)),
        "across_sd_m": float(np.nanstd(across)),
        "along_correlation": _next_correlation(along),
        "across_correlation": _next_correlation(across),
        "miss_correlation": _next_correlation(missed),
    }


def _next_correlation(series: Array) -> float:
    """Return the correlation of each person's value (n, p) with that of the next frame."""
    now, following = series[:-1], series[1:]
    both = np.isfinite(now) & np.isfinite(following)
    return float(np.corrcoef(now[both], following[both])[0, 1])


def run(options: Options, progress: Progress) -> dict[str, float]:
    """Measure the real detector, and the simulated one over some seeds."""
    site, truth = load_site(find_site("pets09")), PetsTruth.load()
    figures = measure(real_frames(site, progress), truth, site.cameras[0])
    twins = [measure(twin_frames(site, options.seed + k), truth, site.cameras[0]) for k in range(TWINS)]
    return figures | {f"twin_{name}": float(np.mean([twin[name] for twin in twins])) for name in figures}


EXPERIMENT = Experiment(
    name="detector-twin",
    question="Do simulated detections err as the real detector does?",
    kind="model",
    scenario="pets09-s2l1",
    seed=1,
    run=run,
    made=(
        "The camera service watches the PETS 2009 clip, the simulator's detection model (default parameters) watches "
        "the clip's truth through the same camera (`twin_…`, mean of three seeds). A detection within 1 m of a person "
        "is of that person; recall counts people in the area of interest; errors are along and across the line of "
        "sight; correlations are between one frame and the next, 1/7 s later. The defaults were chosen on this clip."
    ),
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
