"""The tight gate: detector and tracker on the real clip, reproducible to the bit, may not get worse than stored."""

from pathlib import Path

import pytest

from benchmarks.pets_offline import measure
from benchmarks.result import read_figures

SHARES = ("mota", "idf1", "precision", "recall")


@pytest.fixture(scope="module")
def figures(data_folder: Path) -> dict[str, float | None]:
    return measure(data_folder)


@pytest.mark.parametrize("figure", SHARES)
def test_share_has_not_fallen(figures: dict[str, float | None], figure: str) -> None:
    stored = read_figures("pets-offline")[figure]
    assert (figures[figure] or 0.0) >= stored - 0.005, f"{figure} fell from {stored} to {figures[figure]}"


def test_position_error_has_not_risen(figures: dict[str, float | None]) -> None:
    assert (figures["rmse_m"] or 9.9) <= 1.02 * read_figures("pets-offline")["rmse_m"]


def test_the_second_run_is_the_first(figures: dict[str, float | None], data_folder: Path) -> None:
    again = measure(data_folder)
    assert {name: again[name] for name in again if "per_s" not in name} == {
        name: figures[name] for name in figures if "per_s" not in name
    }
