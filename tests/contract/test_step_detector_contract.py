"""What every step detector must keep to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.reckoning.resampling import RATE
from services.gateway.steps.gated_peaks import DETECTORS, StepDetector

pytestmark = pytest.mark.parametrize("name", sorted(DETECTORS))


def walk(cadence: float, seconds: float = 20.0, rest: float = 5.0, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Rest, walk, rest; the two feet differ a little."""
    t = np.arange(0, seconds + 2 * rest, 1 / RATE) + 1e9
    phase = cadence * (t - t[0] - rest)
    wave = 2.5 * np.cos(2 * np.pi * phase) + 0.5 * np.cos(np.pi * phase) + 0.6 * np.cos(4 * np.pi * phase + 0.5)
    walking = (phase > 0) & (t - t[0] < rest + seconds)
    return t, 9.81 + wave * walking + np.random.default_rng(3).normal(0, noise, len(t))


def push_in_parts(detector: StepDetector, t: np.ndarray, norm: np.ndarray, cuts: list[int]) -> np.ndarray:
    parts = zip(np.split(t, cuts), np.split(norm, cuts), strict=True)
    return np.concatenate([detector.push(part_t, part_norm) for part_t, part_norm in parts])


@pytest.mark.parametrize("cadence", [1.5, 1.8, 2.1])
def test_counts_a_steady_walk_to_within_two_steps(name: str, cadence: float) -> None:
    t, norm = walk(cadence)
    steps = DETECTORS[name]().push(t, norm)
    assert abs(len(steps) - cadence * 20.0) <= 2
    assert np.all(np.diff(steps) > 0.2)


@settings(max_examples=25, deadline=None)
@given(cuts=st.lists(st.integers(0, 1500), max_size=12).map(sorted))
def test_does_not_depend_on_how_the_stream_is_cut(name: str, cuts: list[int]) -> None:
    t, norm = walk(1.9)
    whole = DETECTORS[name]().push(t, norm)
    np.testing.assert_allclose(push_in_parts(DETECTORS[name](), t, norm, cuts), whole, atol=1e-6)


def test_a_phone_on_the_table_takes_no_steps(name: str) -> None:
    t, _ = walk(1.9)
    detector = DETECTORS[name]()
    assert len(detector.push(t, 9.81 + np.random.default_rng(5).normal(0, 0.15, len(t)))) == 0
    assert not detector.walking
    assert detector.cadence == 0.0


def test_picking_the_phone_up_is_no_walk(name: str) -> None:
    t = np.arange(0, 10, 1 / RATE)
    norm = 9.81 + 4.0 * np.exp(-(((t - 4.0) / 0.3) ** 2)) - 3.0 * np.exp(-(((t - 4.7) / 0.2) ** 2))
    assert len(DETECTORS[name]().push(t, norm)) == 0


def test_tells_walking_and_cadence_and_stops_within_two_and_a_half_seconds(name: str) -> None:
    t, norm = walk(1.8)
    detector = DETECTORS[name]()
    middle, after = np.searchsorted(t - t[0], [20.0, 28.0])
    detector.push(t[:middle], norm[:middle])
    assert detector.walking
    assert detector.cadence == pytest.approx(1.8, rel=0.08)
    detector.push(t[middle:after], norm[middle:after])
    assert not detector.walking


def test_forgets_when_told(name: str) -> None:
    t, norm = walk(1.8)
    detector = DETECTORS[name]()
    detector.push(t[:700], norm[:700])
    detector.reset()
    assert not detector.walking
    np.testing.assert_allclose(detector.push(t, norm), DETECTORS[name]().push(t, norm), atol=1e-9)
