"""What is counted of detectors on drawn video, and that only one of two adopts what was measured."""

import numpy as np
import pytest
from rich.progress import Progress

from benchmarks import person_sizes
from benchmarks.person_sizes import CAMERA, OFF, Tally, measure
from services.camera.detector import Detections
from services.camera.foreground import ForegroundDetector


def found_at(*places: tuple[float, float]) -> Detections:
    feet = CAMERA.to_image(np.column_stack([np.array(places), np.zeros(len(places))]))
    return Detections(feet, np.zeros((len(places), 4)), np.ones(len(places)))


def test_who_is_found_missed_or_invented_is_counted_once() -> None:
    tally = Tally()
    people = np.array([[5.0, 8.0], [6.0, 8.0], [8.0, 9.0]])
    tally.count(found_at((5.3, 8.0), (6.0, 8.4), (6.1, 8.0), (3.0, 12.0)), people)
    assert (tally.hits, tally.misses, tally.false) == (2, 1, 2)
    figures = tally.figures("x")
    assert figures["recall_x"] == pytest.approx(2 / 3)
    assert figures["precision_x"] == 0.5
    assert figures["rmse_m_x"] == pytest.approx(np.sqrt((0.3**2 + 0.1**2) / 2), abs=0.01)
    tally.count(Detections.none(), people)
    assert (tally.hits, tally.misses, tally.false) == (2, 4, 2)
    assert set(Tally().figures("x").values()) == {None}


def test_one_of_two_detectors_adopts_what_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ForegroundDetector, "learned_sizes", {"height_scale": 1.25, "width_scale": 0.9})
    monkeypatch.setattr(person_sizes, "RATE", 1.0)
    with Progress(disable=True) as progress:
        figures = measure("museum", 11, progress, taught=6.0, scored=4.0)
    assert 1.5 < (figures["height_m"] or 0.0) < 2.0
    for name, off in OFF.items():
        assert figures[f"height_m_learned_{name}"] == pytest.approx((figures["height_m"] or 0.0) * off * 1.25)
        assert figures[f"width_scale_{name}"] == 0.9
        assert figures[f"recall_configured_{name}"]
        before, after = (
            [figures[f"{what}_{stage}_{name}"] for what in ("recall", "precision", "rmse_m")]
            for stage in ("configured", "learned")
        )
        assert before != after
