"""What people walk round, the forces of the identity filter learn to walk round too."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import frame, make_view
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.forces import walkable_share
from services.fusion.rbmcda.learned_obstacles import REBUILD, LearnedObstacles
from services.fusion.registry import make_tracker
from services.fusion.snapshot import encode_snapshot
from services.fusion.tracker import Chunk

Array = NDArray[np.float64]
ACROSS = np.array([[11.0, 7.0]]), np.array([[15.0, 7.0]])


@pytest.fixture
def view(tmp_path: Path) -> AreaView:
    return make_view(tmp_path)


def around() -> Array:
    """Return (n, 2) places all over the middle of the hall, none on a stand of 2 m x 2 m."""
    x, y = np.meshgrid(np.arange(9.25, 17.0, 0.5), np.arange(4.25, 10.0, 0.5))
    places: Array = np.column_stack([x.ravel(), y.ravel()])
    beside: Array = places[(np.abs(places - [13.0, 7.0]) > 1.0).any(axis=1)]
    return beside


def learned(view: AreaView, seconds: float) -> LearnedObstacles:
    obstacles = LearnedObstacles(view)
    for t in np.arange(100.0, 100.0 + seconds, 3.0):
        obstacles.add(float(t), around())
    return obstacles


def test_a_stand_nobody_told_of_comes_to_block(view: AreaView) -> None:
    assert walkable_share(*ACROSS, learned(view, 30.0).obstacles)[0] == 1.0
    assert walkable_share(*ACROSS, learned(view, 130.0).obstacles)[0] == pytest.approx(0.25)


def test_obstacles_are_looked_at_once_a_minute(view: AreaView) -> None:
    one = LearnedObstacles(view)
    first, changes = one.obstacles, []
    for t in np.arange(100.0, 300.0, 3.0):
        one.add(float(t), around())
        if one.obstacles is not first:
            first = one.obstacles
            changes.append(float(t))
    assert len(changes) >= 1
    assert all((t - 100.0) % REBUILD == 0.0 for t in changes)


def test_a_restored_one_goes_on_as_the_one_it_was_taken_from(view: AreaView) -> None:
    """Taken between two looks: what blocks is of the look before, what was counted since is not lost."""
    one, other = learned(view, 145.0), LearnedObstacles(view)
    other.restore(msgspec.json.decode(encode_snapshot(one.state())))
    assert encode_snapshot(other.state()) == encode_snapshot(one.state())
    for t in (246.0, 270.0, 320.0):
        for each in (one, other):
            each.add(t, around())
        assert encode_snapshot(other.state()) == encode_snapshot(one.state())
        np.testing.assert_array_equal(other.obstacles.lines, one.obstacles.lines)


def test_a_clock_set_back_starts_anew(view: AreaView) -> None:
    one = learned(view, 130.0)
    one.add(50.0, around())
    assert walkable_share(*ACROSS, one.obstacles)[0] == 1.0


def test_a_state_of_another_floor_is_refused(view: AreaView) -> None:
    state = msgspec.json.decode(encode_snapshot(learned(view, 10.0).state()))
    with pytest.raises(ValueError, match="map of"):
        LearnedObstacles(view).restore({**state, "lower": [0.0, 0.0]})


def test_the_forced_filter_feeds_its_map_with_whom_it_follows(view: AreaView) -> None:
    """Somebody who walks is counted; a detection that only one cycle shows is nobody."""
    tracker = make_tracker("rbmcda-forces", view, seed=0)
    for number in range(12):
        frames = []
        for t in 100.0 + number + 0.2 * np.arange(5):
            flicker = [(20.0, 4.0)] if t == 105.8 else []
            frames.append(frame(float(t), [(8.0 + 0.8 * (t - 100.0), 7.0), *flicker]))
        tracker.step(Chunk(number, 100.0 + number, 101.0 + number, tuple(frames)))
    other = LearnedObstacles(view)
    other.restore(msgspec.json.decode(tracker.state())["learned"])
    visits = np.array(other._map.state()["visits"])
    column, row = ((np.array([20.0, 4.0]) - view.lower) / 0.5).astype(int)
    assert visits.sum() == pytest.approx(11.0, abs=0.5)
    assert visits[row, column] == 0.0
