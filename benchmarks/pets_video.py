"""The main job on a real clip: raw video, all services, six emulated phones.

Reports MOTA, IDF1, switches, precision, recall, RMSE of the anonymous tracks (metres, 1 m gate), the share of time in
which the API places a phone within 1 m of its carrier, latency through the bus, and whether the recording replays to
the same bytes. Run it with ``atrium bench pets-video``.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from benchmarks.pets_picture import draw
from benchmarks.pets_run import PetsRun, run_clip
from benchmarks.pets_truth import FRAMES_PER_S, PetsTruth
from benchmarks.result import PICTURES, write_result
from benchmarks.tracking_metrics import TrackingScore, score_tracks
from services.cli.demo import find_site
from services.cli.recording import Recording
from services.cli.replay import Verdict, verify
from shared.site import load_site

__all__ = ["figures_of", "located_share", "main", "score_run"]

HARSH = {"ATRIUM_RADIO_SHADOWING": "6", "ATRIUM_RADIO_SHADOWING_LENGTH": "1.5", "ATRIUM_RADIO_NOISE": "3"}
"""Identity assumes about 4 dB of shadowing alike over 3 m, and 2.5 dB of noise."""
GATE = 1.0
FRESH = 2.0
BARS = {"mota": 0.75, "idf1": 0.65, "located_within_1m": 0.70, "replay_identical": 1.0}


def score_run(run: PetsRun, truth: PetsTruth, first: int = 0, last: int | None = None) -> TrackingScore:
    """Score the published tracks of clip frames ``first`` to ``last`` against people whose feet are in the picture."""
    tracks = {round((frame.t - run.origin) * FRAMES_PER_S): frame for frame in run.frames}
    last = int(truth.frame.max()) if last is None else last
    return score_tracks(truth, tracks, first, last, GATE)


def located_share(run: PetsRun, truth: PetsTruth) -> tuple[float, dict[int, float], list[float]]:
    """Return the share of a phone's time in view in which the API places it within 1 m, overall and by person.

    The API is asked at a wall-clock time and judged by where the person is at that very time: what it lags costs.
    The third value holds the errors in metres whenever a position not older than two seconds was given.
    """
    hits: dict[int, list[bool]] = {person: [] for person in run.carriers}
    errors = []
    for sample in run.samples:
        for person, device in run.carriers.items():
            place = truth.at(person, sample.t - run.origin)
            if place is None:
                continue
            given = sample.positions.get(device)
            error = float(np.hypot(given[0] - place[0], given[1] - place[1])) if given else np.inf
            hits[person].append(error <= GATE)
            if given and given[2] <= FRESH:
                errors.append(error)
    everything = [hit for person in hits.values() for hit in person]
    share = float(np.mean(everything)) if everything else 0.0
    return share, {person: float(np.mean(values)) for person, values in hits.items() if values}, errors


def claims_right(run: PetsRun, truth: PetsTruth) -> float:
    """Return the share of published names that are right: the track within 1 m of the phone's carrier.

    A name published while the carrier is out of view is wrong, wherever it is put.
    """
    carriers = {device: person for person, device in run.carriers.items()}
    right = []
    for frame in run.frames:
        elapsed = round((frame.t - run.origin) * FRAMES_PER_S) / FRAMES_PER_S
        for device, x, y in zip(frame.device, frame.x, frame.y, strict=True):
            if device in carriers:
                place = truth.at(carriers[device], elapsed)
                right.append(place is not None and bool(np.hypot(x - place[0], y - place[1]) <= GATE))
    return float(np.mean(right)) if right else 0.0


def figures_of(run: PetsRun, truth: PetsTruth) -> tuple[dict[str, float | None], dict[int, float], list[Verdict]]:
    """Return the figures of a run by name, the share located by person, and the replay's verdicts."""
    score = score_run(run, truth)
    halves = score_run(run, truth, 0, 397), score_run(run, truth, 398)
    share, by_person, errors = located_share(run, truth)
    recording = Recording(run.recording)
    verdicts = verify(recording, load_site(recording.site_file))
    latency = np.array(run.latency) * 1000.0
    figures: dict[str, float | None] = {
        "mota": score.mota,
        "idf1": score.idf1,
        "switches": score.switches,
        "precision": score.precision,
        "recall": score.recall,
        "rmse_m": score.rmse,
        "mota_first_half": halves[0].mota,
        "mota_second_half": halves[1].mota,
        "idf1_first_half": halves[0].idf1,
        "idf1_second_half": halves[1].idf1,
        "located_within_1m": share,
        "names_right": claims_right(run, truth),
        "phone_error_median_m": float(np.median(errors)) if errors else None,
        "phone_error_p90_m": float(np.percentile(errors, 90)) if errors else None,
        "latency_p50_ms": float(np.percentile(latency, 50)) if len(latency) else None,
        "latency_p99_ms": float(np.percentile(latency, 99)) if len(latency) else None,
        "frames_tracked": len(run.frames),
        "replay_identical": float(bool(verdicts) and all(verdict.identical for verdict in verdicts)),
        "restarts": run.restarts,
    }
    return figures, by_person, verdicts


def phones_seed() -> int:
    """Return the seed of the emulated phones and their radio world."""
    settings = yaml.safe_load((find_site("pets09").parent / "simulator.yaml").read_text(encoding="utf-8"))
    return int(settings["seed"])


def main() -> int:
    """Run, print, write; exit status 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="atrium bench pets-video", description=__doc__)
    parser.add_argument("--out", type=Path, help="write the result here instead of benchmarks/results")
    parser.add_argument("--keep", type=Path, help="keep recording and log in this folder")
    parser.add_argument(
        "--harsh", action="store_true", help="in a radio world far from what identity assumes; result pets-video-harsh"
    )
    parser.add_argument("--verbose", action="store_true", help="show what the services log")
    options = parser.parse_args()
    console = Console()
    experiment = "pets-video-harsh" if options.harsh else "pets-video"
    if options.harsh:
        os.environ.update(HARSH)
    truth = PetsTruth.load()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        with console.status("playing the clip at its own pace (two minutes) …"):
            run = run_clip(folder, quiet=not options.verbose)
        figures, by_person, verdicts = figures_of(run, truth)
    picture = options.out / f"{experiment}.png" if options.out else PICTURES / f"{experiment}.png"
    draw(run, truth, picture)
    bars = {} if options.harsh else BARS  # the bars are for the default world
    table = Table("figure", "measured", "bar", title="PETS 2009 S2.L1 view 1, raw video, causal, six phones")
    for name, value in figures.items():
        bar = f">= {bars[name]:g}" if name in bars else ""
        table.add_row(name, "–" if value is None else f"{value:.3f}".rstrip("0").rstrip("."), bar)
    console.print(table)
    for person, share in sorted(by_person.items()):
        console.print(f"  person {person:2d}: located within 1 m {share:.0%} of the time in view")
    for verdict in verdicts:
        console.print(f"  {verdict}")
    console.print(f"written to {write_result(experiment, 'pets09-s2l1', phones_seed(), figures, options.out)}")
    console.print(f"drawn in {picture}")
    missed = [name for name, bar in bars.items() if (figures[name] or 0.0) < bar]
    if missed:
        console.print(f"[red]below the bar: {', '.join(missed)}[/red]")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
