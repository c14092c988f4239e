"""Cadence, length and distance of a person's steps belong together."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from services.simulator.phones.stride import Stride, StrideParameters, StrideRhythm

seeds = st.integers(0, 10_000)


def somebody(seed: int) -> Stride:
    return Stride.draw(np.random.default_rng(seed), StrideParameters())


@given(seeds, st.floats(0.01, 2.5))
def test_speed_is_cadence_times_length(seed: int, speed: float) -> None:
    stride = somebody(seed)
    at = np.array([speed])
    assert (stride.cadence(at) * stride.length(at))[0] == pytest.approx(speed, rel=1e-9)


@given(seeds)
def test_above_a_stroll_length_follows_cadence_and_height_by_the_personal_law(seed: int) -> None:
    stride = somebody(seed)
    speed = np.linspace(0.8, 2.0, 20)
    cadence = stride.cadence(speed)
    law = stride.height * (stride.slope * cadence + stride.share) + stride.constant
    np.testing.assert_allclose(stride.length(speed), law, rtol=1e-9)
    assert (np.diff(cadence) > 0).all()


@given(seeds)
def test_who_goes_slower_than_a_stroll_takes_shorter_steps_and_nobody_runs_on_the_spot(seed: int) -> None:
    stride = somebody(seed)
    slow = np.linspace(0.0, 0.5, 30)
    assert (stride.cadence(slow)[slow < 0.1] < 1.0).all()
    assert (stride.length(slow) >= Stride.SHORTEST - 1e-9).all()


def test_people_walk_at_the_cadence_of_people_and_each_at_their_own() -> None:
    speed = np.array([1.3])
    cadences = np.array([somebody(seed).cadence(speed)[0] for seed in range(400)])
    assert cadences.mean() == pytest.approx(1.86, abs=0.06)
    assert 0.06 < cadences.std() < 0.16


@given(seeds, st.lists(st.floats(0.0, 2.0), min_size=2, max_size=30), st.integers(1, 7))
def test_the_lengths_of_all_steps_add_up_to_the_distance_walked(seed: int, speeds: list[float], cuts: int) -> None:
    """However irregular the walk, and however it is cut into stretches."""
    speed = np.repeat(np.array(speeds), 50)
    t = 0.02 * np.arange(len(speed))
    walked = np.cumsum(speed) * 0.02
    rhythm = StrideRhythm(np.random.default_rng(seed), somebody(seed), 0.1)
    parts = [
        rhythm.follow(*part)
        for part in zip(*(np.array_split(column, cuts) for column in (t, walked, speed)), strict=True)
    ]
    ends, lengths = np.concatenate([part.t for part in parts]), np.concatenate([part.length for part in parts])
    count = np.concatenate([part.count for part in parts])
    assert (np.diff(count) >= 0).all()
    if not len(ends):
        return
    assert (np.diff(ends) > 0).all()
    between = np.interp(ends, t, walked)
    np.testing.assert_allclose(np.diff(between), lengths[1:], atol=1e-6)
    assert len(ends) in (np.floor(count[-1]), np.floor(count[-1]) - 1)


def test_after_a_time_of_which_nothing_is_known_no_step_spans_it() -> None:
    rhythm = StrideRhythm(np.random.default_rng(1), somebody(1), 0.04)
    t = 0.02 * np.arange(500)
    rhythm.follow(t, 1.2 * t, np.full(500, 1.2))
    rhythm.restart()
    steps = rhythm.follow(t + 100.0, 1.2 * t + 500.0, np.full(500, 1.2))
    assert len(steps.t) > 10
    assert steps.t.min() >= 100.0
    assert steps.length.max() < 1.2


@pytest.mark.parametrize("wrong", [{"height": -1}, {"irregularity": float("nan")}, {"strides": 3}])
def test_impossible_strides_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        StrideParameters.model_validate(wrong)
