"""The benchmark of history measures right answers: on a small museum it finds what it stored."""

from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.history import EXPERIMENT, walks
from benchmarks.world_run import load


def test_walks_stay_on_the_floor_at_a_walk() -> None:
    _, site = load("museum")
    blocks = walks(site, 2, 30, np.random.default_rng(0))
    where = blocks[:, :, 1:3].transpose(0, 1, 3, 2).reshape(2, -1, 2) / 100.0
    left, bottom, right, top = site.floors[0].plan().outline.bounds
    assert (where > [left - 0.5, bottom - 0.5]).all()
    assert (where < [right + 0.5, top + 0.5]).all()
    speeds = np.linalg.norm(np.diff(where, axis=1), axis=2)
    assert 0.1 < speeds.mean() < 1.4
    assert speeds.max() < 2.0


def test_a_small_month_is_stored_and_asked(tmp_path: Path) -> None:
    options = EXPERIMENT.options(["--days", "2", "--hours", "1", "--people", "12", "--out", str(tmp_path)])
    with Progress(disable=True) as progress:
        figures = EXPERIMENT.run(options, progress)
    assert figures["positions"] == 2 * 2 * 3600 * 12
    assert all(value is not None and value > 0.0 for value in figures.values())
