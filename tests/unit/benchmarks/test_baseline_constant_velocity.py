"""Sight alone with one guess: global nearest neighbour."""

from dataclasses import replace

import numpy as np
import pytest
from baseline_world import SmallWorld, sighted
from filterpy.kalman import KalmanFilter

from benchmarks.baselines.anonymous_tracks import AnonymousTracks
from benchmarks.baselines.constant_velocity import ConstantVelocityParameters, follow, track
from benchmarks.baselines.sightings import Sightings

CHOSEN = ConstantVelocityParameters()


def frames_of(t, *people, sigma=0.25):
    """One frame per time; people are (n, 2), NaN while not detected."""
    return [
        sighted(float(now), [person[i] for person in people if np.isfinite(person[i]).all()], sigma)
        for i, now in enumerate(t)
    ]


def line(t, start, velocity):
    return np.asarray(start, float) + np.asarray(t)[:, None] * np.asarray(velocity, float)


def who_is_at(tracks, place, position):
    rows = tracks.at(place)
    return min(rows, key=lambda row: np.hypot(row[1] - position[0], row[2] - position[1]))[0]


def test_one_person_s_track_is_the_textbook_filter_s():
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.2, 0.6, 40))
    person = line(t, (1.0, 2.0), (0.5, 0.1)) + rng.normal(0.0, 0.1, (40, 2))
    tracks = follow(Sightings.of(frames_of(t, person)), t)
    oracle = KalmanFilter(dim_x=4, dim_z=2)
    oracle.x = np.array([*person[0], 0.0, 0.0])
    oracle.P = np.diag([0.0625, 0.0625, 1.0, 1.0])
    oracle.H = np.eye(2, 4)
    oracle.R = 0.0625 * np.eye(2)
    for i in range(1, 40):
        dt = t[i] - t[i - 1]
        oracle.F = np.eye(4) + dt * np.eye(4, k=2)
        block = 0.36 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        oracle.Q = np.kron(block, np.eye(2))
        oracle.predict()
        oracle.update(person[i])
        if i >= CHOSEN.confirm - 1:
            ((_, x, y),) = tracks.at(i)
            np.testing.assert_allclose([x, y], oracle.x[:2], atol=1e-9)
    assert tracks.when[0] == CHOSEN.confirm - 1


def test_two_who_walk_past_each_other_keep_their_tracks():
    t = np.arange(0.0, 10.0, 0.5)
    one, two = line(t, (0.0, 3.0), (1.0, 0.0)), line(t, (9.5, 4.0), (-1.0, 0.0))
    tracks = follow(Sightings.of(frames_of(t, one, two)), t)
    assert set(tracks.track.tolist()) == {0, 1}
    assert who_is_at(tracks, 5, one[5]) == who_is_at(tracks, 19, one[19])


def test_the_best_assignment_of_all_counts_not_the_nearest_pair():
    t = np.arange(0.0, 4.0, 0.5)
    behind, ahead = np.zeros((8, 2)), np.tile([1.0, 0.0], (8, 1))
    behind[7], ahead[7] = (0.55, 0.0), (1.5, 0.0)  # who was ahead was nearer to where the other is now
    tracks = follow(Sightings.of(frames_of(t, behind, ahead)), t)
    assert who_is_at(tracks, 7, behind[7]) == who_is_at(tracks, 6, behind[6])
    assert who_is_at(tracks, 7, ahead[7]) == who_is_at(tracks, 6, ahead[6])


def test_likelihood_decides_not_the_distance_in_sigmas_which_would_favour_who_was_not_seen_for_long():
    t = np.arange(0.0, 6.0, 0.5)
    steady, lost = np.zeros((12, 2)), np.tile([3.0, 0.0], (12, 1))
    lost[8:] = np.nan
    steady[11] = 0.9, 0.0
    tracks = follow(Sightings.of(frames_of(t, steady, lost)), t)
    places = {who: x for who, x, _ in tracks.at(11)}
    assert places[who_is_at(tracks, 6, (0.0, 0.0))] > 0.3
    assert places[who_is_at(tracks, 6, (3.0, 0.0))] == pytest.approx(3.0, abs=0.1)


def test_who_appears_far_from_where_somebody_vanished_is_somebody_else():
    t = np.arange(0.0, 10.0, 0.5)
    person = np.where(t[:, None] < 5.0, [2.0, 2.0], [8.0, 2.0])
    tracks = follow(Sightings.of(frames_of(t, person)), t)
    assert who_is_at(tracks, 9, (2.0, 2.0)) != who_is_at(tracks, 19, (8.0, 2.0))


def test_two_who_meet_and_turn_back_are_swapped_which_is_the_method_s_weakness():
    t = np.arange(0.0, 10.0, 0.5)
    out = np.minimum(t, 9.5 - t)
    one = np.stack([out, np.full(20, 3.9)], axis=1)
    two = np.stack([9.5 - out, np.full(20, 4.1)], axis=1)
    tracks = follow(Sightings.of(frames_of(t, one, two)), t)
    assert who_is_at(tracks, 6, one[6]) != who_is_at(tracks, 19, one[19])
    assert who_is_at(tracks, 6, one[6]) == who_is_at(tracks, 19, two[19])


def test_false_detections_rarely_become_tracks():
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 120.0, 1.0 / 30.0)
    frames = [sighted(float(now), rng.uniform(0, 10, (rng.poisson(0.5), 2))) for now in t]
    tracks = follow(Sightings.of(frames), t)
    assert len(np.unique(tracks.track)) < 5  # of some 1800 false detections


def test_somebody_unseen_is_carried_on_for_a_while_and_then_let_go():
    t = np.arange(0.0, 12.0, 0.5)
    person = line(t, (0.0, 5.0), (0.8, 0.0))
    hidden = person.copy()
    hidden[10:13] = np.nan
    hidden[18:] = np.nan
    tracks = follow(Sightings.of(frames_of(t, hidden)), t)
    assert set(tracks.track.tolist()) == {0}
    there = np.isin(np.arange(24), tracks.when)
    seen_last = 17
    assert there[2 : seen_last + 5].all()
    assert not there[seen_last + 5 :].any()
    places = {when: tracks.at(when)[0][1:] for when in range(2, seen_last + 5)}
    np.testing.assert_allclose(places[12], person[12], atol=0.2)
    np.testing.assert_allclose(places[20], person[20], atol=0.2)


def test_times_between_frames_and_after_the_last_are_answered_from_what_came_before():
    t = np.arange(0.0, 5.0, 0.5)
    person = line(t, (0.0, 5.0), (1.0, 0.0))
    times = np.array([-1.0, 0.9, 1.0, 1.25, 4.5, 6.0, 6.6])
    tracks = follow(Sightings.of(frames_of(t, person)), times)
    assert [len(tracks.at(i)) for i in range(7)] == [0, 0, 1, 1, 1, 1, 0]
    assert tracks.at(3)[0][1] == pytest.approx(1.25, abs=0.15)
    assert tracks.at(5)[0][1] == pytest.approx(6.0, abs=0.1)


def test_what_is_seen_later_changes_nothing_before():
    record = SmallWorld(seed=2, duration=60.0).record()
    times = np.arange(0.0, 40.0, 0.7)
    whole, first = track(record, times), track(replace(record, frames=record.frames[:40]), times)
    np.testing.assert_array_equal(whole.position, first.position)
    np.testing.assert_array_equal(whole.track, first.track)
    assert len(whole.track) > 100


def test_a_camera_that_does_not_look_there_ends_no_young_track():
    t = np.arange(0.0, 4.0, 0.5)
    west = frames_of(t, line(t, (1.0, 1.0), (0.5, 0.0)))
    east = [replace_camera(sighted(float(now) + 0.1, []), "east") for now in t]
    assert len(follow(Sightings.of([*west, *east]), t).track) == len(t) - 2


def replace_camera(frame, camera):
    return type(frame)(t=frame.t, camera=camera, floor=frame.floor, seq=frame.seq)


def test_thinning_keeps_each_camera_s_every_so_many_frames_whole():
    t = np.arange(90) / 30.0
    frames = frames_of(t, line(t, (0.0, 0.0), (1.0, 0.0)), line(t, (0.0, 5.0), (1.0, 0.0)))
    thinned = Sightings.of(frames).thinned(2.0)
    np.testing.assert_allclose(thinned.t, np.arange(0.0, 3.0, 0.5), atol=1e-9)
    np.testing.assert_allclose(thinned.position[::2, 0], thinned.t, atol=1e-9)
    assert thinned.start.tolist() == [0, 2, 4, 6, 8, 10, 12]
    assert len(Sightings.of(frames).thinned(30.0).t) == 90
    with pytest.raises(ValueError, match="frames_per_s: 0"):
        thinned.thinned(0.0)


def test_detections_become_columns_sorted_by_time_with_their_covariance():
    late, early = sighted(2.0, [(1.0, 2.0)], 0.5), sighted(1.0, [])
    late = type(late)(
        t=2.0, camera="b", floor="ground", seq=0, x=[1.0], y=[2.0], covariance=[(0.3, 0.1, 0.2)], confidence=[1.0],
        box=[(0.0, 0.0, 1.0, 1.0)],
    )  # fmt: skip
    sightings = Sightings.of([late, early])
    assert sightings.t.tolist() == [1.0, 2.0]
    assert sightings.start.tolist() == [0, 0, 1]
    assert sightings.noise.tolist() == [[[0.3, 0.1], [0.1, 0.2]]]
    assert Sightings.of([]).position.shape == (0, 2)


def test_tracks_are_published_as_they_are():
    tracks = AnonymousTracks(
        t=np.array([1.0, 2.0, 3.0]),
        when=np.array([0, 2, 2]),
        track=np.array([7, 7, 9]),
        position=np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
    )
    first, second, third = tracks.frames("yard", "ground")
    assert (first.t, first.track, first.x, first.y) == (1.0, [7], [1.0], [2.0])
    assert second.track == []
    assert (third.track, third.x, third.y, third.device) == ([7, 9], [3.0, 5.0], [4.0, 6.0], [None, None])
    ids, places = tracks.between(1, 3)
    assert ids.tolist() == [7, 9]
    assert np.isnan(places[0]).all()
    assert places[1].tolist() == [[3.0, 4.0], [5.0, 6.0]]


def test_unusable_settings_and_times_are_refused():
    with pytest.raises(ValueError, match="gate: 0"):
        ConstantVelocityParameters(gate=0.0)
    with pytest.raises(ValueError, match="times"):
        follow(Sightings.of([]), np.array([2.0, 1.0]))
