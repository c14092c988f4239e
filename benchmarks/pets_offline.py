"""The same detector and tracker on the same clip without the bus, as fast as they go, bit for bit reproducible.

A live run differs from the next in the last bits of its time stamps, and with them in a decision or two; this one does
not, so it carries the tight gate. Run it with ``atrium bench pets-offline``.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.pets_truth import FRAMES, FRAMES_PER_S, PetsTruth
from benchmarks.tracking_metrics import score_tracks
from services.camera.pipeline import Pipeline, to_message
from services.camera.sources import open_source
from services.cli.demo import find_site
from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Chunk
from shared.messages import TrackFrame
from shared.site import load_site

__all__ = ["EXPERIMENT", "main", "measure"]

ORIGIN = 1_000_000.0
"""An arbitrary start of the clip, the same in every run."""


def measure(data: Path | None = None, advance: Callable[[], object] = bool) -> dict[str, float | None]:
    """Return the figures of one run by name.

    Args:
        data: the data folder.
        advance: called after each frame.
    """
    site = load_site(find_site("pets09"))
    camera, area = site.cameras[0], site.areas[0]
    pipeline = Pipeline(camera)
    tracker = make_tracker(DEFAULT_TRACKER, AreaView.of(site, area.id))
    truth = PetsTruth.load(data)
    tracks: dict[int, TrackFrame] = {}
    detect_seconds = track_seconds = 0.0
    for frame in open_source(camera, "fast").frames(threading.Event()):
        t = ORIGIN + frame.seq / FRAMES_PER_S
        begun = time.perf_counter()
        detections = to_message(camera.id, area.floor, frame.seq, t, pipeline.process(frame.image, t))
        found = time.perf_counter()
        tracks[frame.seq] = tracker.step(Chunk(frame.seq, t, t + 1.0 / 15.0, frames=(detections,)))
        detect_seconds += found - begun
        track_seconds += time.perf_counter() - found
        advance()
    last = int(truth.frame.max())
    score = score_tracks(truth, tracks, 0, last)
    first_half, second_half = (score_tracks(truth, tracks, *half) for half in ((0, 397), (398, last)))
    return {
        "mota": score.mota,
        "idf1": score.idf1,
        "switches": score.switches,
        "precision": score.precision,
        "recall": score.recall,
        "rmse_m": score.rmse,
        "hota": score.hota,
        "mota_first_half": first_half.mota,
        "mota_second_half": second_half.mota,
        "idf1_first_half": first_half.idf1,
        "idf1_second_half": second_half.idf1,
        "detector_frames_per_s": len(tracks) / detect_seconds,
        "tracker_frames_per_s": len(tracks) / track_seconds,
    }


def run(options: Options, progress: Progress) -> Figures:
    """Return the figures of one run by name."""
    task = progress.add_task("detecting and tracking", total=FRAMES)
    return measure(advance=lambda: progress.advance(task))


EXPERIMENT = Experiment(
    name="pets-offline",
    question="What do detector and tracker make of a real clip, without the bus?",
    kind="recording",
    scenario="pets09-s2l1",
    run=run,
    seeds=False,
    made="""PETS 2009 S2.L1, view 1, as in `pets-video`. Detector and tracker alone, as fast as they go on one core. The
figures are reproducible to the bit (a live run differs from the next in a decision or two, with the last bits of its
time stamps), so this carries the tight gate in the tests: shares may not fall by 0.005, the error may not rise by
2 %.""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
