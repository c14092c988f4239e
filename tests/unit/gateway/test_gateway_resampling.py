"""Phones jitter, leave holes, send samples twice and out of order; hops are even all the same."""

import itertools
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.reckoning.hops import HOP, RATE
from services.gateway.reckoning.resampling import InertialSamples, Resampler, SingleHop, stack


def samples(t: np.ndarray, values: np.ndarray | None = None) -> InertialSamples:
    """Samples whose values are functions of time, unless given (n, 9)."""
    if values is None:
        wave = np.sin(np.outer(t - 1e9, np.linspace(0.5, 4.0, 9)))
        values = wave
    return InertialSamples(t, values[:, :3], values[:, 3:6], values[:, 6:9])


def taken(part: InertialSamples, rows: np.ndarray | slice) -> InertialSamples:
    columns = (part.t, part.acceleration, part.rotation, part.field)
    return InertialSamples(*(None if column is None else column[rows] for column in columns))


def run(part: InertialSamples, cuts: list[int] | None = None) -> list[SingleHop]:
    resampler, hops = Resampler(), []
    edges = [0, *sorted(cuts or []), len(part.t)]
    for begin, end in itertools.pairwise(edges):
        hops += resampler.push(taken(part, slice(begin, end)))
    return hops + resampler.finish()


def assert_same(one: list[SingleHop], other: list[SingleHop]) -> None:
    assert [(h.t, h.count, h.fresh) for h in one] == [(h.t, h.count, h.fresh) for h in other]
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.values, b.values)


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([20.0, 50.0, 100.0, 400.0]), data=st.data())
def test_nothing_depends_on_how_a_recording_is_cut(seed: int, rate: float, data: st.DataObject) -> None:
    """With jitter, doubles, disorder, holes, a compass at its own rate, and a clock that is set back."""
    rng = np.random.default_rng(seed)
    t = 1e9 + np.cumsum(rng.exponential(1.0 / rate, int(6 * rate)))
    t += rng.choice([0.0, 0.1, 0.25, 0.5, 3.0], len(t), p=[0.99, 0.004, 0.003, 0.002, 0.001]).cumsum()
    t[rng.random(len(t)) < 0.02] -= rng.choice([0.1, 0.29, 0.4, 2.0])
    if rng.random() < 0.3:
        t[len(t) // 2 :] -= 3600.0
    t = np.repeat(t, rng.choice([1, 2], len(t), p=[0.97, 0.03]))
    values = rng.normal(size=(len(t), 9))
    values[rng.random(len(t)) < rng.choice([0.0, 0.6, 0.95]), 6:] = np.nan
    part = samples(t, values)
    cuts = data.draw(st.lists(st.integers(0, len(t)), max_size=12))
    assert_same(run(part, cuts), run(part))
    assert_same(run(part, list(range(0, len(t), 50))), run(part))


def test_what_comes_out_is_what_was_measured_at_even_times() -> None:
    t = 1e9 + np.arange(0, 5, 0.01)
    hops = run(samples(t))
    assert [hop.count for hop in hops] == [HOP] * 5
    assert [hop.fresh for hop in hops] == [True] + [False] * 4
    np.testing.assert_allclose(np.diff([hop.t for hop in hops]), HOP / RATE)
    even = stack(hops).times().ravel()
    found = np.concatenate([hop.values for hop in hops])
    np.testing.assert_allclose(found, np.sin(np.outer(even - 1e9 - 0.005, np.linspace(0.5, 4.0, 9))), atol=2e-3)


def test_slow_phones_are_filled_in_by_straight_lines() -> None:
    t = 1e9 + np.arange(0, 4, 0.05)
    found = np.concatenate([hop.values for hop in run(samples(t, np.tile((t - 1e9)[:, None], 9)))])[:150, 0]
    np.testing.assert_allclose(np.diff(found), 1 / RATE, atol=0.021)
    assert found[-1] == pytest.approx(3.0, abs=0.03)


@pytest.mark.parametrize("disorder", [0.1, 0.28])
def test_doubled_and_shuffled_samples_change_nothing_even_across_batches(disorder: float) -> None:
    rng = np.random.default_rng(1)
    t = 1e9 + np.arange(0, 5, 0.01)
    whole = samples(t)
    arrival = np.argsort(t + rng.uniform(0.0, disorder, len(t)), kind="stable")
    assert_same(run(taken(whole, arrival), list(range(0, 500, 7))), run(whole))
    near = np.insert(arrival, np.arange(5, 400, 9), arrival[np.arange(0, 395, 9)])
    assert_same(run(taken(whole, near), list(range(0, 500, 7))), run(whole))


def test_a_short_hole_is_bridged() -> None:
    t = 1e9 + np.arange(0, 4, 0.02) + 0.01
    hops = run(samples(t[(t < 1e9 + 1.0) | (t > 1e9 + 1.25)]))
    assert [(hop.count, hop.fresh) for hop in hops] == [(50, True), (50, False), (50, False), (50, False)]
    assert all(np.isfinite(hop.values).all() for hop in hops)


def test_a_long_hole_ends_the_hop_and_begins_another() -> None:
    t = 1e9 + np.arange(0, 4, 0.02) + 0.01
    hops = run(samples(t[(t < 1e9 + 0.5) | (t > 1e9 + 1.2)]))
    assert [(hop.count, hop.fresh) for hop in hops][:2] == [(25, True), (50, True)]
    np.testing.assert_array_equal(hops[0].values[25:], np.tile(hops[0].values[24], (25, 1)))
    assert hops[1].t == pytest.approx(1e9 + 1.21, abs=0.011)


def test_a_hole_is_told_as_soon_as_it_is_known_to_be_one() -> None:
    t = 1e9 + np.arange(0, 1.5, 0.02) + 0.01
    resampler = Resampler()
    before = resampler.push(samples(t))
    after = resampler.push(samples(t[-1:] + 1.0))
    assert [hop.count for hop in before + after] == [50, 25]


def test_samples_of_a_time_that_has_passed_are_dropped_and_counted() -> None:
    resampler = Resampler()
    t = 1e9 + np.arange(0, 3, 0.02)
    resampler.push(samples(t))
    resampler.push(samples(t[20:45]))
    resampler.push(samples(t + 3.0))
    assert resampler.late == 25


def test_a_clock_set_back_by_an_hour_starts_anew() -> None:
    t = 5000.01 + np.arange(0, 2, 0.02)
    hops = run(samples(np.concatenate([t, t - 3600.0]), np.zeros((200, 9))))
    assert [hop.fresh for hop in hops].count(True) == 2
    assert hops[-1].t < 1500.0
    assert sum(hop.count for hop in hops) == 200


def test_a_clock_set_forward_starts_anew() -> None:
    t = 5000.01 + np.arange(0, 2, 0.02)
    hops = run(samples(np.concatenate([t, t + 3600.0]), np.zeros((200, 9))))
    assert [hop.fresh for hop in hops].count(True) == 2


def test_a_compass_that_samples_seldom_is_held_and_one_that_stops_is_missed() -> None:
    t = 1e9 + np.arange(0, 6, 0.01)
    values = np.ones((len(t), 9))
    values[np.arange(len(t)) % 10 != 0, 6:] = np.nan
    values[t > 1e9 + 3.0, 6:] = np.nan
    field = np.concatenate([hop.values[:, 6] for hop in run(samples(t, values))])
    np.testing.assert_array_equal(field[:150], 1.0)
    assert np.isnan(field[170:]).all()


def test_a_phone_without_gyroscope_or_compass_has_zeros_and_nothing() -> None:
    t = 1e9 + np.arange(0, 2, 0.02)
    (hop, *_) = run(InertialSamples(t, np.ones((100, 3)), None, None))
    np.testing.assert_array_equal(hop.values[:, 3:6], 0.0)
    assert np.isnan(hop.values[:, 6:]).all()


def test_a_phone_that_sends_the_same_time_for_ever_does_not_fill_the_memory() -> None:
    resampler = Resampler()
    for _ in range(200):
        resampler.push(samples(np.full(50, 1e9)))
    assert resampler.nbytes < 100_000


def test_an_hour_at_once_is_no_slower_than_its_samples() -> None:
    t = 1e9 + np.arange(0, 3600, 0.02)
    assert len(run(samples(t, np.zeros((len(t), 9))))) == 3600


def test_samples_too_sparse_to_tell_anything_lead_to_no_hops() -> None:
    assert run(samples(1e9 + 0.33 * np.arange(10_000), np.zeros((10_000, 9)))) == []


def test_a_few_samples_between_two_holes_are_dropped_and_more_are_not() -> None:
    t = 1e9 + np.arange(0, 6, 0.02) + 0.01
    few, more = ((t > 1e9 + begin) & (t < 1e9 + begin + 0.02 * count) for begin, count in ((2.0, 4), (3.0, 5)))
    hops = run(samples(t[(t < 1e9 + 1.0) | few | more | (t > 1e9 + 4.0)]))
    assert [(hop.count, hop.fresh) for hop in hops] == [(50, True), (5, True), (50, True), (50, False)]


def test_it_can_be_put_away_and_taken_up_again() -> None:
    whole = samples(1e9 + np.arange(0, 5, 0.01))
    resampler = Resampler()
    hops = resampler.push(taken(whole, slice(0, 230)))
    again: Resampler = pickle.loads(pickle.dumps(resampler))
    hops += again.push(taken(whole, slice(230, 500))) + again.finish()
    assert_same(hops, run(whole))
