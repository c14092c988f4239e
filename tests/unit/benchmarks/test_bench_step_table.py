"""Steps counted on real walks: the Oxford step counter recordings (CC BY 4.0), and how they are judged."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.step_recordings import Recording, best_lag, detect, matched_steps, read_recordings
from benchmarks.step_table import Tally, by_person, held_out, tally
from services.gateway.steps.gated_peaks import GatedPeaks


@pytest.fixture(scope="module")
def recordings(data_folder: Path) -> list[Recording]:
    """Two of each position; reading all takes as long as everything else together."""
    names = [
        "Pixel_Jamie_Hard_InHand_1",
        "Samsung_Dario_Hard_InHand_2",
        "Samsung_Carmelo_Hard_FrontPocket_2",
        "Samsung_Dario_Hard_FrontPocket_1",
        "Samsung_Carmelo_Hard_BackPocket_2",
        "Pixel_Jamie_Hard_BackPocket_2",
        "Samsung_Carmelo_Hard_Purse_2",
        "Samsung_Dario_Hard_Purse_1",
    ]
    return read_recordings(data_folder, names)


def test_missed_edges_of_a_foot_are_filled_in(recordings: list[Recording]) -> None:
    (dario,) = (recording for recording in recordings if recording.name == "Samsung_Dario_Hard_FrontPocket_1")
    assert len(dario.steps) == pytest.approx(315, abs=1)  # 144 and 162 edges were recorded
    assert {recording.position for recording in recordings} == {"hand", "front", "back", "purse"}


def test_the_detector_that_ships_counts_real_walks(recordings: list[Recording]) -> None:
    its = tally(detect(GatedPeaks(), recordings), recordings)
    assert np.median(its.count_error()) <= 0.01
    assert its.count_error().max() <= 0.04
    assert its.f1() >= 0.97
    assert its.false_rate() <= 0.15


def test_each_true_step_is_matched_once() -> None:
    true = np.arange(20) * 0.5
    assert matched_steps(true, true) == 20
    assert matched_steps(np.repeat(true, 2), true) == 20
    assert matched_steps(true[::2] + 0.2, true) == 10
    assert matched_steps(true + 0.26, true[:1]) == 0


def test_one_lag_aligns_a_recording() -> None:
    true = np.cumsum(np.random.default_rng(1).uniform(0.4, 0.7, 60))
    lag = best_lag(true - 0.3, true)
    assert lag == pytest.approx(0.3, abs=0.25)
    assert matched_steps(true - 0.3 + lag, true) == 60


def test_nobody_is_judged_by_constants_chosen_on_their_own_walks() -> None:
    """The first variant is perfect for one person and bad for the other; that person must not profit from it."""

    def of(found: list[float]) -> Tally:
        true = np.full(2, 100.0)
        return Tally(np.array(found), true, np.minimum(found, true)[:, None], np.zeros(2), np.ones(2))

    its, choice = held_out([of([100.0, 50.0]), of([90.0, 95.0])], ["ann", "bob"])
    assert choice == {"ann": 1, "bob": 0}
    np.testing.assert_array_equal(its.found, [90.0, 50.0])


def test_a_common_lag_cannot_align_recordings_that_lag_differently() -> None:
    by_lag = np.array([[100.0, 40.0], [40.0, 100.0]])
    its = Tally(np.full(2, 100.0), np.full(2, 100.0), by_lag, np.zeros(2), np.ones(2))
    assert its.f1() == 1.0
    assert its.f1_common_lag() == pytest.approx(0.7)


def test_each_persons_recordings_keep_their_place() -> None:
    def of(found: list[float]) -> Tally:
        return Tally(np.array(found), np.ones(3), np.ones((3, 2)), np.zeros(3), np.ones(3))

    its = by_person({"bob": of([1.0, 2.0, 3.0]), "ann": of([4.0, 5.0, 6.0])}, ["ann", "bob", "ann"])
    np.testing.assert_array_equal(its.found, [4.0, 2.0, 6.0])
