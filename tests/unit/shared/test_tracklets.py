"""Tracklets: linked only where nothing else was possible."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from shared.tracklets import Tracklets, TrackletSettings, change_of_motion, grow_tracklets

Array = NDArray[np.float64]


def grown(*frames: list[tuple[float, float]], rate: float = 2.0, **changes: float) -> Tracklets:
    """Return the tracklets of frames at the study's two a second."""
    places = [np.array(frame, dtype=np.float64).reshape(-1, 2) for frame in frames]
    return grow_tracklets(np.arange(len(places)) / rate, places, TrackletSettings(**changes))


def lists(tracklets: Tracklets) -> list[list[int]]:
    return [tracklets[number].tolist() for number in range(len(tracklets))]


@pytest.mark.parametrize(
    ("before", "after", "quality"),
    [
        ((1.0, 0.0), (1.0, 0.0), 0.0),
        ((1.0, 0.0), (0.0, 1.0), 0.5),  # a right angle at the same speed: half of 1 - cos 90°
        ((1.0, 0.0), (-1.0, 0.0), 1.0),
        ((1.0, 0.0), (4.0, 0.0), 0.5 * (1.0 - 2.0 * 2.0 / 5.0)),
        ((3.0, 4.0), (4.0, 3.0), 0.5 * (1.0 - 24.0 / 25.0)),
        ((0.0, 0.0), (0.0, 0.0), 0.0),
        ((0.0, 0.0), (1.0, 0.0), 1.0),
    ],
)
def test_the_change_of_motion_worked_by_hand(
    before: tuple[float, float], after: tuple[float, float], quality: float
) -> None:
    assert change_of_motion(np.array(before), np.array(after)) == pytest.approx(quality)


def test_one_person_walking_straight_is_one_tracklet() -> None:
    assert lists(grown([(0, 0)], [(0.6, 0)], [(1.2, 0)], [(1.8, 0)])) == [[0, 1, 2, 3]]


def test_no_link_is_farther_than_somebody_walks() -> None:
    """At two frames a second and 2 m/s, DT is one metre."""
    assert lists(grown([(0, 0)], [(1.01, 0)])) == [[0], [1]]
    assert lists(grown([(0, 0)], [(0.99, 0)])) == [[0, 1]]


def test_two_possible_second_points_leave_the_first_alone() -> None:
    assert lists(grown([(0, 0)], [(0.6, 0), (0, 0.6)])) == [[0], [1], [2]]


def test_of_two_near_points_the_one_straight_on_is_the_only_one_possible() -> None:
    assert lists(grown([(0, 0)], [(0.6, 0)], [(1.2, 0), (0.6, 0.6)])) == [[0, 1, 2], [3]]


def test_a_sharp_turn_ends_a_tracklet_unless_it_is_hardly_a_move() -> None:
    assert lists(grown([(0, 0)], [(0.6, 0)], [(0, 0)])) == [[0, 1], [2]]
    assert lists(grown([(0, 0)], [(0.6, 0)], [(0.4, 0)])) == [[0, 1, 2]]


def test_who_stands_still_is_one_tracklet() -> None:
    rng = np.random.default_rng(0)
    places = [np.array([[3.0, 3.0]]) + rng.normal(0, 0.04, 2) for _ in range(20)]
    assert len(grow_tracklets(np.arange(20) / 2.0, places)) == 1


def test_a_merge_breaks_both() -> None:
    """Two people walk into one detection, and out of it again: nobody can say who is who."""
    tracklets = grown(
        [(0, 1.6), (0, -1.6)],
        [(0.5, 0.8), (0.5, -0.8)],
        [(1.0, 0.0)],
        [(1.5, 0.8), (1.5, -0.8)],
        [(2.0, 1.6), (2.0, -1.6)],
    )
    assert lists(tracklets) == [[0, 2], [1, 3], [4], [5, 7], [6, 8]]


def test_two_who_want_one_detection_get_none_even_if_one_has_another() -> None:
    """The left one could be either detection, so the right one's only one is in doubt too."""
    assert lists(grown([(0, 0), (1.4, 0)], [(0, 0.5), (0.7, 0)])) == [[0], [1], [2], [3]]


def test_a_frame_without_anybody_ends_tracklets() -> None:
    assert lists(grown([(0, 0)], [], [(0, 0)])) == [[0], [1]]


def test_a_long_silence_ends_tracklets() -> None:
    places = [np.array([[0.0, 0.0]]), np.array([[0.1, 0.0]])]
    assert len(grow_tracklets(np.array([0.0, 3.0]), places)) == 2


def test_uneven_frames_compare_speeds_not_lengths() -> None:
    places = [np.array([[x, 0.0]]) for x in (0.0, 0.6, 2.4)]
    assert len(grow_tracklets(np.array([0.0, 0.5, 2.0]), places, TrackletSettings(threshold=0.01))) == 1


RATES = pytest.mark.parametrize("rate", [2.0, 7.5, 15.0, 30.0])


def noisy(way: Array, seed: int = 0) -> list[Array]:
    """Return one person's (n, 2) way as frames of a detector that errs by a decimetre."""
    errs = np.random.default_rng(seed).normal(0.0, 0.1, way.shape)
    return list((way + errs)[:, None])


@RATES
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_lone_walker_seen_with_noise_is_hardly_ever_broken(rate: float, seed: int) -> None:
    t = np.arange(int(20 * rate)) / rate
    assert len(grow_tracklets(t, noisy(np.column_stack([1.2 * t, 0.0 * t]), seed))) <= 2


@RATES
def test_who_turns_back_is_broken_there_at_any_rate(rate: float) -> None:
    t = np.arange(int(8 * rate)) / rate
    way = np.column_stack([1.4 * np.minimum(t, 8.0 - t), 0.0 * t])
    tracklets = grow_tracklets(t, noisy(way))
    first = tracklets[0]
    assert 4.0 <= t[first[-1]] < 4.6
    assert 2 <= len(tracklets) <= 4


@RATES
def test_people_who_merge_are_both_broken_at_any_rate(rate: float) -> None:
    """They come near each other, are one detection for a second, and part again."""
    t = np.arange(int(8 * rate)) / rate
    aside = np.maximum(np.abs(t - 4.0) - 0.5, 0.0)
    ways = np.stack([np.column_stack([0.7 * t, side * aside]) for side in (1.0, -1.0)], axis=1)
    places = [two if off > 0.0 else two[:1] for two, off in zip(ways, aside, strict=True)]
    tracklets = grow_tracklets(t, places)
    when = np.repeat(t, [len(found) for found in places])
    for number in range(len(tracklets)):
        assert not when[tracklets[number][0]] < 3.5 < 4.5 < when[tracklets[number][-1]]
    assert len(tracklets[0]) > 0.6 * 3.5 * rate


def test_a_frame_twice_a_second_gives_nothing_away_to_noise() -> None:
    """There the sheet's rule holds to the letter."""
    assert TrackletSettings().reach(0.5) == 1.0
    assert TrackletSettings().hardly(0.5) == TrackletSettings().still


def test_nothing_seen_is_no_tracklet() -> None:
    assert lists(grown()) == []
    assert lists(grown([], [])) == []


def test_frames_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="increase"):
        grow_tracklets(np.array([0.0, 0.0]), [np.zeros((1, 2)), np.zeros((1, 2))])
    with pytest.raises(ValueError, match="times"):
        grow_tracklets(np.array([0.0]), [])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), people=st.integers(0, 8), rate=st.sampled_from([1.0, 2.0, 7.0]))
def test_every_detection_is_in_one_tracklet_and_no_link_could_have_been_another(
    seed: int, people: int, rate: float
) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.8, 1.2, 12)) / rate
    start, velocity = rng.uniform(0, 8, (people, 2)), rng.normal(0, 0.7, (people, 2))
    places = [(start + at * velocity + rng.normal(0, 0.05, start.shape))[rng.random(people) < 0.8] for at in (t - t[0])]
    tracklets = grow_tracklets(t, places)
    everything = np.concatenate([*places, np.zeros((0, 2))])
    frame = np.repeat(np.arange(len(t)), [len(found) for found in places])
    assert sorted(tracklets.members.tolist()) == list(range(len(everything)))
    for number in range(len(tracklets)):
        members = tracklets[number]
        assert (tracklets.tracklet[members] == number).all()
        assert (np.diff(frame[members]) == 1).all()
        for one, two in pairwise(members):
            reach = TrackletSettings().reach(float(t[frame[two]] - t[frame[one]]))
            assert np.linalg.norm(everything[two] - everything[one]) < reach
            if one == members[0]:
                assert (np.linalg.norm(places[frame[two]] - everything[one], axis=1) < reach).sum() == 1


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_order_of_detections_in_a_frame_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = [rng.uniform(0, 4, (5, 2)) for _ in range(6)]
    orders = [rng.permutation(5) for _ in places]
    t = np.arange(6) / 2.0
    straight = grow_tracklets(t, places).tracklet
    mixed = grow_tracklets(t, [found[order] for found, order in zip(places, orders, strict=True)]).tracklet
    numbers = np.concatenate([order + 5 * frame for frame, order in enumerate(orders)])
    pairs = set(zip(straight[numbers].tolist(), mixed.tolist(), strict=True))
    assert len(pairs) == straight.max() + 1
