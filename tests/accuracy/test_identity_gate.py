"""No tracker may find phones worse than stored: short worlds of the twin, and emulated phones on a real clip."""

import pytest
from identity_gate import GATED, measure, read, worse


@pytest.mark.parametrize("gate", GATED)
def test_a_tracker_finds_phones_no_worse_than_stored(gate: str, data_folder: object) -> None:
    stored = read()
    assert gate in stored, f"{gate}: never stored; run PYTHONPATH=. python tests/accuracy/identity_gate.py"
    assert not worse(measure(gate), stored[gate])


def test_what_is_stored_is_still_measured() -> None:
    assert sorted(read()) == sorted(GATED)


def test_the_gate_closes_by_half_a_hundredth_and_by_two_in_a_hundred_metres() -> None:
    stored = {"idf1_live": 0.8, "error_p50_live_m": 0.5}
    assert worse({"idf1_live": 0.7955, "error_p50_live_m": 0.509}, stored) == []
    assert worse({"idf1_live": 0.79, "error_p50_live_m": 0.52}, stored) == [
        "error_p50_live_m rose from 0.5 to 0.52",
        "idf1_live fell from 0.8 to 0.79",
    ]
    assert worse({"idf1_live": 0.9}, stored) == ["error_p50_live_m: stored or measured only once"]
