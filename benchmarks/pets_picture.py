"""What the real run looks like: truth and tracks on the plan, and when each phone was located."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from benchmarks.pets_run import PetsRun
from benchmarks.pets_truth import FRAMES_PER_S, PetsTruth

__all__ = ["draw"]


def draw(run: PetsRun, truth: PetsTruth, path: Path) -> None:
    """Write the figure as PNG."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (plan, timeline) = plt.subplots(1, 2, figsize=(13, 5.5), width_ratios=(1, 1.15))
    seen = truth.in_view
    for person in np.unique(truth.person):
        mine = seen & (truth.person == person)
        plan.plot(*truth.position[mine].T, color="0.8", linewidth=3, zorder=1)
    tracks: dict[int, list[tuple[float, float]]] = {}
    for frame in run.frames:
        for track, x, y in zip(frame.track, frame.x, frame.y, strict=True):
            tracks.setdefault(track, []).append((x, y))
    for places in tracks.values():
        plan.plot(*np.array(places).T, linewidth=0.9, zorder=2)
    plan.set(title=f"truth (grey) and {len(tracks)} tracks", xlabel="x, m", ylabel="y, m", aspect="equal")

    for row, (person, device) in enumerate(sorted(run.carriers.items())):
        marks: dict[str, list[float]] = {"in view": [], "within 1 m": [], "wrong place": []}
        for sample in run.samples:
            elapsed = sample.t - run.origin
            place = truth.at(person, elapsed)
            if place is None:
                continue
            given = sample.positions.get(device)
            near = given is not None and np.hypot(given[0] - place[0], given[1] - place[1]) <= 1.0
            marks["within 1 m" if near else "wrong place" if given else "in view"].append(elapsed)
        for name, color in (("in view", "0.8"), ("within 1 m", "tab:green"), ("wrong place", "tab:red")):
            label = {"in view": "not located", "wrong place": "farther than 1 m"}.get(name, name) if row == 0 else None
            timeline.plot(marks[name], [row] * len(marks[name]), "|", color=color, markersize=14, label=label)
    timeline.set(
        title="where the API places each phone while in view",
        xlabel=f"seconds into the clip ({FRAMES_PER_S:g} frames/s)",
        yticks=range(len(run.carriers)),
        yticklabels=[f"person {person}" for person in sorted(run.carriers)],
        ylim=(-0.6, len(run.carriers) - 0.4),
    )
    timeline.legend(loc="upper center", ncols=3, bbox_to_anchor=(0.5, -0.12), frameon=False)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)
