"""Maps learned as people walk: bounded, fading, saved and read again, and never surer than what was seen."""

from __future__ import annotations

import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
import shapely
from fusion_world import make_site
from hypothesis import given, settings
from hypothesis import strategies as st

from services.learning.maps import AreaMaps, MapsLearner
from services.learning.maps.area_maps import HALF_LIFE
from services.learning.tracks.stretch import Stretch
from shared.learning_command import LearningAnswer, LearningCommand, MapKind
from shared.messages import RadioModelUpdate, TrackFrame
from shared.radio.path_loss import PathLoss
from shared.radio.radio_model import RadioModel, pack_radio_model
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
    assert np.nanmax(values(maps, "visits")) == 0.0, "one visit is not told of: it could be found out whose it was"
    assert maps.grid("occlusion") is None
    for visit in range(1, 6):
        maps.look(200.0 + 20.0 * visit, np.array([[2.0, 2.0]]))
        maps.look(210.0 + 20.0 * visit, np.array([[10.0, 6.0]]))
    assert np.nanmax(values(maps, "visits")) == pytest.approx(3600.0 * 6 / 210.0, rel=0.05)  # who stands visits once


def test_a_learner_of_maps_watches_learns_and_answers(project: Path) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    maps = MapsLearner(site, "hall")
    frame = TrackFrame(
        t=0.0, area="hall", chunk=0, tracker="test", track=[1, 2], floor=["ground"] * 2, x=[10.0, 3.0], y=[6.0, 9.0],
        covariance=[(0.1, 0.0, 0.1)] * 2, vx=[0.0] * 2, vy=[0.0] * 2, state=["confirmed", "unseen"], device=[None] * 2,
        probability=[1.0] * 2, runner_up=[None] * 2, runner_up_probability=[0.0] * 2, former=[[], []],
        sources=[[], []], quality=[1.0] * 2,
    )  # fmt: skip
    assert asked(maps, "visits").map is None
    assert asked(maps, "visits").words
    for second in range(120):
        there = [10.0, 3.0] if second // 10 % 2 == 0 else [15.0, 3.0]  # six visits of each of two cells
        maps.watch(msgspec.structs.replace(frame, t=float(second), x=there))
        maps.watch(msgspec.structs.replace(frame, t=float(second), area="elsewhere", x=[1.0, 1.0]))
    visits = asked(maps, "visits").map
    assert visits is not None
    assert sum(1 for row in visits.rows for value in row if value) == 2, "whom no camera sees is no visit"
    maps.learn(stretch(np.full(8, 52.0)))
    maps.learn(stretch(np.empty(0)))
    magnetic = asked(maps, "magnetic").map
    assert magnetic is not None
    assert {value for row in magnetic.rows for value in row} == {None, 52.0}
    assert asked(maps, "shadowing", "ap-1").map is None
    variance = np.full((6, 12, 20), 9.0)
    variance[0, 3, 3] = 1.0
    points = PathLoss.of(site.access_points)
    model = RadioModel(
        "hall", points, ShadowingMap(points.names, np.full(2, 0.5), 1.0, np.full((6, 12, 20), 2.0), variance)
    )
    maps.activated(RadioModelUpdate(t=0.0, area="hall", version=1, model=pack_radio_model(model)))
    assert asked(maps, "shadowing", "ap-1").map is not None
    file = msgspec.structs.replace(pack_radio_model(model), site="elsewhere")
    maps.activated(RadioModelUpdate(t=0.5, area="hall", version=1, model=file))
    assert asked(maps, "shadowing", "ap-1").map is None, "fusion does not use a model that does not fit either"
    maps.activated(RadioModelUpdate(t=0.0, area="hall", version=1, model=pack_radio_model(model)))
    maps.activated(RadioModelUpdate(t=1.0, area="hall", version=2))
    assert asked(maps, "shadowing", "ap-1").map is None
    refused = asked(maps, "radio", "ap-99")
    assert (refused.done, refused.field, refused.unknown) == (False, "access_point", True)
    assert asked(maps, None).field == "map"
    assert maps.map(LearningCommand(do="map", area="elsewhere", map="visits")) is None
    assert list(maps.propose(0.0, 0.0)) == []
    again = MapsLearner(site, "hall")
    again.restore(json.loads(msgspec.json.encode(maps.state())))
    assert asked(again, "magnetic") == asked(maps, "magnetic")


def test_of_an_access_point_nobody_has_placed_there_is_no_map_until_a_model_places_it(tmp_path: Path) -> None:
    whole = make_site(tmp_path)
    points = [p.model_copy(update={"position": None}) if p.id == "ap-2" else p for p in whole.access_points]
    site = whole.model_copy(update={"access_points": points})
    maps = MapsLearner(site, "hall")
    assert asked(maps, "radio", "ap-1").map is not None
    for kind in ("radio", "shadowing"):
        answer = asked(maps, kind, "ap-2")
        assert (answer.done, answer.map) == (True, None)
        assert answer.words == "Nobody knows yet where access point ap-2 hangs."
    loss = PathLoss.of([point for point in whole.access_points if point.floor == "ground"])
    flat = np.zeros((len(loss.names), 2, 2))
    model = RadioModel(site.site, loss, ShadowingMap(loss.names, np.zeros(2), 5.0, flat, flat + 1.0))
    file = pack_radio_model(model, ["ap-2"])
    maps.activated(RadioModelUpdate(t=0.0, area="hall", version=1, model=file))
    assert asked(maps, "radio", "ap-2").map is not None


def asked(maps: MapsLearner, kind: MapKind | None, access_point: str | None = None) -> LearningAnswer:
    answer = maps.map(LearningCommand(do="map", area="hall", map=kind, access_point=access_point))
    assert answer is not None
    return answer


def stretch(field: np.ndarray) -> Stretch:
    t = np.arange(8.0)
    nothing, none = np.empty(0), np.empty(0, np.int64)
    return Stretch(
        device="d", track=1, t=t, place=np.full((8, 2), 5.2), covariance=np.tile(np.eye(2), (8, 1, 1)),
        probability=np.ones(8), seen=np.ones(8, np.bool_), sight=np.ones(8), scan_t=nothing, point=none, level=nothing,
        scan_place=np.empty((0, 2)), scan_spread=nothing, step_t=t, length=np.ones(8), length_variance=np.ones(8),
        heading=np.zeros(8), heading_variance=np.ones(8), walk=np.zeros(8, np.int64), magnetic=field,
    )  # fmt: skip
