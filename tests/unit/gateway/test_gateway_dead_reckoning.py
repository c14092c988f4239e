"""From samples to steps on the plan, as a whole."""

import itertools
import math

import numpy as np
import pytest

from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples, Motion
from services.gateway.reckoning.heading import UNKNOWN_VARIANCE
from services.gateway.reckoning.stride import step_length


def walk(compass: float, seconds: float = 20.0, rate: float = 100.0, start: float = 1e9) -> InertialSamples:
    """Five seconds of rest, then a walk with the phone flat in the hand."""
    t = start + np.arange(0, seconds + 5.0, 1 / rate)
    bounce = 2.5 * np.sin(2 * np.pi * 1.9 * (t - start)) * (t - start > 5.0)
    zero = np.zeros_like(t)
    field = np.stack([-20 * math.sin(compass) + zero, 20 * math.cos(compass) + zero, -43 + zero], axis=1)
    return InertialSamples(t, np.stack([zero, zero, 9.81 + bounce], axis=1), np.zeros((len(t), 3)), field)


def cut(samples: InertialSamples, seconds: float = 1.0) -> list[InertialSamples]:
    edges = np.searchsorted(samples.t, np.arange(samples.t[0] + seconds, samples.t[-1], seconds))
    assert samples.field is not None
    columns = (samples.t, samples.acceleration, samples.rotation, samples.field)
    return [InertialSamples(*parts) for parts in zip(*(np.split(c, edges) for c in columns), strict=True)]


def reckon(samples: list[InertialSamples], reckoner: DeadReckoner | None = None) -> list[Motion]:
    reckoner = reckoner or DeadReckoner(north=math.pi / 2)
    return [motion for part in samples for motion in reckoner.push(part)]


@pytest.mark.parametrize(("compass", "toward"), [(0.0, (0.0, 1.0)), (math.pi / 2, (1.0, 0.0)), (math.pi, (0.0, -1.0))])
def test_a_walk_leads_where_the_compass_points(compass: float, toward: tuple[float, float]) -> None:
    motions = reckon(cut(walk(compass)))
    length = np.concatenate([m.length for m in motions])
    heading = np.concatenate([m.heading for m in motions])
    end = np.array([(length * np.cos(heading)).sum(), (length * np.sin(heading)).sum()])
    np.testing.assert_allclose(end, 20.0 * 1.9 * 0.70 * np.array(toward), atol=2.0)


def test_reports_come_about_once_a_second_join_without_holes_and_tell_each_step_once() -> None:
    motions = reckon(cut(walk(0.3)))
    assert all(0.9 <= m.t - earlier.t <= 1.1 for earlier, m in itertools.pairwise(motions))
    assert all(m.t_start <= earlier.t + 1e-9 for earlier, m in itertools.pairwise(motions))
    steps = np.concatenate([m.step_t for m in motions])
    assert np.all(np.diff(steps) > 0.3)
    assert all(m.t_start <= m.step_t.min() and m.step_t.max() <= m.t for m in motions if len(m.step_t))


def test_rest_is_still_and_walking_is_walking() -> None:
    motions = reckon(cut(walk(0.0)))
    assert {m.activity for m in motions if m.t < 1e9 + 4.5} == {"still"}
    assert {m.activity for m in motions if m.t > 1e9 + 10.0} == {"walking"}


def test_quarter_second_batches_give_the_same_steps_as_second_ones() -> None:
    samples = walk(0.0)
    often, seldom = reckon(cut(samples, 0.25)), reckon(cut(samples, 1.0))
    steps = [np.concatenate([m.step_t for m in motions]) for motions in (often, seldom)]
    count = min(map(len, steps))
    assert count >= 35
    np.testing.assert_allclose(steps[0][:count], steps[1][:count], atol=1e-6)


def test_a_hole_of_ten_seconds_ends_one_walk_and_begins_another() -> None:
    first, second = walk(0.0), walk(0.0, start=1e9 + 35.0)
    motions = reckon(cut(first) + cut(second))
    assert not any(m.t_start < 1e9 + 25.5 and m.t > 1e9 + 34.5 for m in motions)
    steps = np.concatenate([m.step_t for m in motions])
    assert np.all(np.diff(steps) > 0.3)
    assert np.sum(steps > 1e9 + 35.0) >= 35


def test_a_phone_in_a_pocket_admits_that_its_heading_is_unknown() -> None:
    motions = reckon(cut(walk(0.0)), DeadReckoner(math.pi / 2, heading_known=False))
    assert all(np.all(m.heading_variance == UNKNOWN_VARIANCE) for m in motions)


def test_a_phone_that_loses_its_compass_goes_on() -> None:
    parts = cut(walk(0.0))
    blind = [InertialSamples(p.t, p.acceleration, p.rotation, None) for p in parts[12:]]
    motions = reckon(parts[:12] + blind)
    assert sum(len(m.step_t) for m in motions) >= 30


def test_strollers_steps_are_less_certain() -> None:
    length, variance = step_length(np.array([1.86, 1.3]))
    assert length == pytest.approx([0.70, 0.70])
    assert variance[1] > 2 * variance[0]
