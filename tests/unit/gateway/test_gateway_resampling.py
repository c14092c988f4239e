"""Phones jitter, leave holes, send samples twice and out of order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.reckoning.resampling import RATE, Resampler, Segment


def joined(segments: list[Segment]) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([s.t for s in segments]), np.concatenate([s.values for s in segments])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([25.0, 50.0, 100.0, 400.0]), data=st.data())
def test_the_result_does_not_depend_on_how_a_recording_is_cut(seed: int, rate: float, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    t = 1e9 + np.sort(np.arange(0, 4, 1 / rate) + rng.uniform(-0.3, 0.3, int(4 * rate)) / rate)
    values = rng.normal(size=(len(t), 3))
    whole = joined(Resampler().push(t, values))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(t)), max_size=8)))
    resampler, parts = Resampler(), []
    for part_t, part_values in zip(np.split(t, cuts), np.split(values, cuts), strict=True):
        parts += resampler.push(part_t, part_values)
    np.testing.assert_allclose(joined(parts)[0], whole[0])
    np.testing.assert_allclose(joined(parts)[1], whole[1])
    np.testing.assert_allclose(np.diff(whole[0]), 1 / RATE, atol=1e-6)


def test_doubled_and_shuffled_samples_change_nothing() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0, 2, 0.01)
    values = np.sin(t)[:, None]
    order = np.concatenate([rng.permutation(len(t)), rng.integers(0, len(t), 50)])
    np.testing.assert_allclose(
        joined(Resampler().push(t[order], values[order]))[1], joined(Resampler().push(t, values))[1]
    )


def test_a_short_hole_is_bridged_and_a_long_one_cuts() -> None:
    t = np.arange(0, 2, 0.02) + 0.01
    short = Resampler().push(t[(t < 1.0) | (t > 1.2)], np.ones((len(t[(t < 1.0) | (t > 1.2)]), 1)))
    assert [s.restarts for s in short] == [True]
    long = Resampler().push(t[(t < 0.5) | (t > 1.2)], np.ones((len(t[(t < 0.5) | (t > 1.2)]), 1)))
    assert [s.restarts for s in long] == [True, True]


def test_samples_of_a_time_that_has_passed_are_dropped_and_counted() -> None:
    resampler = Resampler()
    resampler.push(np.arange(0, 2, 0.02), np.zeros((100, 1)))
    assert resampler.push(np.arange(0.5, 1.0, 0.02), np.zeros((25, 1))) == []
    assert resampler.late == 25


def test_a_clock_set_back_by_an_hour_starts_anew() -> None:
    resampler = Resampler()
    resampler.push(np.arange(5000, 5002, 0.02), np.zeros((100, 1)))
    segments = resampler.push(np.arange(1400, 1402, 0.02), np.zeros((100, 1)))
    assert segments[0].restarts
    assert segments[0].t[0] == pytest.approx(1400.01)
