"""The gate of dead reckoning: what is quick to measure again, on real recordings, may not get worse than stored."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.dead_reckoning import BARS, EXPERIMENT, mall
from benchmarks.result import read_figures
from benchmarks.step_recordings import detect, read_recordings
from benchmarks.step_table import figures_of, tally
from services.gateway.steps.gated_peaks import GatedPeaks
from shared.walking.stride import PER_BOUNCE, PER_CADENCE, USUAL_LENGTH

MISSED = {"step_worst_purse", "false_steps_per_s", "heading_error_deg"}
"""Bars missed with constants chosen without the person or trace: two of three people hardly handle their phones, and
which of many equally good compass constants a mall's other traces prefer is chance. Those that ship keep them."""
LOWER_IS_BETTER = (
    "leg_error",
    "shipped_heading_error_deg",
    "shipped_heading_error_p90_deg",
    "shipped_turn_error_deg",
    "shipped_end_drift",
)


@pytest.fixture(scope="module")
def legs(data_folder: Path) -> dict[str, float]:
    return mall(data_folder, rivals=False).figures


@pytest.mark.parametrize("figure", LOWER_IS_BETTER)
def test_what_the_malls_legs_say_has_not_got_worse(legs: dict[str, float], figure: str) -> None:
    stored = read_figures("dead-reckoning")[figure]
    share = 0.0 if figure.endswith("_deg") else 0.005
    assert legs[figure] <= max(1.02 * stored, stored + share), f"{figure} rose from {stored} to {legs[figure]}"


def test_what_is_said_of_the_errors_is_true(legs: dict[str, float]) -> None:
    assert legs["end_nees_low"] <= legs["end_nees"] <= legs["end_nees_high"]
    for figure in (f"{name}_within_{sigmas}_sigma" for name in ("leg", "heading") for sigmas in (1, 2)):
        assert EXPERIMENT.at_least[figure] <= legs[figure] <= EXPERIMENT.at_most[figure], figure


def test_the_stride_that_ships_is_the_one_that_the_traces_give(legs: dict[str, float]) -> None:
    assert legs["stride_level"] == pytest.approx(USUAL_LENGTH, abs=0.01)
    assert legs["stride_per_cadence"] == pytest.approx(PER_CADENCE, abs=0.03)
    assert legs["stride_per_bounce"] == pytest.approx(PER_BOUNCE, abs=0.03)


def test_the_constants_that_ship_keep_the_bars_on_the_people_they_were_chosen_with(data_folder: Path) -> None:
    """Held out, two bars are missed (``MISSED``); so this says only that the service counts no worse than it did."""
    recordings = read_recordings()
    figures = figures_of(tally(detect(GatedPeaks(), recordings), recordings))
    missed = [name for name, value in figures.items() if value > EXPERIMENT.at_most.get(name, np.inf)]
    missed += [name for name, value in figures.items() if value < EXPERIMENT.at_least.get(name, -np.inf)]
    assert not missed, {name: figures[name] for name in missed}


def test_every_figure_with_a_bar_is_stored_and_no_bar_is_missed_but_those_told_of() -> None:
    stored = read_figures("dead-reckoning")
    assert set(EXPERIMENT.missed(stored)) <= MISSED
    assert np.isfinite([stored[name] for name in BARS]).all()
