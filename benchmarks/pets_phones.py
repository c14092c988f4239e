"""How well are phones found among the people of a real clip, when all nineteen carry one?

Run it with ``atrium bench pets-phones``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.fusion_run import run_fusion
from benchmarks.pets_detections import ORIGIN, load_detections
from benchmarks.pets_truth import FRAMES, FRAMES_PER_S, PetsTruth
from benchmarks.phone_folds import EMULATED, POINTS, SCORED, Case, Split, add_options, draw_curves, measure
from benchmarks.phones_on_tracks import (
    AROUND,
    RADIO,
    Recording,
    between,
    only_phones,
    phones_on,
    ring_of,
    with_site_points,
)
from benchmarks.phones_picture import draw_overlays
from services.cli.demo import find_site
from services.simulator.radio.radio_world import RadioParameters
from shared.site import load_site

__all__ = ["EXPERIMENT", "main", "pets_folds", "pets_recording", "pets_whole"]

GROUPS = 2
"""Into which the people are split: one is tested, the other teaches."""
OVERLAYS = (150, 400, 700)
"""Frames of the clip that are drawn with names."""
LEAD = 10.0
"""Seconds the tested run begins before its scores count; they teach nobody."""

CORNERS = ((-20.0, -16.0), (8.0, 8.0))
"""The access points hang on the edges of this rectangle, metres."""


def pets_recording(points: int = POINTS[0], data: Path | None = None) -> Recording:
    """Return the clip's public detections and true positions, with so many access points around the crossing."""
    site = load_site(find_site("pets09"))
    if points != len(site.access_points):
        site = with_site_points(site, ring_of(site.areas[0].floor, *CORNERS, points, 3.0))
    truth = PetsTruth.load(data)
    people = np.unique(truth.person)
    position = np.full((FRAMES, len(people), 2), np.nan)
    position[truth.frame, np.searchsorted(people, truth.person)] = truth.position
    return Recording(
        site=site,
        area=site.areas[0].id,
        frames=load_detections(site, data),
        t=ORIGIN + np.arange(FRAMES) / FRAMES_PER_S,
        person=[str(person) for person in people],
        position=position,
    )


def pets_whole(seed: int, points: int = POINTS[0], every: float = 1.0, radio: RadioParameters = RADIO) -> list[Split]:
    """Return the whole clip with a phone on everybody."""
    recording = pets_recording(points)
    return [Split(phones_on(recording, recording.person, seed, every=every, parameters=radio), ORIGIN)]


def pets_folds(seed: int, points: int = POINTS[0], every: float = 1.0, radio: RadioParameters = RADIO) -> list[Split]:
    """Return the halves of the clip for each half of the people: taught by the others' phones in the other half.

    The tested run has phones on everybody, as ever; scores count for its half alone. Ten seconds between teaching
    and testing belong to neither.
    """
    [split] = pets_whole(seed, points, every, radio)
    whole, devices = split.test, list(split.test.scans)
    begin, half, end = ORIGIN, ORIGIN + FRAMES / FRAMES_PER_S / 2.0, ORIGIN + FRAMES / FRAMES_PER_S
    spans = {
        "first": (begin - AROUND - 1.0, begin, half),
        "second": (half - LEAD, half, end + AROUND + 1.0),
    }
    teaching = {"first": (half + LEAD, end + AROUND + 1.0), "second": (begin - AROUND - 1.0, half - LEAD)}
    splits = []
    for group in range(GROUPS):
        tested = devices[group::GROUPS]
        teachers = only_phones(whole, set(devices) - set(tested))
        for name, (first, start, last) in spans.items():
            splits.append(
                Split(
                    test=between(whole, first, last),
                    start=start,
                    devices=tested,
                    teach=between(teachers, *teaching[name]),
                )
            )
    return splits


def pets_wide(seed: int, points: int = POINTS[0], every: float = 1.0, radio: RadioParameters = RADIO) -> list[Split]:
    """Return the whole clip for each half of the people, taught by the others' phones over the whole clip."""
    [split] = pets_whole(seed, points, every, radio)
    devices = list(split.test.scans)
    return [
        Split(split.test, ORIGIN, tested, only_phones(split.test, set(devices) - set(tested)))
        for tested in (devices[group::GROUPS] for group in range(GROUPS))
    ]


def run(options: Options, progress: Progress) -> Figures:
    """Score the shipped tracker and plainer methods."""
    cases = Case.all(pets_whole, pets_folds)
    cases |= {"new_halves": Case(pets_folds), "warm_wide": Case(pets_wide, warm=True)}
    figures = measure(cases, options, progress)
    draw_curves(figures, "PETS 2009 S2.L1, phones on all 19 people", options.picture)
    if options.out is not None:  # frames of the clip are not shipped
        [whole] = pets_whole(options.seed)
        title = f"shipped tracker, live, phone seed {options.seed}"
        draw_overlays(whole.test, run_fusion(whole.test), list(OVERLAYS), title, options.out / "pets-phones-frames.png")
    return figures


EXPERIMENT = Experiment(
    name="pets-phones",
    question="How well are phones found among the people of a real clip, when all nineteen carry one?",
    kind="recording",
    scenario="pets09-s2l1",
    seed=100,
    run=run,
    arguments=add_options,
    at_least={
        "idf1_live_new": 0.85,
        "idf1_live_warm": 0.90,
        "idf1_5s_new": 0.91,
        "idf1_5s_warm": 0.94,
        "precision_5s_new": 0.82,
        "precision_5s_warm": 0.88,
    },
    picture="F1 of located trajectories against access points and against the time between scans",
    made=f"""PETS 2009 S2.L1: the public ACF detections, every one of the 19 people carries a phone, six access points
around the crossing.

{EMULATED}

{SCORED}

`new`: nothing is known beforehand, the whole clip. `warm`: constants and a shadowing map were learned without truth,
from the tracker's own tracks and names, by **other** people's phones in **another** time: half of the people in one
half of the clip teach, the other half of the people are scored in the other half of the clip, ten seconds apart; four
such splits make a whole, about 50 seconds of nine or ten phones teach each. `new_halves` are the same runs, untaught:
what `warm` is to be compared with. `warm_wide` is taught by the other half of the phones over the whole clip. Credit:
PETS 2009, University of Reading; detections and labels of MOTChallenge 3D 2015 (none is shipped).""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
