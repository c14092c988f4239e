"""Probability that flows between tracks and the floor."""

from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_view
from numpy.typing import NDArray

from services.fusion.evidence.belief import SLOTS, UNSEEN, Beliefs, Flow
from services.fusion.evidence.floor_grid import FloorGrid

NONE = np.zeros(0, np.int64)
ROW = np.zeros(1, np.int64)


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> FloorGrid:
    return FloorGrid(make_view(tmp_path_factory.mktemp("site")))


def beliefs(grid: FloorGrid, columns: int = 3) -> Beliefs:
    made = Beliefs(grid, Flow())
    made.resize(1, columns)
    made.open(0, NONE)
    return made


def whole(made: Beliefs) -> float:
    return float(made.share[0].sum() + made.floor[0].sum() + made.far[0])


def mean(made: Beliefs) -> NDArray[np.float64]:
    floor = made.floor[0].ravel()
    found: NDArray[np.float64] = (floor / floor.sum()) @ made.grid.centres + made.rest[0]
    return found


def on_a_track(grid: FloorGrid, place: NDArray[np.float64]) -> Beliefs:
    made = beliefs(grid)
    made.begin(0, place, ROW, 3)
    made.favour(0, np.array([0]), np.array([12.0]))
    made.remember(100, np.array([7, 0, 0]))
    return made


def test_a_lost_track_is_carried_on_by_steps_and_taken_up_where_they_lead(grid: FloorGrid) -> None:
    lost = np.array([8.0, 6.0])
    made = on_a_track(grid, lost)
    made.end(0, lost, ROW)
    assert mean(made) == pytest.approx(lost, abs=0.1)
    for _ in range(5):
        made.walk(0, np.array([0.9, 0.3]), 0.05)
    there = lost + 5 * np.array([0.9, 0.3])
    assert mean(made) == pytest.approx(there, abs=0.3)
    made.remember(110, np.array([7, 0, 0]))
    made.begin(1, there, ROW, 3)
    made.begin(2, lost, ROW, 3)
    assert made.share[0, 1] > 0.6
    assert made.share[0, 2] < 0.05
    assert made.lineage[0, 1, 100 % SLOTS] == 7
    assert made.lineage[0, 1, 110 % SLOTS] == UNSEEN
    assert whole(made) == pytest.approx(1.0)


def test_a_stranger_born_far_from_a_device_gets_next_to_nothing(grid: FloorGrid) -> None:
    made = on_a_track(grid, np.array([8.0, 6.0]))
    made.begin(1, np.array([18.0, 10.0]), ROW, 3)
    assert made.share[0, 1] < 1e-3
    assert made.share[0, 0] > 0.98


def test_tracks_that_meet_may_exchange_persons_and_remember_whose_they_were(grid: FloorGrid) -> None:
    place = np.array([8.0, 6.0])
    made = on_a_track(grid, place)
    made.begin(1, place + 0.3, ROW, 3)
    still = np.zeros(2, np.bool_)
    for slot in range(101, 106):
        made.remember(slot, np.array([7, 9, 0]))
        made.pass_time(
            ROW, np.array([0, 1]), np.array([place, place + 0.3]), still, np.ones(1), np.ones(1, np.bool_), 0.25
        )
    assert 0.03 < made.share[0, 1] < made.share[0, 0]
    assert made.lineage[0, 1, 100 % SLOTS] == 7
    assert whole(made) == pytest.approx(1.0)


def test_who_is_not_seen_where_cameras_look_is_rather_elsewhere(grid: FloorGrid) -> None:
    made = beliefs(grid)
    before = float(made.floor[0][grid.viewed].sum())
    for _ in range(20):
        made.pass_time(ROW, NONE, np.zeros((0, 2)), np.zeros(0, np.bool_), np.ones(1), np.ones(1, np.bool_), 0.5)
    assert made.floor[0][grid.viewed].sum() < 0.1 * before
    assert whole(made) == pytest.approx(1.0)


def test_who_walks_off_the_floor_is_far_and_may_come_back(grid: FloorGrid) -> None:
    made = on_a_track(grid, np.array([22.0, 6.0]))
    made.end(0, np.array([22.0, 6.0]), ROW)
    for _ in range(10):
        made.walk(0, np.array([1.5, 0.0]), 0.05)
    assert made.far[0] > 0.5
    assert np.isfinite(made.floor).all()


def test_shifts_move_by_whole_cells_and_keep_the_rest(grid: FloorGrid) -> None:
    made = on_a_track(grid, np.array([10.0, 6.0]))
    made.end(0, np.array([10.0, 6.0]), ROW)
    start = mean(made)
    for _ in range(8):
        made.walk(0, np.array([0.11, -0.07]), 0.0)
    assert mean(made) - start == pytest.approx([0.88, -0.56], abs=0.02)


def test_a_grid_covers_floor_and_margin(tmp_path: Path) -> None:
    view = make_view(tmp_path)
    made = FloorGrid(view)
    corners = np.array([view.lower, view.upper])
    assert made.cells_at(corners + 99.0).max() == made.shape[0] * made.shape[1] - 1
    assert made.kernel(np.array([12.0, 7.0]), 0.7).sum() * made.cell**2 == pytest.approx(1.0, abs=0.01)
    assert made.viewed.sum() < made.open.sum()


def test_a_wide_floor_hides_no_more_strangers_than_cameras_follow(grid: FloorGrid) -> None:
    sparse, dense = Beliefs(grid, Flow(stranger_density=1e-4)), Beliefs(grid, Flow(stranger_density=1.0))
    area = float((grid.open & ~grid.outside).sum()) * grid.cell**2
    assert sparse.strangers(5) == 1e-4
    assert dense.strangers(5) * area == pytest.approx(6.0)
