"""What does the fit of the twin's radio look like? Residuals, correlation in space, bodies and misses, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from benchmarks.radio_residuals import Curve

__all__ = ["Look", "draw"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Look:
    """What one recording, or one twin of it, is found to be like.

    Attributes:
        figures: by name.
        curves: by name.
        residual: (n,) dB.
    """

    figures: dict[str, float] = field(default_factory=dict)
    curves: dict[str, Curve] = field(default_factory=dict)
    residual: Array = field(default_factory=lambda: np.empty(0))


PANELS = (
    ("ble", "same walk", "hall, beacon: correlation within a walk", "metres between the places"),
    ("ble", "other walk", "hall, beacon: correlation with other walks", "metres between the places"),
    ("mall", "same way", "mall, Wi-Fi: other walks, same direction", "metres between the places"),
    ("mall", "opposite way", "mall, Wi-Fi: other walks, opposite direction", "metres between the places"),
    ("mall", "body", "mall, Wi-Fi: mean residual by facing, dB", "degrees from the access point"),
    ("mall", "missed", "mall, Wi-Fi: share missed", "mean of the scans before and after, dBm"),
    ("rest", "missed", "hall, beacon at rest: share missed", "mean received power, dBm"),
)


def draw(real: Mapping[str, Look], twins: Mapping[str, Sequence[Look]], path: Path) -> None:
    """Write the figure as PNG: each recording in black, each of its twins in colour."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(3, 3, figsize=(14, 10.5))
    panels = list(axes.flat)
    edges = np.linspace(-24.0, 24.0, 49)
    for panel, (name, title) in zip(panels, (("ble", "hall, beacon"), ("mall", "mall, Wi-Fi")), strict=False):
        for twin in twins[name]:
            panel.hist(twin.residual, edges, density=True, histtype="step", color="tab:orange", linewidth=0.9)
        panel.hist(real[name].residual, edges, density=True, histtype="step", color="black", linewidth=1.6)
        panel.set(title=f"{title}: residuals of path loss", xlabel="dB", yticks=[])
    for panel, (name, quantity, title, label) in zip(panels[2:], PANELS, strict=True):
        for twin in twins[name]:
            curve = twin.curves[quantity]
            panel.plot(curve.x, curve.y, color="tab:orange", linewidth=1.0)
        curve = real[name].curves[quantity]
        panel.plot(curve.x, curve.y, "o-", color="black", markersize=3.5, linewidth=1.4)
        panel.set(title=title, xlabel=label)
        panel.axhline(0.0, color="0.8", linewidth=0.7, zorder=0)
        if "correlation" in title or "walks" in title:
            panel.set(ylim=(-0.15, 1.0))
    panels[0].plot([], [], color="black", label="recorded")
    panels[0].plot([], [], color="tab:orange", label="twin, one line per seed")
    panels[0].legend(frameon=False, loc="upper left", fontsize=8)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    plt.close(figure)
