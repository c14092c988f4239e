"""Draws what was learned: the ladder, the learning rate, and quality of phones' minutes against true error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from benchmarks.learning_figures import quality_minutes, stage_errors
from benchmarks.learning_ladder import RATES, STAGES, TRACKERS, Climb
from benchmarks.position_error import error_cdf
from services.fusion.registry import DEFAULT_TRACKER

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["draw_learning"]

NAMES = {"none": "as found", "detector": "+ detector", "radio": "+ radio", "all": "+ stride"}
STUDY = {
    "construction-1": {"none": [(1.0, 0.7), (1.4, 0.9)], "detector": [(0.7, 0.7), (1.2, 0.9)], "radio": [(1.0, 0.9)]},
    "construction-2": {"none": [(1.6, 0.9)], "detector": [(0.8, 0.7), (1.18, 0.9)], "radio": [(1.0, 0.9)]},
}
"""Errors and shares [ravel-thesis §11.4]."""


def draw_learning(trials: Mapping[str, Sequence[Climb]], picture: Path) -> None:
    """Draw a row for each trial: a distribution for each tracker, the curve of rates, quality against true error."""
    figure, axes = plt.subplots(len(trials), 4, figsize=(20.0, 4.4 * len(trials)), squeeze=False)
    for row, (trial, areas) in zip(axes, trials.items(), strict=True):
        for axis, tracker in zip(row, TRACKERS, strict=False):
            _draw_errors(axis, trial, areas, tracker)
        _draw_rates(row[2], trial, areas)
        _draw_quality(row[3], trial, areas)
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def _draw_errors(axis: Axes, trial: str, areas: Sequence[Climb], tracker: str) -> None:
    for stage in STAGES:
        [line] = axis.plot(*error_cdf(stage_errors(areas, tracker, stage)), label=NAMES[stage])
        for found in STUDY.get(trial, {}).get(stage, ()):
            axis.plot(*found, "o", color=line.get_color(), markeredgecolor="black", zorder=3)
    axis.set(title=f"{trial}, {tracker}", xlabel="RMSE in a minute, m", xlim=(0.0, 5.0), ylim=(0.0, 1.0))
    axis.set_ylabel("share of people's minutes")
    axis.grid(visible=True, alpha=0.25)
    axis.legend(loc="lower right")


def _draw_rates(axis: Axes, trial: str, areas: Sequence[Climb]) -> None:
    curves = [curve for area in areas for curve in area.curves]
    # Areas with more people score more: each curve as a share of its own top.
    score = np.mean([curve.score / curve.score.max() for curve in curves], axis=0)
    axis.semilogx(RATES, score, "o-", color="C0", label="score of the tracks, share of the best")
    chosen = np.bincount([curve.chosen for curve in curves], minlength=len(RATES)) / len(curves)
    axis.bar(RATES, chosen, width=0.25 * np.array(RATES), color="C0", alpha=0.25, label="share of splits that choose")
    axis.set(title=f"{trial}: learning rate", xlabel="per second", ylim=(0.0, 1.05))
    axis.set_ylabel("share", color="C0")
    other = axis.twinx()
    other.semilogx(RATES, np.mean([curve.rmse for curve in curves], axis=0), "s--", color="C3", label="true RMSE")
    other.set_ylabel("true RMSE (median person's minute), m", color="C3")
    other.set_ylim(0.0, None)
    axis.legend(loc="lower left", fontsize="small")


def _draw_quality(axis: Axes, trial: str, areas: Sequence[Climb]) -> None:
    quality, seconds, rmse, named = quality_minutes(areas, DEFAULT_TRACKER).T
    for name, which in (("on a track throughout", named == 1.0), ("out of view for some of it", named < 1.0)):
        axis.semilogy((quality / seconds)[which], rmse[which], ".", label=f"{name} ({which.sum()})")
    axis.legend(fontsize="small")
    axis.set(title=f"{trial}: each phone in each minute", xlabel="quality, nats per second", ylabel="true RMSE, m")
    axis.set_ylim(0.05, 20.0)
    axis.yaxis.set_major_formatter("{x:g}")
    axis.grid(visible=True, alpha=0.25)
