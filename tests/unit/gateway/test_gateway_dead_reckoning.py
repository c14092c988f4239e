"""From samples to steps on the plan, as a whole, of one phone and of many."""

import dataclasses
import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.dead_reckoning import Carrying, DeadReckoner, InertialSamples, Motion, Walk, _cadence
from services.gateway.reckoning.gradient_descent import GradientDescentFilter
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE
from services.gateway.steps.detector import Steps
from shared.walking.stride import StrideLine

NORTH_UP = math.pi / 2


def walk(
    compass: float, seconds: float = 20.0, rate: float = 100.0, start: float = 1e9, corner: float = 0.0
) -> InertialSamples:
    """Five seconds of rest, then a walk with the phone flat in the hand; halfway ``corner`` rad to the left."""
    t = start + np.arange(0, seconds + 5.0, 1 / rate)
    bounce = 2.5 * np.sin(2 * np.pi * 1.9 * (t - start)) * (t - start > 5.0)
    zero = np.zeros_like(t)
    turned = corner * np.clip(t - start - 5.0 - seconds / 2, 0.0, 1.0)
    facing = compass - turned
    field = np.stack([-20 * np.sin(facing), 20 * np.cos(facing), -43 + zero], axis=1)
    rotation = np.stack([zero, zero, np.gradient(turned, t)], axis=1)
    return InertialSamples(t, np.stack([zero, zero, 9.81 + bounce], axis=1), rotation, field)


def cut(samples: InertialSamples, seconds: float = 1.0) -> list[InertialSamples]:
    edges = np.searchsorted(samples.t, np.arange(samples.t[0] + seconds, samples.t[-1], seconds))
    columns = (samples.t, samples.acceleration, samples.rotation, samples.field)
    return [
        InertialSamples(*parts) for parts in zip(*(np.split(c, edges) for c in columns if c is not None), strict=True)
    ]


def reckon(
    samples: list[InertialSamples], carrying: Carrying = "hand", phone: Walk | None = None, **chosen: Attitude
) -> list[Motion]:
    phone, reckoner = phone or Walk(carrying), DeadReckoner(NORTH_UP, **chosen)
    motions = [motion for part in samples for motion in reckoner.advance([phone], [part])[0]]
    return motions + reckoner.finish([phone])[0]


def steps_of(motions: list[Motion]) -> np.ndarray:
    return np.concatenate([m.step_t for m in motions])


def assert_same(one: list[Motion], other: list[Motion], **tolerance: float) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        for name, value in dataclasses.asdict(a).items():
            if isinstance(value, str):
                assert value == getattr(b, name)
            else:
                np.testing.assert_allclose(value, getattr(b, name), err_msg=name, **tolerance)


@pytest.mark.parametrize(
    "attitude", [ComplementaryFilter(), GradientDescentFilter()], ids=["complementary", "gradient"]
)
@pytest.mark.parametrize(("compass", "toward"), [(0.0, (0.0, 1.0)), (math.pi / 2, (1.0, 0.0)), (math.pi, (0.0, -1.0))])
def test_a_walk_leads_where_the_compass_points(compass: float, toward: tuple[float, float], attitude: Attitude) -> None:
    motions = reckon(cut(walk(compass)), attitude=attitude)
    length = np.concatenate([m.length for m in motions])
    heading = np.concatenate([m.heading for m in motions])
    end = np.array([(length * np.cos(heading)).sum(), (length * np.sin(heading)).sum()])
    assert len(length) == pytest.approx(38, abs=2)
    np.testing.assert_allclose(end / length.sum(), toward, atol=0.02)


@pytest.mark.parametrize("turned", [0.0, 0.7, -2.0])
def test_a_walk_north_leads_north_on_a_plan_that_is_turned(turned: float) -> None:
    phone = Walk("hand")
    (motions,) = DeadReckoner(turned).advance([phone], [walk(0.0)])
    heading = np.concatenate([m.heading for m in motions])
    np.testing.assert_allclose(np.cos(heading - turned), 1.0, atol=1e-3)


def test_reports_come_once_a_second_join_without_holes_and_tell_each_step_once() -> None:
    motions = reckon(cut(walk(0.3)))[:-1]
    assert all(m.t - earlier.t == pytest.approx(1.0) for earlier, m in itertools.pairwise(motions))
    assert all(m.t_start <= earlier.t + 1e-6 for earlier, m in itertools.pairwise(motions))
    assert np.all(np.diff(steps_of(motions)) > 0.3)
    assert all(m.t_start <= m.step_t.min() and m.step_t.max() <= m.t for m in motions if len(m.step_t))


def test_every_column_has_one_entry_per_step_and_each_its_variance() -> None:
    for motion in reckon(cut(walk(0.3))):
        columns = [value for name, value in dataclasses.asdict(motion).items() if np.ndim(value) and "turn" not in name]
        assert {len(column) for column in columns} == {len(motion.step_t)}
        assert np.all(motion.heading_variance >= motion.heading_bias_variance)
        assert np.all(motion.length_variance >= motion.length**2 * motion.length_scale_variance)


def test_rest_is_still_walking_is_walking_and_fidgeting_is_neither() -> None:
    motions = reckon(cut(walk(0.0)))
    assert {m.activity for m in motions if m.t < 1e9 + 4.5} == {"still"}
    assert {m.activity for m in motions if m.t > 1e9 + 10.0} == {"walking"}
    rest = walk(0.0, 0.0, start=1e9)
    shaken = rest.acceleration + np.random.default_rng(1).normal(0.0, 1.0, rest.acceleration.shape).cumsum(axis=0) * 0.1
    fidget = InertialSamples(rest.t, shaken, rest.rotation, rest.field)
    assert {m.activity for m in reckon(cut(fidget))} == {"other"}


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 2500), max_size=10).map(sorted))
def test_nothing_depends_on_how_the_stream_is_cut(edges: list[int]) -> None:
    samples = walk(0.0, corner=1.0)
    columns = (samples.t, samples.acceleration, samples.rotation, samples.field)
    parts = [InertialSamples(*p) for p in zip(*(np.split(c, edges) for c in columns if c is not None), strict=True)]
    assert_same(reckon(parts), reckon([samples]), rtol=0, atol=0)


def test_phones_side_by_side_are_told_what_each_is_told_alone() -> None:
    """Of all ways of carrying, beginning at different times, one silent for a while, one that sends nothing."""
    carryings: list[Carrying] = ["hand", "pocket", "bag", "unknown", "hand", "unknown"]
    streams = [cut(walk(0.5 * n, 12.0, start=1e9 + 0.37 * n, corner=0.3 * n), 0.5) for n in range(len(carryings))]
    del streams[0][14:18]
    streams[4] = []
    alone = [reckon(stream, carrying) for stream, carrying in zip(streams, carryings, strict=True)]
    phones, reckoner = [Walk(carrying) for carrying in carryings], DeadReckoner(NORTH_UP)
    together: list[list[Motion]] = [[] for _ in phones]
    for turn in range(max(map(len, streams))):
        rows = [row for row, stream in enumerate(streams) if turn < len(stream)]
        told = reckoner.advance([phones[row] for row in rows], [streams[row][turn] for row in rows])
        for row, motions in zip(rows, told, strict=True):
            together[row] += motions
    for row, motions in enumerate(reckoner.finish(phones)):
        together[row] += motions
        assert_same(together[row], alone[row], atol=1e-6, rtol=1e-6)


def test_nothing_depends_on_when_the_phones_clock_began() -> None:
    early, late = (reckon([walk(0.0, corner=1.0, start=start + 0.005)]) for start in (0.0, 1.7e9))
    assert [m.activity for m in early] == [m.activity for m in late]
    np.testing.assert_allclose(steps_of(early), steps_of(late) - 1.7e9, atol=1e-4)
    for name in ("length", "heading", "turn"):
        one, other = (np.concatenate([getattr(m, name) for m in motions]) for motions in (early, late))
        np.testing.assert_allclose(one, other, atol=1e-3)


def test_a_step_that_follows_no_other_takes_its_cadence_from_the_next_unless_that_is_far() -> None:
    steps = Steps(np.array([0, 0, 0]), np.array([100.0, 104.0, 104.5]), np.array([True]), np.array([0.6]))
    np.testing.assert_allclose(_cadence(np.array([0.0]), steps), [1 / 0.6, 2.0, 2.0])


def test_a_hole_of_ten_seconds_ends_one_walk_and_begins_another() -> None:
    motions = reckon(cut(walk(0.0)) + cut(walk(0.0, start=1e9 + 35.0)))
    assert not any(m.t_start < 1e9 + 25.5 and m.t > 1e9 + 34.5 for m in motions)
    steps = steps_of(motions)
    assert np.all(np.diff(steps) > 0.3)
    assert np.sum(steps > 1e9 + 35.0) >= 35
    assert {m.walk for m in motions if len(m.step_t) and m.t < 1e9 + 30.0} == {1}
    assert {m.walk for m in motions if len(m.step_t) and m.t > 1e9 + 30.0} == {2}


@pytest.mark.parametrize(("stop", "walks"), [(6.0, 1), (16.0, 2)])
def test_a_long_stop_begins_a_new_walk_and_a_short_one_does_not(stop: float, walks: int) -> None:
    first, second = walk(0.0), walk(0.0, start=1e9 + 25.0 + stop - 5.0)
    t = np.arange(1e9 + 25.0, second.t[0], 0.01)
    pause = InertialSamples(t, np.tile([0.0, 0.0, 9.81], (len(t), 1)), np.zeros((len(t), 3)), None)
    assert max(m.walk for m in reckon([first, pause, second])) == walks


def test_walks_are_counted_on_where_a_phone_was_put_away() -> None:
    motions = reckon(cut(walk(0.0)), phone=Walk("hand", walks=7))
    assert {m.walk for m in motions if len(m.step_t)} == {8}


def test_a_corner_is_told_with_its_side() -> None:
    motions = reckon(cut(walk(0.0, 30.0, corner=math.pi / 2)))
    ((t, angle),) = [(t, a) for m in motions for t, a in zip(m.turn_t, m.turn, strict=True)]
    assert math.degrees(angle) == pytest.approx(90.0, abs=5.0)
    assert t == pytest.approx(1e9 + 20.5, abs=0.5)
    heading = np.concatenate([m.heading for m in motions])
    assert math.degrees(heading[-1] - heading[0]) % 360.0 == pytest.approx(90.0, abs=2.0)


def test_a_phone_without_a_compass_admits_that_its_walk_points_anywhere() -> None:
    samples = walk(0.0, corner=1.0)
    blind = InertialSamples(samples.t, samples.acceleration, samples.rotation, None)
    motions = [m for m in reckon([blind]) if len(m.step_t)]
    assert all(np.all(m.heading_variance == UNKNOWN_VARIANCE) for m in motions)
    own = [m.heading_variance[-1] - m.heading_bias_variance for m in motions]
    assert own[0] > 0.0
    assert all(np.diff(own) > 0.0)
    heading = np.concatenate([m.heading for m in motions])
    assert heading[-1] - heading[0] == pytest.approx(1.0, abs=0.05)


def test_a_phone_in_a_bag_admits_that_its_heading_is_unknown() -> None:
    motions = [m for m in reckon(cut(walk(0.0)), "bag") if len(m.step_t)]
    assert motions
    assert all(np.all(m.heading_variance == UNKNOWN_VARIANCE) for m in motions)


def test_a_phone_without_a_gyroscope_steps_all_the_same() -> None:
    samples = walk(1.0)
    motions = reckon([InertialSamples(samples.t, samples.acceleration, None, samples.field)])
    assert len(steps_of(motions)) >= 35
    heading = np.concatenate([m.heading for m in motions])
    np.testing.assert_allclose(heading, NORTH_UP - 1.0, atol=0.05)


def test_a_phone_without_a_gyroscope_follows_a_corner_by_its_compass() -> None:
    samples = walk(0.0, 30.0, corner=math.pi / 2)
    motions = [
        m for m in reckon([InertialSamples(samples.t, samples.acceleration, None, samples.field)]) if len(m.step_t)
    ]
    turned = np.degrees(np.concatenate([m.heading for m in motions]) - NORTH_UP)
    after = steps_of(motions) > 1e9 + 24.0
    assert np.abs(turned[after] - 90.0).max() < 10.0
    assert all(m.heading_bias_variance > math.radians(15.0) ** 2 for m in motions)


@pytest.mark.parametrize(("hole", "rested"), [(0.5, 0), (5.0, 0), (11.0, 1)])
def test_a_walk_goes_on_after_a_short_hole(hole: float, rested: int) -> None:
    samples = walk(0.4, 60.0)
    gone = (samples.t > 1e9 + 30.0) & (samples.t < 1e9 + 30.0 + hole)
    columns = (samples.t, samples.acceleration, samples.rotation, samples.field)
    motions = [m for m in reckon([InertialSamples(*(c[~gone] for c in columns if c is not None))]) if len(m.step_t)]
    assert {m.walk for m in motions} == set(range(1, 2 + rested))
    assert motions[-1].t > 1e9 + 60.0
    after = next(m for m in motions if m.t > 1e9 + 30.0 + hole)
    np.testing.assert_allclose(after.heading, NORTH_UP - 0.4, atol=0.1)
    if hole < 2.0:
        assert np.all(after.heading_variance < UNKNOWN_VARIANCE)
        assert after.heading_bias_variance > motions[5].heading_bias_variance


def test_less_than_half_a_second_is_neither_still_nor_walking() -> None:
    samples = cut(walk(0.0, 0.0), 4.0)[0]
    few = samples.t < samples.t[0] + 2.3
    columns = (samples.t, samples.acceleration, samples.rotation, samples.field)
    motions = reckon([InertialSamples(*(c[few] for c in columns if c is not None))])
    assert [m.activity for m in motions] == ["still", "still", "other"]


def test_a_phone_put_elsewhere_begins_another_walk() -> None:
    samples, phone, reckoner = walk(0.0, 40.0), Walk("hand"), DeadReckoner(NORTH_UP)
    told = []
    for second, part in enumerate(cut(samples)):
        phone.carrying = "hand" if second < 20 else "pocket"
        told += reckoner.advance([phone], [part])[0]
    assert {m.walk for m in told if len(m.step_t) and m.t < 1e9 + 19.0} == {1}
    assert {m.walk for m in told if len(m.step_t) and m.t > 1e9 + 23.0} == {2}


def test_an_idle_phone_keeps_what_its_sensors_are_off_by() -> None:
    phone, reckoner = Walk("hand"), DeadReckoner(NORTH_UP)
    samples = walk(0.0)
    biased = InertialSamples(samples.t, samples.acceleration, np.full((len(samples.t), 3), 0.004), samples.field)
    reckoner.advance([phone], [biased])
    walking = phone.nbytes
    phone.rest()
    assert phone.nbytes < 0.1 * walking
    assert phone.calibration is not None
    np.testing.assert_allclose(phone.calibration.view(Calibration.STATE)["bias"][0], 0.004, atol=0.001)
    kept = phone.calibration.view(Calibration.STATE)["bias"][0, 2]
    reckoner.advance([phone], [cut(walk(0.0, start=1e9 + 500.0), 4.0)[0]])
    assert phone.record is not None
    begun = phone.record[: Calibration.STATE.itemsize].view(Calibration.STATE)
    assert begun["covariance"][0, 3, 3] < 0.1 * Calibration.BIAS_SIGMA**2
    assert kept > 0.003


def test_a_walkers_own_thresholds_are_used_by_the_detector_that_has_them() -> None:
    usual, deaf = Walk("hand"), Walk("hand", thresholds=(14.0, 13.9))
    steps = [
        np.concatenate([m.step_t for m in motions])
        for motions in DeadReckoner(0.0, detector="personal-thresholds").advance([usual, deaf], [walk(0.0), walk(0.0)])
    ]
    assert len(steps[0]) > 30
    assert len(steps[1]) == 0
    (gated,) = DeadReckoner(0.0).advance([Walk("hand", thresholds=(14.0, 13.9))], [walk(0.0)])
    assert len(steps_of(gated)) > 30


def test_a_phone_that_loses_its_compass_goes_on() -> None:
    parts = cut(walk(0.0))
    blind = [InertialSamples(p.t, p.acceleration, p.rotation, None) for p in parts[12:]]
    motions = reckon(parts[:12] + blind)
    assert len(steps_of(motions)) >= 35
    np.testing.assert_allclose(np.concatenate([m.heading for m in motions]), NORTH_UP, atol=0.02)


def test_a_persons_own_stride_is_used_from_when_it_is_known() -> None:
    own = StrideLine(np.array(0.4), np.array(0.1), np.array(0.03**2))
    lengths = np.concatenate([m.length for m in reckon(cut(walk(0.0)), phone=Walk("hand", own))])
    np.testing.assert_allclose(np.median(lengths), 0.4 * 1.9 + 0.1, rtol=0.03)


def test_one_phones_own_stride_is_not_anothers() -> None:
    own = StrideLine(np.array(0.4), np.array(0.1), np.array(0.03**2))
    phones = [Walk("hand"), Walk("hand", own)]
    told = DeadReckoner(0.0).advance(phones, [walk(0.0), walk(0.0)])
    usual, mine = (np.concatenate([m.length for m in motions]) for motions in told)
    assert np.median(mine) == pytest.approx(0.86, abs=0.03)
    np.testing.assert_allclose(usual, np.concatenate([m.length for m in reckon([walk(0.0)])])[: len(usual)], rtol=1e-6)


def test_a_walking_phone_is_small_and_can_be_put_away() -> None:
    samples, phone, reckoner = cut(walk(0.0, 60.0, rate=400.0)), Walk("unknown"), DeadReckoner(NORTH_UP)
    largest, told = 0, []
    for part in samples:
        told += reckoner.advance([phone], [part])[0]
        largest = max(largest, phone.nbytes, len(pickle.dumps(phone)))
        phone = pickle.loads(pickle.dumps(phone))
    assert largest < 200_000
    assert_same(told, reckon(samples, "unknown")[: len(told)], rtol=0, atol=0)


def test_no_phones_and_no_samples_are_nothing() -> None:
    reckoner = DeadReckoner(0.0)
    assert reckoner.advance([], []) == []
    nothing = InertialSamples(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), None)
    phone = Walk("hand")
    assert reckoner.advance([phone], [nothing]) == [[]]
    assert phone.nbytes == 0
