"""Maps learned as people walk: bounded, fading, saved and read again, and never surer than what was seen."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from services.learning.maps import AreaMaps
from services.learning.maps.area_maps import HALF_LIFE
from shared.radio.path_loss import PathLoss
from shared.radio.radio_model import RadioModel
from shared.radio.shadowing_map import ShadowingMap
from shared.site import load_site

HALL = shapely.box(0.0, 0.0, 10.0, 8.0)
WATCHED = [[(0.0, 0.0), (7.0, 0.0), (7.0, 8.0), (0.0, 8.0)]]
PILLAR = shapely.box(3.0, 3.0, 4.5, 4.5)
RADIO = PathLoss(
    ("ap-1", "ap-2"), np.array([[0.0, 0.0, 2.5], [10.0, 8.0, 2.5]]), np.array([-40.0, -42.0]), np.full(2, 2.2)
)


def empty() -> AreaMaps:
    return AreaMaps("hall", HALL, WATCHED, RADIO)


def walked(people: int = 200, seed: int = 0) -> AreaMaps:
    """People cross the watched part of the hall in five seconds each, round a pillar."""
    rng = np.random.default_rng(seed)
    maps = empty()
    for number in range(people):
        ways = [np.linspace(*rng.uniform((0.0, 0.0), (7.0, 8.0), (2, 2)), 26) for _ in range(4)]
        for step in range(26):
            places = np.array([way[step] for way in ways])
            places = places[~shapely.contains_xy(PILLAR, places[:, 0], places[:, 1])]
            maps.look(5.2 * number + 0.2 * step, places)
    return maps


@pytest.fixture(scope="module")
def hall() -> AreaMaps:
    return walked()


def values(maps: AreaMaps, kind: str) -> np.ndarray:
    grid = maps.grid(kind)  # type: ignore[arg-type]
    assert grid is not None
    return np.array([[math.nan if value is None else value for value in row] for row in grid.rows])


def test_before_anybody_was_there_no_map_says_anything() -> None:
    maps = empty()
    assert [maps.grid(kind) for kind in ("visits", "occlusion", "magnetic")] == [None, None, None]
    assert maps.grid("shadowing", None, "ap-1") is None


def test_the_pillar_is_blocked_and_what_no_camera_watches_is_unknown(hall: AreaMaps) -> None:
    seen = values(hall, "occlusion")
    assert (seen[6:9, 6:9] == 1.0).all()
    assert np.nansum(seen) == 9.0
    assert np.isnan(seen[:, 14:]).all()
    visits = values(hall, "visits")
    assert np.isnan(visits[:, 14:]).all()
    assert visits[7, 3] > 10.0
    assert visits[7, 7] == 0.0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**16), st.integers(1, 60))
def test_a_cell_visited_like_its_neighbours_is_never_blocked(seed: int, frames: int) -> None:
    rng = np.random.default_rng(seed)
    maps = empty()
    places = rng.uniform((0.0, 0.0), (7.0, 8.0), (40, 2))
    for frame in range(frames):
        maps.look(3.0 * frame, places)
    column, row = np.floor(places / 0.5).astype(int).T
    assert not maps.blocked()[row, column].any()


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 6.0), st.floats(0.5, 7.0), st.integers(10, 400))
def test_without_traffic_around_nothing_is_blocked(x: float, y: float, frames: int) -> None:
    """One person who walks on the spot for ever says nothing of the rest of the hall."""
    maps = empty()
    for frame in range(frames):
        maps.look(3.0 * frame, np.array([[x, y]]))
    blocked = maps.blocked()
    near = np.zeros_like(blocked)
    row, column = int(y / 0.5), int(x / 0.5)
    near[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = True
    assert not (blocked & ~near).any()


def test_what_is_not_seen_again_fades(hall: AreaMaps) -> None:
    maps = empty()
    maps.restore(hall.state())
    before = maps._visits.visits.sum()
    last = maps.state()["t"]
    maps.look(last + HALF_LIFE, np.zeros((0, 2)))
    assert maps._visits.visits.sum() == pytest.approx(0.5 * before)
    for week in range(30):
        maps.look(last + HALF_LIFE + (week + 1) * 7 * 86400.0, np.zeros((0, 2)))
    assert maps.grid("occlusion") is None


def test_a_clock_that_jumps_wipes_nothing_out() -> None:
    maps = walked(40)
    before, last = maps._visits.visits.sum(), maps.state()["t"]
    maps.look(last - 1e6, np.array([[1.0, 1.0]]))
    assert maps._visits.visits.sum() >= before
    maps.look(last + 1e9, np.zeros((0, 2)))
    assert maps._visits.visits.sum() > 0.15 * before


def test_the_state_is_json_of_a_bounded_size_and_goes_on_where_it_was(hall: AreaMaps) -> None:
    text = json.dumps(hall.state())
    again = empty()
    again.restore(json.loads(text))
    assert json.dumps(again.state()) == text
    assert len(text) < 60 * 20 * 16 * 2
    for maps in (hall, again):
        maps.look(2000.0, np.array([[1.0, 1.0], [2.0, 2.0]]))
    assert json.dumps(again.state()) == json.dumps(hall.state())


@pytest.mark.parametrize("spoilt", [{}, {"looked": [[1.0]]}, {"visits": {}}, {"magnetic": None}, {"clock": "soon"}])
def test_a_strange_state_is_refused_and_changes_nothing(hall: AreaMaps, spoilt: dict[str, object]) -> None:
    state = hall.state() | spoilt if spoilt else {}
    maps = empty()
    with pytest.raises(ValueError, match=r"map|state|float|cells"):
        maps.restore(state)
    assert maps.state() == empty().state()


def test_the_magnetic_map_is_of_places_and_not_of_phones() -> None:
    """Iron beside one wall, and three phones that read 8 µT too much, just right and 8 µT too little."""
    rng = np.random.default_rng(1)
    maps = empty()

    def field(places: np.ndarray) -> np.ndarray:
        return 48.0 + 20.0 * np.exp(-places[:, 0])

    for walk in range(300):
        places = np.linspace(*rng.uniform((0.0, 0.0), (10.0, 8.0), (2, 2)), 20)
        strength = field(places) + (0.0, 8.0, -8.0)[walk % 3] + rng.normal(0.0, 1.0, 20)
        maps.learn(places, np.where(rng.random(20) < 0.1, np.nan, strength))
    learned = values(maps, "magnetic")
    known = np.isfinite(learned)
    assert known.mean() > 0.9
    error = (learned - field(maps._centres.reshape(-1, 2)).reshape(learned.shape))[known]
    assert np.std(error) < 2.0
    assert np.nanmean(learned[:, 0]) - np.nanmean(learned[:, 10:]) > 10.0


def test_a_magnet_in_a_bag_is_no_place() -> None:
    maps = empty()
    maps.learn(np.full((5, 2), 3.0), np.full(5, 900.0))
    assert maps.grid("magnetic") is None


def test_radio_and_shadowing_are_told_of_an_access_point_there_is() -> None:
    maps = empty()
    near = maps.grid("radio", None, "ap-1")
    assert near is not None
    assert near.rows[0][0] > near.rows[-1][-1]  # type: ignore[operator]
    mean, variance = np.zeros((2, 8, 10)), np.full((2, 8, 10), 30.0)
    mean[0, 2, 3], variance[0, 2, 3] = -6.0, 2.0
    model = RadioModel("hall", RADIO, ShadowingMap(RADIO.names, np.array([0.5, 0.5]), 1.0, mean, variance))
    shadow = maps.grid("shadowing", model, "ap-1")
    assert shadow is not None
    assert (shadow.rows[2][3], shadow.rows[0][0]) == (-6.0, None)
    assert maps.grid("shadowing", model, "ap-2") is None
    for wrong in (None, "ap-9"):
        with pytest.raises(ValueError, match=r"allowed: ap-1, ap-2"):
            maps.grid("radio", model, wrong)


def test_the_demo_hall_has_maps(project: Path) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    maps = AreaMaps.of_site(site, "hall")
    for step in range(200):
        maps.look(float(step), np.array([[10.0, 6.0]]))
    assert np.nanmax(values(maps, "visits")) == pytest.approx(18.0, rel=0.05)  # who stands visits once
