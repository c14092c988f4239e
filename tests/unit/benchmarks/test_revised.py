"""What was said live, and what was known of it a few seconds later."""

import numpy as np
import pytest
from track_frames import frame

from benchmarks.revised import NOTHING, UNSEEN, said_later, said_live
from shared.messages import Revision

T = np.arange(0.0, 10.0)
LIVE = [frame(t, {1: (t, 0.0), 2: (t, 5.0)}, {1: "a"}) for t in T.tolist()]


def revision(t: float, since: float, points: list[tuple[float, int, float, float]], device: str = "a") -> Revision:
    return Revision(
        t=t,
        area="hall",
        chunk=0,
        tracker="some",
        device=[device],
        since=[since],
        of=[0] * len(points),
        at=[point[0] for point in points],
        track=[point[1] for point in points],
        x=[point[2] for point in points],
        y=[point[3] for point in points],
        covariance=[(0.04, 0.0, 0.04)] * len(points),
        probability=[0.9] * len(points),
    )


def test_live_is_what_the_newest_frame_said() -> None:
    said = said_live(T + 0.5, ["a", "b"], LIVE)
    np.testing.assert_allclose(said.position[:, 0], np.column_stack([T, 0.0 * T]))
    assert (said.track[:, 0] == 1).all()
    assert np.isnan(said.position[:, 1]).all()
    assert (said.track[:, 1] == NOTHING).all()


def test_a_revision_replaces_what_was_said_between_its_two_times_and_nothing_else() -> None:
    moved = revision(6.0, 3.0, [(t, 2, t, 5.0) for t in (3.0, 4.0, 5.0, 6.0)])
    said = said_later(T, ["a"], LIVE, [moved], lag=5.0)
    assert said.track[:, 0].tolist() == [1, 1, 1, 2, 2, 2, 2, 1, 1, 1]
    np.testing.assert_allclose(said.position[3:7, 0, 1], 5.0)
    assert said.sigma[4, 0] == pytest.approx(0.2)
    assert said.probability[4, 0] == 0.9


def test_what_came_later_than_the_lag_was_not_known_yet() -> None:
    late = revision(8.0, 1.0, [(t, 2, t, 5.0) for t in np.arange(1.0, 9.0).tolist()])
    said = said_later(T, ["a"], LIVE, [late], lag=5.0)
    assert said.track[:, 0].tolist() == [1, 1, 1, 2, 2, 2, 2, 2, 2, 1]
    at_once = said_later(T, ["a"], LIVE, [late], lag=0.0)
    assert at_once.track[:, 0].tolist() == [1] * 8 + [2, 1]


def test_the_last_revision_has_the_last_word() -> None:
    first = revision(5.0, 2.0, [(t, 2, t, 5.0) for t in (2.0, 3.0, 4.0, 5.0)])
    second = revision(6.0, 4.0, [(t, 1, t, 0.0) for t in (4.0, 5.0, 6.0)])
    said = said_later(T, ["a"], LIVE, [first, second])
    assert said.track[:, 0].tolist() == [1, 1, 2, 2, 1, 1, 1, 1, 1, 1]


def test_a_device_revised_without_points_was_nowhere() -> None:
    said = said_later(T, ["a"], LIVE, [revision(5.0, 3.0, [])])
    assert said.track[:, 0].tolist() == [1, 1, 1, NOTHING, NOTHING, NOTHING, 1, 1, 1, 1]
    assert np.isnan(said.position[3:6]).all()


def test_places_are_interpolated_along_one_track_and_held_only_shortly_elsewhere() -> None:
    t = np.array([2.0, 2.5, 3.0, 3.25, 3.75, 4.0])
    points = [(2.0, 2, 0.0, 0.0), (3.0, 2, 2.0, 0.0), (4.0, UNSEEN, 9.0, 9.0)]
    said = said_later(t, ["a"], [], [revision(4.0, 2.0, points)])
    np.testing.assert_allclose(said.position[:, 0, 0], [0.0, 1.0, 2.0, 2.0, np.nan, 9.0])
    assert said.track[:, 0].tolist() == [2, 2, 2, 2, NOTHING, UNSEEN]


def test_revisions_of_strangers_change_nothing() -> None:
    said = said_later(T, ["a"], LIVE, [revision(5.0, 1.0, [], device="stranger")])
    assert (said.track == 1).all()
