"""Draws the curves of ``benchmarks.robustness``, what the study says of them dotted."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["draw_curves"]

PANELS = {
    "occlusion": "share of the view occluded, %",
    "heading": "heading error, degrees",
    "objects": "detections per frame",
    "aps": "access points",
    "particles": "particles",
    "contact": "contact strength, N/m",
    "msparticles": "particles",
    "mstargets": "phones",
}
STUDY: dict[str, tuple[list[float], list[float]]] = {
    "objects": ([3.5, 14.0], [0.7, 1.9]),
    "heading": ([0.0, 30.0], [1.0, 1.0]),
    "aps": ([4.0, 12.0], [1.0, 1.0]),
    "particles": ([50.0, 300.0], [1.0, 1.0]),
    "contact": ([0.0], [0.6]),
    "msparticles": ([10, 30, 50, 100, 150, 300], [130, 330, 520, 930, 1440, 2840]),
}
"""[ravel-thesis §11.3]; where it only says "sub-metre", the metre."""
YLABELS = {"contact": "RMSE of a prediction, m"}
COLOURS = {"evidence": "C0", "rbmcda": "C1", "rbmcda-vision": "C2", "onestep": "C3", "substeps": "C4"}


def draw_curves(figures: Mapping[str, float | None], picture: Path) -> None:
    """Draw a panel for each curve.

    Args:
        figures: ``CURVE_VALUE_METHOD`` in metres, ``ms_CURVE_VALUE`` in milliseconds.
        picture: where to.
    """
    curves: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    for name, value in figures.items():
        found = re.fullmatch(r"(ms)_(\w+)_(\d+)|([a-z]+)_(\d+)_([\w-]+)", name)
        if found is None or value is None:
            continue
        if found[1]:
            curves[f"ms{found[2]}"]["rbmcda"].append((float(found[3]), value))
        else:
            curves[found[4]][found[6]].append((float(found[5]), value))
    figure, axes = plt.subplots(2, 4, figsize=(17.0, 8.0))
    for axis, (curve, label) in zip(axes.ravel(), PANELS.items(), strict=True):
        for method, points in curves[curve].items():
            axis.plot(
                *zip(*sorted(points), strict=True), marker="o", markersize=3, label=method, color=COLOURS.get(method)
            )
        if curve in STUDY:
            axis.plot(*STUDY[curve], "k:", marker="s", markersize=4, label="the study")
        timed = curve.startswith("ms")
        axis.set(xlabel=label, ylabel=YLABELS.get(curve, "ms of a cycle" if timed else "mean RMSE in a minute, m"))
        if curve == "msparticles":
            axis.set_yscale("log")
        else:
            axis.set_ylim(bottom=0.0)
        axis.grid(visible=True, alpha=0.25)
        if axis.lines:
            axis.legend(fontsize=8)
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=90)
    plt.close(figure)
