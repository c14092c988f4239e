"""Headings from a phone in the pocket, on the minimal swinging thigh of [nonvisual-visual-fusion-dissertation §8]."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.gait_walks import Walk, replay, rested, swinging_thigh, twin_walk
from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples
from services.gateway.reckoning.dead_reckoning import Walk as Record
from services.gateway.reckoning.hops import RATE
from services.gateway.reckoning.pocket_heading import (
    PocketHeading,
    principal_axis,
    principal_harmonic,
    swing_asymmetry,
)
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE
from services.gateway.reckoning.strides import FOOTFALLS, SAMPLES, gather, strides
from services.gateway.steps.detector import Steps


def told(walks: list[Walk], method: PocketHeading | None = None, delay: float = 0.3) -> list[np.ndarray]:
    """Return of each walk (k, 6): t, heading, variance, bias variance, other, its probability."""
    method = method or PocketHeading()
    state = np.zeros(len(walks), method.STATE)
    rows = []
    for recent, steps in replay(walks, delay=delay):
        found = method.advance(state, recent, steps)
        columns = (found.heading, found.variance, found.bias_variance, found.other, found.other_probability)
        rows.append(np.column_stack([steps.phone, steps.t, *columns]))
    table = np.concatenate(rows)
    return [table[table[:, 0] == row, 1:] for row in range(len(walks))]


def errors(walk: Walk, table: np.ndarray) -> np.ndarray:
    return np.degrees((table[:, 1] - walk.heading_at(table[:, 0]) + np.pi) % (2.0 * np.pi) - np.pi)


def thighs(count: int, seed: int = 0, seconds: float = 60.0, **options: float) -> list[Walk]:
    return [swinging_thigh(np.random.default_rng([seed, number]), seconds, **options) for number in range(count)]


def slipped(walk: Walk, turn: Rotation, at: float) -> Walk:
    """Return the walk as a phone measures it that is turned in its pocket at a time."""
    rows = slice(int(at * RATE), None)
    inner = turn.as_matrix()
    changed = {name: getattr(walk, name).copy() for name in ("acceleration", "rate", "attitude")}
    changed["acceleration"][rows] = walk.acceleration[rows] @ inner
    changed["rate"][rows] = walk.rate[rows] @ inner
    changed["attitude"][rows] = walk.attitude[rows] @ inner
    return dataclasses.replace(walk, **changed)


def test_filtering_in_the_phones_axes_beats_no_filter_and_filtering_after_rotation() -> None:
    # The sheet's check values: 2.1 degrees against 4.4 and 7.3; 1.7 after rectification.
    off: dict[str, list[np.ndarray]] = {"author": [], "unfiltered": [], "after": []}
    for walk in thighs(8, seconds=120.0, yaw_sigma=0.0):
        begin, end = walk.steps[:-3], walk.steps[2:-1]
        place = (begin[:, None] + (end - begin)[:, None] * np.arange(SAMPLES) / SAMPLES) * RATE
        low = np.minimum(place.astype(int), len(walk.acceleration) - 2)
        part = (place - low)[:, :, None]
        acceleration = walk.acceleration[low] * (1.0 - part) + walk.acceleration[low + 1] * part
        attitude = walk.attitude[low]
        world = np.einsum("mnij,mnj->mni", attitude, acceleration)[:, :, :2]
        lines = {
            "author": np.einsum("mnij,mnj->mni", attitude, principal_harmonic(acceleration))[:, :, :2],
            "unfiltered": world,
            "after": principal_harmonic(world),
        }
        heading = np.interp(0.5 * (begin + end), np.arange(len(walk.heading)) / RATE, walk.heading)
        true = np.column_stack([np.sin(heading), np.cos(heading)])
        for name, line in lines.items():
            cosine = np.abs(np.sum(principal_axis(line) * true, axis=1))
            off[name].append(np.degrees(np.arccos(np.minimum(cosine, 1.0))))
    median = {name: float(np.median(np.concatenate(values))) for name, values in off.items()}
    assert median["author"] == pytest.approx(2.1, abs=0.6)
    assert median["unfiltered"] == pytest.approx(4.4, abs=1.2)
    assert median["after"] == pytest.approx(7.3, abs=1.8)


def test_the_constant_body_vector_makes_headings_better_than_single_strides() -> None:
    # Attitude off by 3 degrees: no method can be better than that, 2.0 in the median.
    walks = thighs(8, seconds=120.0)
    off = np.concatenate([np.abs(errors(*pair)) for pair in zip(walks, told(walks), strict=True)])
    assert np.median(off) < 2.6


def test_no_step_is_flipped_once_the_walk_has_begun() -> None:
    walks = thighs(12)
    for walk, table in zip(walks, told(walks), strict=True):
        later = table[:, 0] > 5.0
        assert (np.abs(errors(walk, table)[later]) < 45.0).all()


def test_a_thigh_that_swings_forward_faster_than_back_says_which_way_is_forward() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    flexion = np.cos(phase) + 0.5 * np.cos(2.0 * phase)  # peaks at 1.5, falls to -0.75
    for heading in np.radians([0.0, 70.0, 200.0, 310.0]):
        right = np.array([np.cos(heading), -np.sin(heading)])
        cue = swing_asymmetry((flexion[:, None] * right)[None])[0]
        assert cue / np.hypot(*cue) == pytest.approx([np.sin(heading), np.cos(heading)], abs=1e-9)


def test_the_opposite_heading_is_offered_while_the_sign_is_unsure() -> None:
    table = told(thighs(1))[0]
    known = table[table[:, 1] != 0.0]
    assert 0.5 >= known[0, 5] > known[10, 5] > 0.0
    assert np.cos(known[:, 1] - known[:, 4]) == pytest.approx(-1.0)


def test_no_first_step_after_a_rest_is_sure_and_backwards() -> None:
    for seed in (508, 509, 720):
        walk = rested(twin_walk(seed, [(25.0, 0.0)], "pocket"), np.random.default_rng(seed), 5.0)
        phone, reckoner = Record("pocket"), DeadReckoner(0.0)
        t = 1e9 + (np.arange(len(walk.acceleration)) + 0.5) / RATE
        (motions,) = reckoner.advance([phone], [InertialSamples(t, walk.acceleration, walk.rate, walk.field)])
        step_t, heading, doubt = (
            np.concatenate([getattr(m, name) for m in motions]) for name in ("step_t", "heading", "other_probability")
        )
        backwards = np.cos(heading + walk.heading_at(step_t - 1e9)) < 0.0
        assert len(step_t) > 25
        assert (doubt[backwards] > 0.4).all()
        assert not backwards[8:].any()
        assert doubt[-1] < 0.05


@pytest.mark.parametrize("robust", [False, True])
def test_the_body_vector_recovers_how_the_phone_lies_in_the_pocket(robust: bool) -> None:
    walks = thighs(6, yaw_sigma=0.0)
    method = PocketHeading(robust=robust)
    state = np.zeros(len(walks), method.STATE)
    for recent, steps in replay(walks):
        method.advance(state, recent, steps)
    for row, walk in enumerate(walks):
        n = len(walk.truth) - 100
        ahead = np.array([np.sin(walk.heading[n]), np.cos(walk.heading[n]), 0.0])
        true = np.mean([walk.truth[i].T @ ahead for i in range(n - 50, n)], axis=0)
        vector = state["ahead"][row]
        cosine = vector @ true / np.linalg.norm(vector) / np.linalg.norm(true)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 6.0


@pytest.mark.parametrize("degrees", [40.0, 180.0])
def test_a_phone_that_slipped_in_the_pocket_is_understood_again(degrees: float) -> None:
    walks = [
        slipped(walk, Rotation.from_rotvec(np.radians(degrees) * np.array([0.36, 0.48, 0.8])), 60.0)
        for walk in thighs(4, seconds=150.0, yaw_sigma=0.0)
    ]
    for walk, table in zip(walks, told(walks), strict=True):
        off = np.abs(errors(walk, table))[table[:, 0] > 110.0]
        assert np.median(off) < 6.0


def test_told_variances_are_not_too_small() -> None:
    walks = thighs(10)
    square = np.concatenate(
        [np.radians(errors(walk, table)) ** 2 / table[:, 2] for walk, table in zip(walks, told(walks), strict=True)]
    )
    assert np.mean(square[square < 100.0]) < 1.2


def test_nothing_is_claimed_of_the_first_step_of_an_unknown_phone() -> None:
    walk = thighs(1)[0]
    recent, _ = next(iter(replay([walk])))
    state = np.zeros(1, PocketHeading.STATE)
    alone = Steps(np.array([0]), np.array([0.9]), np.array([False]), np.array([0.0]))
    found = PocketHeading().advance(state, recent, alone)
    assert found.variance[0] == UNKNOWN_VARIANCE
    assert found.other_probability[0] == 0.0
    assert found.heading[0] == found.other[0]


def test_many_phones_at_once_are_told_the_same_as_each_alone() -> None:
    walks = thighs(5, seconds=25.0)
    together = told(walks)
    for walk, table in zip(walks, together, strict=True):
        assert told([walk])[0] == pytest.approx(table, abs=1e-9)


def test_steps_told_late_and_many_at_once_get_the_same_headings() -> None:
    walk = thighs(1, seconds=30.0)[0]
    soon, late = told([walk])[0], told([walk], delay=5.0)[0]
    assert late[:, :2] == pytest.approx(soon[: len(late), :2], abs=1e-4)


def test_no_step_leaves_the_state_as_it_was() -> None:
    walk = thighs(1)[0]
    recent, _ = next(iter(replay([walk])))
    state = np.zeros(1, PocketHeading.STATE)
    nobody = Steps(np.empty(0, np.int64), np.empty(0), np.array([False]), np.zeros(1))
    assert len(PocketHeading().advance(state, recent, nobody).heading) == 0
    assert state == np.zeros(1, PocketHeading.STATE)


def test_a_stride_is_two_footfalls_and_none_where_somebody_stopped() -> None:
    walk = thighs(1)[0]
    recent = next(itertools.islice(replay([walk]), 9, None))[0]
    footfalls = np.zeros(1, FOOTFALLS)
    steps = Steps(np.zeros(5, np.int64), np.array([2.0, 2.5, 3.1, 8.0, 8.5]), np.array([True]), np.array([0.0]))
    found = strides(footfalls, recent, steps)
    assert found.known.tolist() == [False, False, True, False, False]
    assert found.begin[2] == 2.0
    assert footfalls["t"][0].tolist() == [8.0, 8.5]


def test_a_window_is_cut_where_the_stride_was() -> None:
    walk = thighs(1)[0]
    recent = next(itertools.islice(replay([walk]), 9, None))[0]
    footfalls = np.zeros(1, FOOTFALLS)
    found = strides(footfalls, recent, Steps(np.zeros(1, np.int64), np.array([7.0]), np.array([True]), np.array([0.5])))
    cut = gather(recent.acceleration, recent, np.zeros(1, np.int64), found)[0]
    wanted = np.interp(6.0 + np.arange(SAMPLES) / SAMPLES, np.arange(600) / RATE, walk.acceleration[:600, 0])
    assert cut[:, 0] == pytest.approx(wanted, abs=1e-3)
