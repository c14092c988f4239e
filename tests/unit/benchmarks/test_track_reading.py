"""What tracks are taken to say of each person, on worlds small enough to see the answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from track_frames import frame

from benchmarks.track_reading import matched_positions, named_positions, newest_frames
from benchmarks.world_record import Truth


def world(n: int, *x: float, devices: tuple[str | None, ...] | None = None) -> Truth:
    """People standing on the x axis for n seconds, all in view, all with phones unless told."""
    position = np.broadcast_to(np.array([[place, 0.0] for place in x]), (n, len(x), 2)).copy()
    names = [f"p{number}" for number in range(len(x))]
    return Truth(np.arange(n) * 1.0, names, devices or names, position, np.ones((n, len(x)), np.bool_))


def test_a_name_says_where_its_device_is_until_the_next_frame_says_otherwise() -> None:
    frames = [frame(0.5, {1: (3, 1)}, {1: "p0"}), frame(2.5, {1: (4, 1)}), frame(3.0, {2: (5, 1)}, {2: "p0"})]
    said = named_positions(world(7, 0.0), frames, fresh=2.0)[:, 0, 0]
    assert_array_equal(said, [np.nan, 3, 3, 5, 5, 5, np.nan])


def test_a_frame_of_the_future_says_nothing_of_now() -> None:
    assert_array_equal(newest_frames(np.array([0.9, 1.0]), [frame(1.0, {})]), [-1, 0])
    assert_array_equal(newest_frames(np.array([0.9, 1.0]), []), [-1, -1])


def test_of_two_tracks_with_one_name_the_most_probable_counts() -> None:
    said = named_positions(world(1, 0.0), [frame(0, {5: (5, 0), 1: (1, 0), 7: (7, 0)}, {5: "p0", 1: "p0", 7: "p0"})])
    assert_allclose(said[0, 0], [1, 0])


def test_each_window_is_matched_anew_and_one_track_serves_one_person() -> None:
    frames = [frame(t, {1: (0.4, 0), 2: (9.0, 0)} if t < 2 else {1: (9.0, 0), 2: (0.4, 0)}) for t in range(4)]
    said = matched_positions(world(4, 0.0, 10.0), frames, window=2.0)[:, :, 0]
    assert_allclose(said, [[0.4, 9.0]] * 4)


def test_a_stranger_keeps_the_track_that_is_theirs() -> None:
    truth = world(2, 0.0, 1.0, devices=(None, "d"))
    frames = [frame(t, {1: (0.2, 0), 2: (5.0, 0)}) for t in range(2)]
    assert_allclose(matched_positions(truth, frames)[:, 0, 0], [5.0, 5.0])


def test_a_matched_track_is_held_at_its_nearest_time_but_not_beyond_the_window() -> None:
    frames = [frame(1, {1: (1, 0)}), frame(2, {1: (2, 0)}), frame(4, {1: (4, 0)})]
    said = matched_positions(world(10, 0.0), frames, window=5.0)[:, 0, 0]
    assert_array_equal(said, [1, 1, 2, 2, 4, *[np.nan] * 5])


def test_who_is_left_without_a_track_gets_nothing() -> None:
    said = matched_positions(world(1, 0.0, 3.0), [frame(0, {1: (2.5, 0)})])[0, :, 0]
    assert_array_equal(said, [np.nan, 2.5])


def test_nobody_in_view_or_no_track_is_no_error() -> None:
    truth = world(3, 0.0)
    assert np.isnan(matched_positions(truth, [frame(0, {})])).all()
    truth.in_view[:] = False
    assert np.isnan(matched_positions(truth, [frame(0, {1: (0, 0)})])).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_other_assignment_of_tracks_to_people_has_a_smaller_error(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = world(4, *random.uniform(0, 5, 3))
    frames = [frame(t, {track: tuple(random.uniform(0, 5, 2)) for track in range(3)}) for t in range(4)]
    found = ((matched_positions(truth, frames) - truth.position) ** 2).sum()
    places = np.array([[[f.x[track], f.y[track]] for track in range(3)] for f in frames])
    for order in ([0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]):
        assert found <= ((places[:, order] - truth.position) ** 2).sum() + 1e-9


def test_a_window_without_length_is_refused() -> None:
    with pytest.raises(ValueError, match="window: -1"):
        matched_positions(world(1, 0.0), [], window=-1.0)
