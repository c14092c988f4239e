"""Draws what was learned: the ladder, the learning rate, track quality, recovery and the gate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from benchmarks.learning_figures import judged_tracks, stage_errors
from benchmarks.learning_gate import Bout, draw_gate
from benchmarks.learning_ladder import RATES, STAGES, TRACKERS, Climb
from benchmarks.learning_recovery import Recovery, draw_recovery
from benchmarks.position_error import error_cdf

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["draw_learning"]

NAMES = {"none": "as found", "detector": "+ detector", "radio": "+ radio", "all": "+ stride"}
STUDY = {
    "construction-1": {"none": [(1.0, 0.7), (1.4, 0.9)], "detector": [(0.7, 0.7), (1.2, 0.9)], "radio": [(1.0, 0.9)]},
    "construction-2": {"none": [(1.6, 0.9)], "detector": [(0.8, 0.7), (1.18, 0.9)], "radio": [(1.0, 0.9)]},
}
"""Errors and shares [ravel-thesis §11.4]."""


def draw_learning(
    trials: Mapping[str, Sequence[Climb]], bouts: Sequence[Bout], recoveries: Sequence[Recovery], picture: Path
) -> None:
    """Draw a row for each trial (a distribution for each tracker, the curve of rates), and one for the rest."""
    figure, axes = plt.subplots(len(trials) + 1, 3, figsize=(16.0, 4.2 * (len(trials) + 1)), squeeze=False)
    for row, (trial, areas) in zip(axes, trials.items(), strict=False):
        for axis, tracker in zip(row, TRACKERS, strict=False):
            _draw_errors(axis, trial, areas, tracker)
        _draw_rates(row[2], trial, areas)
    _draw_quality(axes[-1][0], [area for areas in trials.values() for area in areas])
    draw_recovery(axes[-1][1], recoveries)
    draw_gate(axes[-1][2], bouts)
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
    axis.semilogx(RATES, np.mean([curve.score for curve in curves], axis=0), "o-", color="C0")
    axis.set(title=f"{trial}: learning rate (bars: chosen)", xlabel="per second")
    axis.set_ylabel("score of the tracks, nats per second", color="C0")
    for curve in curves:
        axis.axvline(RATES[curve.chosen], color="C0", alpha=0.15, linewidth=3)
    other = axis.twinx()
    other.semilogx(RATES, np.mean([curve.rmse for curve in curves], axis=0), "s--", color="C3")
    other.set_ylabel("true RMSE, m", color="C3")


def _draw_quality(axis: Axes, areas: Sequence[Climb]) -> None:
    quality, seconds, rmse, good = judged_tracks(areas).T
    for name, which in (("may teach", good > 0.0), ("refused", good == 0.0)):
        axis.semilogy((quality / seconds)[which], rmse[which], ".", label=name)
    axis.legend(fontsize="small")
    axis.set(title="tracks of a minute", xlabel="quality, nats per second", ylabel="true RMSE, m")
    axis.grid(visible=True, alpha=0.25)
