"""From runs to curves: every run is a point of the right curve, and what the study is compared with exists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.robustness import EXPERIMENT, Cell, Measured, against_vision, cells, contact_curve, curves_of
from benchmarks.robustness_picture import draw_curves


def measured(*errors: float, objects: float = 3.5, seconds: float = 0.004) -> Measured:
    return Measured(np.array(errors), np.full(len(errors), objects), seconds)


def test_an_unperturbed_run_is_a_point_of_every_curve() -> None:
    figures = curves_of([(Cell("plain", 0, "rbmcda"), measured(1.0, 2.0))])
    names = ("occlusion_0", "heading_0", "objects_3", "aps_6")
    assert [figures[f"{name}_rbmcda"] for name in names] == [1.5] * 4
    assert figures["particles_100_rbmcda"] == 1.5
    assert figures["ms_particles_100"] == pytest.approx(4.0)


def test_names_are_of_no_use_to_who_gives_none() -> None:
    figures = curves_of([(Cell("plain", 0, "rbmcda-vision"), measured(1.0))])
    assert figures["occlusion_0_rbmcda-vision"] == 1.0
    assert "aps_6_rbmcda-vision" not in figures


def test_without_occlusion_methods_are_compared_with_vision() -> None:
    runs = [(Cell("plain", 0, name), measured(error)) for name, error in (("rbmcda", 2.0), ("rbmcda-vision", 1.6))]
    found = against_vision(curves_of(runs))
    assert found["rbmcda_of_vision"] == pytest.approx(1.25)
    assert found["evidence_of_vision"] is None
    assert "rbmcda_of_vision" in EXPERIMENT.missed(found)


def test_placements_are_one_point() -> None:
    runs = [
        (Cell("occlusion", 20, "evidence", placement), measured(*errors))
        for placement, errors in enumerate([(1.0, 1.0), (4.0,)])
    ]
    assert curves_of(runs)["occlusion_20_evidence"] == pytest.approx(2.0)


def test_minutes_are_sorted_by_how_many_were_seen_in_them() -> None:
    runs = [
        (Cell("objects", 0, "evidence"), measured(1.0, objects=6.4)),
        (Cell("objects", 3, "evidence"), measured(3.0, objects=14.9)),
        (Cell("objects", 3, "evidence"), measured(9.0, objects=40.0)),
    ]
    figures = curves_of(runs)
    assert figures["objects_5_evidence"] == 1.0
    assert figures["objects_13_evidence"] == 3.0
    assert figures["objects_7_evidence"] is None


def test_what_the_study_is_compared_with_is_measured_and_drawn(tmp_path: Path) -> None:
    figures = curves_of([(cell, measured(1.0)) for cell in cells()]) | contact_curve(walkers=10)
    figures |= against_vision(figures)
    assert set(EXPERIMENT.studies) | set(EXPERIMENT.at_most) <= set(figures)
    draw_curves(figures, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
