"""The anonymous tracker on the public detections may not get worse than stored; its speed is not judged here."""

from pathlib import Path

import pytest

from benchmarks.pets_detections import accuracy, load_detections, track
from benchmarks.pets_truth import PetsTruth
from benchmarks.result import read_figures
from services.cli.demo import find_site
from services.fusion.area_view import AreaView
from shared.site import load_site


@pytest.fixture(scope="module")
def figures(data_folder: Path) -> dict[str, float]:
    site = load_site(find_site("pets09"))
    tracks, _ = track(AreaView.of(site, site.areas[0].id), load_detections(site, data_folder))
    return accuracy(tracks, PetsTruth.load(data_folder))


@pytest.mark.parametrize("figure", ["mota", "idf1", "hota", "precision", "recall"])
def test_share_has_not_fallen(figures: dict[str, float], figure: str) -> None:
    stored = read_figures("pets-detections")[figure]
    assert figures[figure] >= stored - 0.005, f"{figure} fell from {stored} to {figures[figure]}"


def test_position_error_has_not_risen(figures: dict[str, float]) -> None:
    assert figures["rmse_m"] <= 1.02 * read_figures("pets-detections")["rmse_m"]


def test_identities_are_not_switched_more_often(figures: dict[str, float]) -> None:
    assert figures["switches"] <= read_figures("pets-detections")["switches"]
