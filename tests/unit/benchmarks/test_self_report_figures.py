"""What areas tell of themselves against what was true."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.self_report import Told, draw_told, named_errors, told_figures
from benchmarks.world_record import Truth
from shared.messages import TrackFrame

AREAS = [
    Told("one", np.array([1.0, 0.5, np.nan]), np.array([1.1, 0.5, 3.0])),
    Told("two", np.array([2.0, 0.2, 4.0]), np.array([1.0, 0.25, 3.9])),
]


def test_what_is_not_told_is_neither_right_nor_wrong() -> None:
    figures = told_figures(AREAS)
    assert (figures["rms_told"], figures["rms_within"]) == (1.0, 0.5)
    assert (figures["p90_told"], figures["p90_within"]) == (0.5, 1.0)
    assert figures["rms_worst"] == pytest.approx(1.0)
    assert told_figures([AREAS[0]])["p90_within"] is None


def test_only_named_positions_in_view_are_held_against_the_truth() -> None:
    truth = Truth(
        np.arange(3.0),
        ["a", None],
        ["d-1", None],
        np.zeros((3, 2, 2)) + np.arange(3.0)[:, None, None],
        np.ones((3, 2), bool),
    )
    frame = TrackFrame(
        t=1.5, area="hall", chunk=1, tracker="none", track=[1, 2, 3], floor=["f"] * 3, x=[1.5, 9.0, 9.0],
        y=[3.5, 9.0, 9.0], covariance=[(1.0, 0.0, 1.0)] * 3, vx=[0.0] * 3, vy=[0.0] * 3,
        state=["confirmed", "confirmed", "unseen"],
        device=["d-1", None, "d-1"], probability=[0.9] * 3, runner_up=[None] * 3, runner_up_probability=[0.0] * 3,
        former=[[]] * 3, sources=[[]] * 3, quality=[1.0] * 3,
    )  # fmt: skip
    assert named_errors([frame], truth) == pytest.approx([2.0])


def test_told_is_drawn(tmp_path: Path) -> None:
    draw_told(AREAS, tmp_path / "told.png")
    assert (tmp_path / "told.png").stat().st_size > 5000
