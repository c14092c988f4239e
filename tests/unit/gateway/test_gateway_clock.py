"""The position of a sample in time hangs on the phone's clock, which may be wrong by a day."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from services.gateway.phones.clock import ClockAligner


def run(offset: float, drift: float, seed: int, seconds: int, echo: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the estimate, one per second, with 20-500 ms each way, and the quickest journey so far."""
    rng = np.random.default_rng(seed)
    aligner, errors, last = ClockAligner(), [], None
    journeys = rng.uniform(0.02, 0.5, (seconds, 2))

    def phone(server: float) -> float:
        return (server - offset) * (1.0 + drift) - drift * 1e9

    for second, (up, down) in enumerate(journeys):
        sent = 1e9 + second
        received = sent + up
        estimate = aligner.observe(phone(sent), received, last)
        errors.append(phone(received) + estimate - received)
        last = (received, phone(received + down)) if echo else None
    return np.abs(errors), np.minimum.accumulate(journeys[:, 0])


@settings(max_examples=30, deadline=None)
@given(
    offset=st.sampled_from([-86_400.0, -30.0, 0.0, 30.0, 86_400.0]),
    drift=st.floats(-1e-4, 1e-4),
    seed=st.integers(0, 2**32 - 1),
)
@example(offset=-86_400.0, drift=0.0, seed=161)  # no journey of the first half minute is quicker than 0.1 s
def test_without_echoes_the_error_is_at_most_the_quickest_journey_and_the_drift(
    offset: float, drift: float, seed: int
) -> None:
    errors, quickest = run(offset, drift, seed, 200, echo=False)
    assert np.all(errors <= quickest + 0.04)


@pytest.mark.parametrize("echo", [False, True])
@pytest.mark.parametrize("offset", [-86_400.0, 0.0, 30.0])
def test_stamps_are_aligned_within_a_tenth_of_a_second_after_half_a_minute(offset: float, echo: bool) -> None:
    drifts = np.linspace(-1e-4, 1e-4, 20)
    errors = np.concatenate([run(offset, drift, seed, 200, echo)[0][30:] for seed, drift in enumerate(drifts)])
    assert np.mean(errors < 0.1) >= 0.95


def test_without_any_batch_nothing_is_added() -> None:
    assert ClockAligner().offset == 0.0


@pytest.mark.parametrize("step", [-3600.0, 3600.0, -86_400.0])
def test_a_clock_that_is_set_anew_is_followed_within_three_batches(step: float) -> None:
    aligner = ClockAligner()
    for second in range(60):
        aligner.observe(1e9 + second, 1e9 + second + 0.05)
    for second in range(60, 63):
        offset = aligner.observe(1e9 + second + step, 1e9 + second + 0.05)
    assert offset == pytest.approx(-step + 0.05, abs=1e-3)


def test_one_delayed_request_does_not_move_the_offset() -> None:
    aligner = ClockAligner()
    aligner.observe(100.0, 100.05)
    assert aligner.observe(101.0, 131.0) == pytest.approx(0.05)


def test_an_echo_from_the_future_is_not_believed() -> None:
    aligner = ClockAligner()
    aligner.observe(100.0, 100.05)
    assert aligner.observe(101.0, 101.05, (500.0, 100.5)) == pytest.approx(0.05)


def test_the_drift_is_found_so_that_an_hour_measured_without_network_is_placed_right() -> None:
    rng, aligner, drift = np.random.default_rng(3), ClockAligner(), 8e-5

    def phone(server: float) -> float:
        return server - 30.0 + drift * (server - 1e9)

    for second in [*range(300), *range(3900, 3905)]:
        aligner.observe(phone(1e9 + second), 1e9 + second + rng.uniform(0.02, 0.5))
    hour = 1e9 + np.arange(300.0, 3900.0, 60.0)
    errors = [phone(t) + aligner.offset_at(phone(t)) - t for t in hour]
    assert np.max(np.abs(errors)) < 0.12  # the drift alone makes 0.29 s of it
    assert aligner.drift == pytest.approx(-drift, abs=3e-5)


def test_batches_kept_under_their_old_stamp_do_not_pass_for_a_clock_set_back() -> None:
    aligner = ClockAligner()
    for second in range(60):
        aligner.observe(1e9 + second, 1e9 + second + 0.05)
    for kept in range(60, 200):
        offset = aligner.observe(1e9 + kept, 1e9 + 200.0 + 0.01 * (kept - 60))
    assert offset == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize("step", [-2.0, 2.0])
def test_a_clock_set_by_a_little_is_followed_within_a_minute(step: float) -> None:
    rng, aligner = np.random.default_rng(5), ClockAligner()
    for second in range(120):
        aligner.observe(1e9 + second, 1e9 + second + rng.uniform(0.02, 0.5))
    for second in range(120, 180):
        offset = aligner.observe(1e9 + second + step, 1e9 + second + rng.uniform(0.02, 0.5))
    assert offset == pytest.approx(-step, abs=0.1)


def test_the_bounds_remembered_are_few_whatever_the_journeys() -> None:
    rng, aligner = np.random.default_rng(7), ClockAligner()
    for second in range(5000):
        down = rng.uniform(0.02, 0.5)
        echo = (1e9 + second, 1e9 + second + down)
        aligner.observe(1e9 + second + 0.6, 1e9 + second + 0.6 + rng.uniform(0.02, 0.5), echo)
    assert len(aligner._upper.corners) <= 64
    assert len(aligner._lower.corners) <= 64
