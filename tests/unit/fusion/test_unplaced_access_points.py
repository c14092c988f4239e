"""Fusion passes over what is heard of an access point nobody has placed, until a model places it, and after."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import World, make_site

from services.fusion.active_radio import ActiveRadio
from services.fusion.area_view import AreaView
from services.fusion.chunks import period_of
from services.fusion.evidence.identity_settings import NOISE
from services.fusion.registry import TRACKERS, make_tracker
from services.fusion.rescore.quality import Heard, null_of, score_scans
from services.fusion.tracker import Chunk
from services.fusion.trained_view import under_model
from shared.messages import RadioModelFile, RadioModelUpdate, encode
from shared.radio import RadioModel, RadioModelError, ShadowingMap, pack_radio_model
from shared.site import Site

UNKNOWN = "ap-3"
PHONES = ("evidence", "rbmcda", "rbmcda-forces")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.fixture(scope="module")
def view(whole: Site) -> AreaView:
    points = [
        point.model_copy(update={"position": None}) if point.id == UNKNOWN else point for point in whole.access_points
    ]
    return AreaView.of(whole.model_copy(update={"access_points": points}), "hall")


@pytest.fixture(scope="module")
def chunks(whole: Site) -> dict[str, list[Chunk]]:
    world = {cycle: World(whole, seed=2, seconds=10.0, cameras=("west", "east")) for cycle in (0.0, 1.0)}
    made = {}
    for name in TRACKERS:
        cycle = make_tracker(name, AreaView.of(whole, "hall")).cycle
        made[name] = world[float(cycle >= 1.0)].chunks(period=period_of(cycle))
    return made


def placing(whole: Site, view: AreaView) -> RadioModelFile:
    """Return a model that locates the access point where it hangs."""
    loss = AreaView.of(whole, "hall").radio
    flat = np.zeros((len(loss.names), 2, 2))
    model = RadioModel(view.site, loss, ShadowingMap(loss.names, np.zeros(2), 20.0, flat, flat + 4.0))
    return pack_radio_model(model, [UNKNOWN])


def deaf(chunks: list[Chunk]) -> list[Chunk]:
    """Return the chunks as if nobody had heard the access point."""
    told = []
    for one in chunks:
        scans = []
        for scan in one.scans:
            rows = [row for row, name in enumerate(scan.access_point) if name != UNKNOWN]
            heard = {"access_point": [scan.access_point[row] for row in rows], "rssi": [scan.rssi[row] for row in rows]}
            scans.append(msgspec.structs.replace(scan, **heard))
        told.append(dataclasses.replace(one, scans=tuple(scans)))
    return told


@pytest.mark.parametrize("name", sorted(TRACKERS))
def test_it_is_as_if_nobody_heard_it(name: str, view: AreaView, chunks: dict[str, list[Chunk]]) -> None:
    assert any(UNKNOWN in scan.access_point for one in chunks[name] for scan in one.scans)
    told = [
        [encode(tracker.step(one)) for one in heard]
        for tracker, heard in (
            (make_tracker(name, view, 3), chunks[name]),
            (make_tracker(name, view, 3), deaf(chunks[name])),
        )
    ]
    assert told[0] == told[1]


@pytest.mark.parametrize("name", PHONES)
def test_once_a_model_places_it_it_is_listened_to_and_no_more_when_that_is_rolled_back(
    name: str, whole: Site, view: AreaView, chunks: dict[str, list[Chunk]]
) -> None:
    models = {3: placing(whole, view), 6: None}
    told = []
    for heard in (chunks[name], deaf(chunks[name])):
        radio, tracker, frames = ActiveRadio(view), make_tracker(name, view, 3), []
        for number, one in enumerate(heard):
            second = number if len(heard) < 20 else number // (len(heard) // 10)
            if second in models and radio.view.radio.placed[2] == (second == 6):
                update = RadioModelUpdate(t=one.t_end, area="hall", version=second, model=models[second])
                assert radio.accept(update)
                one = dataclasses.replace(one, models=(update,))
            frames.append((second, radio.step(tracker, one)))
        told.append(frames)
        assert np.isfinite([value for _, frame in frames for value in (*frame.x, *frame.y)]).all()
    changed = [second for (second, one), (_, other) in zip(*told, strict=True) if encode(one) != encode(other)]
    assert changed
    assert min(changed) >= 3


def test_what_is_foretold_of_it_is_the_same_everywhere(whole: Site, view: AreaView) -> None:
    places = np.random.default_rng(1).uniform(0.0, 14.0, (30, 2))
    level = view.radio.rssi(places)
    assert np.isfinite(level).all()
    assert np.ptp(level[:, 2]) == 0.0
    np.testing.assert_array_equal(
        np.delete(level, 2, 1), np.delete(AreaView.of(whole, "hall").radio.rssi(places), 2, 1)
    )
    assert under_model(view, placing(whole, view)).radio.placed.all()
    assert not under_model(under_model(view, placing(whole, view)), None).radio.placed[2]


def test_a_model_that_names_it_without_a_place_is_refused(whole: Site, view: AreaView) -> None:
    file = placing(whole, view)
    places = [
        None if name == UNKNOWN else place for name, place in zip(file.access_points, file.positions, strict=True)
    ]
    with pytest.raises(RadioModelError, match=f"positions: found null for '{UNKNOWN}'"):
        under_model(view, msgspec.structs.replace(file, positions=places))
    unknown = under_model(view, msgspec.structs.replace(file, positions=places, located=[]))
    assert unknown.radio.placed.tolist() == [True, True, False, True, True, True]


def test_a_trial_holds_nothing_for_or_against_a_model_that_does_not_place_it(whole: Site, view: AreaView) -> None:
    rng = np.random.default_rng(4)
    t = np.repeat(np.arange(80.0), 6)
    places = np.repeat(
        np.column_stack([12.0 + 10.0 * np.sin(t[::6] / 9.0), 7.0 + 5.0 * np.sin(t[::6] / 5.0)]), 6, axis=0
    )
    points = np.tile(np.arange(6), 80)
    truth = AreaView.of(whole, "hall").radio
    level = truth.rssi(places)[np.arange(480), points] + rng.normal(0.0, 3.0, 480)

    def score(kept: np.ndarray, radio: AreaView) -> float:
        heard = Heard(t[kept], level[kept], points[kept], places[kept])
        null = null_of(level[kept], points[kept], 6, NOISE)
        return score_scans([heard], null, radio.radio, None, NOISE)[0].gain

    everything, others = np.ones(480, np.bool_), points != 2
    assert score(everything, view) == pytest.approx(score(others, view))
    assert score(everything, under_model(view, placing(whole, view))) > score(everything, view) + 5.0
