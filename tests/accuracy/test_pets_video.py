"""The real run meets its bars and does not get worse than what is stored."""

from pathlib import Path

import pytest

from benchmarks.pets_run import PetsRun, run_clip
from benchmarks.pets_truth import FRAMES, PetsTruth
from benchmarks.pets_video import BARS, figures_of
from benchmarks.result import read_figures

pytestmark = pytest.mark.alone

# The tight gate is test_pets_offline.py. Live, time stamps differ in their last bits from run to run, and with them a
# decision or two; identity rides on wall-clock timing as well. The tolerances are the spread of several runs.
TOLERANCE = {"mota": 0.01, "idf1": 0.03, "precision": 0.01, "recall": 0.01, "located_within_1m": 0.08}


@pytest.fixture(scope="module")
def run(data_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> PetsRun:
    return run_clip(tmp_path_factory.mktemp("pets"))


@pytest.fixture(scope="module")
def figures(run: PetsRun, data_folder: Path) -> dict[str, float | None]:
    return figures_of(run, PetsTruth.load(data_folder))[0]


def test_every_frame_of_the_clip_went_through(run: PetsRun) -> None:
    assert len(run.detections) == FRAMES
    assert len(run.frames) == FRAMES
    assert run.restarts == 0
    assert set(run.statuses.values()) == {0}
    assert run.counts["dropped"] == 0


@pytest.mark.parametrize("figure", sorted(BARS))
def test_bar(figures: dict[str, float | None], figure: str) -> None:
    assert (figures[figure] or 0.0) >= BARS[figure]


@pytest.mark.parametrize("figure", sorted(TOLERANCE))
def test_not_worse_than_stored(figures: dict[str, float | None], figure: str) -> None:
    stored = read_figures("pets-video")[figure]
    assert (figures[figure] or 0.0) >= stored - TOLERANCE[figure], f"{figure} fell from {stored} to {figures[figure]}"


def test_latency_is_measured(figures: dict[str, float | None], run: PetsRun) -> None:
    assert len(run.latency) > 0.95 * FRAMES
    assert 0.0 < (figures["latency_p50_ms"] or 0.0) <= (figures["latency_p99_ms"] or 0.0)
