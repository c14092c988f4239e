"""Draws the ladder: errors stage by stage, and the learning rate's score beside its true error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmarks.learning_figures import stage_errors
from benchmarks.learning_ladder import RATES, STAGES, TRACKERS, Climb
from benchmarks.position_error import error_cdf

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["draw_ladder"]

Array = NDArray[np.float64]

NAMES = {"none": "as found", "detector": "+ detector", "radio": "+ radio", "all": "+ stride"}
STUDY = {
    "construction-1": {"none": [(1.0, 0.7), (1.4, 0.9)], "detector": [(0.7, 0.7), (1.2, 0.9)], "radio": [(1.0, 0.9)]},
    "construction-2": {"none": [(1.6, 0.9)], "detector": [(0.8, 0.7), (1.18, 0.9)], "radio": [(1.0, 0.9)]},
}
"""Errors and shares [ravel-thesis §11.4]."""


def draw_ladder(trials: Mapping[str, Sequence[Climb]], picture: Path) -> None:
    """Draw a row for each trial: a distribution for each tracker, then the curve of rates."""
    figure, axes = plt.subplots(len(trials), len(TRACKERS) + 1, figsize=(15.0, 4.0 * len(trials)), squeeze=False)
    for row, (trial, areas) in zip(axes, trials.items(), strict=True):
        for axis, tracker in zip(row, TRACKERS, strict=False):
            for stage in STAGES:
                [line] = axis.plot(*error_cdf(stage_errors(areas, tracker, stage)), label=NAMES[stage])
                for found in STUDY.get(trial, {}).get(stage, ()):
                    axis.plot(*found, "o", color=line.get_color(), markeredgecolor="black", zorder=3)
            axis.set(title=f"{trial}, {tracker}", xlabel="RMSE in a minute, m", xlim=(0.0, 5.0), ylim=(0.0, 1.0))
            axis.grid(visible=True, alpha=0.25)
            axis.legend(loc="lower right")
        row[0].set_ylabel("share of people's minutes")
        curves = [curve for area in areas for curve in area.curves]
        _draw_rates(row[-1], trial, np.array([c.score for c in curves]), np.array([c.rmse for c in curves]))
        for curve in curves:
            row[-1].axvline(RATES[curve.chosen], color="C0", alpha=0.15, linewidth=3)
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def _draw_rates(axis: Axes, trial: str, score: Array, rmse: Array) -> None:
    axis.semilogx(RATES, score.mean(axis=0), "o-", color="C0")
    axis.set(title=f"{trial}: learning rate (bars: chosen)", xlabel="per second")
    axis.set_ylabel("score, nats per withheld reading", color="C0")
    other = axis.twinx()
    other.semilogx(RATES, rmse.mean(axis=0), "s--", color="C3")
    other.set_ylabel("true RMSE, m", color="C3")
