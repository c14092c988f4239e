"""What does dead reckoning of the mall's traces look like? Panels of the picture of ``atrium bench dead-reckoning``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import imread
from numpy.typing import NDArray

from benchmarks.mall_reckoning import Walked, heading_errors, length_errors
from benchmarks.mall_traces import Trace

__all__ = ["draw_headings", "draw_lengths", "draw_plan", "path"]

Array = NDArray[np.float64]

MARGIN = 6.0
"""m of plan around the traces."""


def path(trace: Trace, walked: Walked) -> Array:
    """Return the places after each step between the first way-point and the last, (m + 1, 2) m, from the first on."""
    on = (walked.t > trace.way[0, 0]) & (walked.t <= trace.way[-1, 0])
    stride = walked.length[on, None] * np.column_stack([np.cos(walked.heading[on]), np.sin(walked.heading[on])])
    places: Array = trace.way[0, 1:] + np.concatenate([np.zeros((1, 2)), np.cumsum(stride, axis=0)])
    return places


def draw_plan(axes: Axes, data: Path, traces: Sequence[Trace], walked: Sequence[Walked]) -> None:
    """Draw way-points (black) and what was reckoned (coloured, dotted to where it should have ended) over the plan."""
    folder = data / "indoor-location" / "site1" / "F1"
    size = json.loads((folder / "floor_info.json").read_text())["map_info"]
    image = imread(folder / "floor_image.png")
    axes.imshow(image, extent=(0.0, size["width"], 0.0, size["height"]), alpha=0.4)
    seen = []
    for trace, one in zip(traces, walked, strict=True):
        places = path(trace, one)
        axes.plot(trace.way[:, 1], trace.way[:, 2], "k.-", lw=0.8, ms=3)
        line = axes.plot(*places.T, lw=1.5)[0]
        axes.plot(*np.stack([places[-1], trace.way[-1, 1:]]).T, ":", color=line.get_color())
        seen += [places, trace.way[:, 1:]]
    low, high = np.concatenate(seen).min(axis=0) - MARGIN, np.concatenate(seen).max(axis=0) + MARGIN
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), title="way-points (black), reckoned", xlabel="m")


def draw_lengths(axes: Axes, traces: Sequence[Trace], laws: Mapping[str, Sequence[Walked]]) -> None:
    """Draw which share of the legs is wrong by less, law by law."""
    for name, walked in laws.items():
        errors = [np.abs(length_errors(*pair)) for pair in zip(traces, walked, strict=True)]
        _cumulative(axes, 100.0 * np.concatenate(errors), name)
    axes.set(xlim=(0, 40), xlabel="error of a leg's length, %", ylabel="share of legs", title="lengths, held out")
    axes.legend(frameon=False, fontsize=8)


def draw_headings(axes: Axes, traces: Sequence[Trace], ways: Mapping[str, Sequence[Walked]]) -> None:
    """Draw which share of the long legs is wrong by less, way by way of telling headings."""
    for name, walked in ways.items():
        errors = [np.abs(heading_errors(*pair)) for pair in zip(traces, walked, strict=True)]
        _cumulative(axes, np.degrees(np.concatenate(errors)), name)
    axes.set(xlim=(0, 40), xlabel="error of a leg's heading, degrees", ylabel="share of legs", title="headings")
    axes.legend(frameon=False, fontsize=8)


def _cumulative(axes: Axes, errors: Array, name: str) -> None:
    kept = np.sort(errors[np.isfinite(errors)])
    axes.plot(kept, np.arange(1, len(kept) + 1) / len(kept), label=name.replace("_", " "))
