"""How right lessons are in a short world: what may not get worse, and what it was.

``PYTHONPATH=. python tests/accuracy/learning_gate.py`` measures anew and writes ``learning_gate.json`` beside it;
do that after a change that is known to be for the better, and say in the commit what it did to the figures.
"""

import json
import sys
from functools import cache
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from benchmarks.device_minutes import device_minutes
from benchmarks.fusion_run import run_fusion
from benchmarks.learning_adapter import learned_radio, learned_strides
from benchmarks.learning_checks import radio_residual, stretch_rmse, stride_errors, true_run
from benchmarks.learning_splits import part_of
from benchmarks.learning_stretches import stretches_of
from benchmarks.world_run import load, record_world
from services.fusion.area_view import AreaView

FILE = Path(__file__).with_suffix(".json")
TAUGHT, END = 480.0, 600.0
"""Seconds: what teaches, and when the world ends."""

Figures = dict[str, float]

ROOM: dict[str, float] = {
    "radio_excess_db": 0.05,
    "stride_error": 0.005,
    "good_rmse_p90_m": 0.02,
    "quality_spearman": 0.03,
    "good_share": -0.03,
}
"""By how much each may change for the worse: below nought where more is better."""


@cache
def measure() -> Figures:
    """What the shipped tracker's own tracks teach in eight minutes of the museum, truth only judging."""
    scenario, site = load("museum")
    record = record_world(scenario, site, 13, seconds=END)["hall"]
    found = AreaView.of(site, "hall")
    training, test = part_of(record, 0.0, TAUGHT), part_of(record, TAUGHT, END)
    run = run_fusion(training, view=found)
    judged = list(stretches_of(training, run, found))
    good = [stretch for stretch, verdict in judged if verdict.good]
    doubtful = [stretch for stretch, verdict in judged if verdict.doubtful]
    perfect = [stretch for stretch, _ in stretches_of(training, true_run(training), found)]
    learned, fitted = (
        np.sqrt(np.mean(radio_residual(test, view) ** 2))
        for view in (learned_radio(good, site, found, doubtful), learned_radio(perfect, site, found))
    )
    minutes = device_minutes(training, run)
    known = np.isfinite(minutes.rmse)
    figures = {
        "radio_excess_db": learned - fitted,
        "stride_error": stride_errors(training, learned_strides(good, "hall"))[:, 0].mean(),
        "good_rmse_p90_m": np.nanquantile([stretch_rmse(stretch, record.truth) for stretch in good], 0.9),
        "quality_spearman": spearmanr(minutes.printed[known], minutes.rmse[known]).statistic,
        "good_share": len(good) / len(judged),
    }
    return {name: round(float(value), 4) for name, value in figures.items()}


def worse(now: Figures, stored: Figures) -> list[str]:
    """What got worse than stored by more than it may, in words."""
    told = [f"{name}: stored or measured only once" for name in sorted(now.keys() ^ stored.keys())]
    for name in sorted(now.keys() & stored.keys()):
        room = ROOM[name]
        if (now[name] - stored[name]) * np.sign(room) > abs(room):
            told.append(f"{name} went from {stored[name]} to {now[name]}")
    return told


def read() -> Figures:
    stored: Figures = json.loads(FILE.read_text(encoding="utf-8"))
    return stored


if __name__ == "__main__":
    FILE.write_text(json.dumps(measure(), indent=2) + "\n", encoding="utf-8")
    sys.stdout.write(FILE.read_text(encoding="utf-8"))
