"""How well are phones found on a busy pavement, when a fifth of the people carry one, half of these in company?

Run it with ``atrium bench eth-phones``.
"""

from __future__ import annotations

import sys

from rich.progress import Progress

from benchmarks.eth_recording import eth_carriers, eth_recording
from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.phone_folds import POINTS, Case, Split, add_options, draw_curves, measure
from benchmarks.phones_on_tracks import AROUND, between, phones_on

__all__ = ["EXPERIMENT", "eth_halves", "main"]

LEAD = 10.0
"""Seconds the tested run begins before its scores count; they teach nobody."""


def eth_halves(seed: int, points: int = POINTS[0], every: float = 1.0) -> list[Split]:
    """Return the second half of the recording, taught by the first: other people, other phones."""
    recording = eth_recording(points)
    record = phones_on(recording, eth_carriers(seed), seed, every=every)
    begin, half, end = recording.t[0], recording.t[len(recording.t) // 2], recording.t[-1]
    return [
        Split(
            test=between(record, half - LEAD, end + AROUND + 1.0),
            start=float(half),
            teach=between(record, begin - AROUND - 1.0, half - LEAD),
        )
    ]


def run(options: Options, progress: Progress) -> Figures:
    """Score the shipped tracker and plainer methods."""
    figures = measure(Case.all(eth_halves, eth_halves), options, progress)
    draw_curves(figures, "eth-walking, phones on a fifth of the people", options.picture)
    return figures


EXPERIMENT = Experiment(
    name="eth-phones",
    question="How well are phones found on a busy pavement, when a fifth of the people carry one?",
    kind="recording",
    scenario="seq-eth",
    seed=100,
    run=run,
    arguments=add_options,
    picture="F1 of located trajectories against access points and against the time between scans",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
