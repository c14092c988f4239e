"""A radio model learned from published tracks and names comes nearer to the true radio than the site file's guess."""

from pathlib import Path

import numpy as np
import pytest
from fusion_world import World, make_site, make_view
from msgspec.structs import replace
from track_frames import frame

from benchmarks.fusion_run import FusionRun
from benchmarks.radio_training import learn_from_run, warmed_up
from services.simulator.radio.radio_world import RadioWorld
from shared.messages import RadioScan


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(make_site(tmp_path), seed=3, people=4, seconds=60.0)


def published(world: World, names: dict[int, str], seconds: float = 60.0) -> FusionRun:
    times = world.t0 + np.arange(int(seconds * 2)) / 2.0
    frames = []
    for t in times.tolist():
        spots = {number + 1: (x, y) for number, (x, y) in enumerate(world.places(t).tolist())}
        frames.append(replace(frame(t, spots, names), probability=[0.95] * len(spots)))
    return FusionRun(frames, [], [])


def scans_of(world: World) -> dict[str, list[RadioScan]]:
    scans: dict[str, list[RadioScan]] = {}
    for scan in world.scans():
        scans.setdefault(scan.device, []).append(scan)
    return scans


def test_what_is_learned_is_nearer_to_the_truth_where_people_walked(world: World, tmp_path: Path) -> None:
    view = make_view(tmp_path)
    model = learn_from_run(
        published(world, {number + 1: str(number) for number in range(4)}), scans_of(world), view, "test-hall"
    )
    spots = np.concatenate([world.places(world.t0 + t) for t in np.arange(0.5, 60.0, 3.0)])
    on_floor = list(view.radio.names)
    radio = RadioWorld(world.site, world.seed)
    true = radio.expected(spots, "ground")[:, [list(radio.access_points).index(name) for name in on_floor]]
    better = warmed_up(view, model)
    assert better.shadowing is not None
    learned = better.radio.rssi(spots) + better.shadowing.at(spots)[0]
    assert np.std(learned - true) < 0.6 * np.std(view.radio.rssi(spots) - true)
    assert model.path_loss.names == view.radio.names


def test_names_that_are_not_sure_and_tracks_that_nobody_bears_teach_nothing(world: World, tmp_path: Path) -> None:
    view, scans = make_view(tmp_path), scans_of(world)
    for run in (published(world, {}), FusionRun([], [], []), published(world, {1: "0"}, seconds=1.0)):
        model = learn_from_run(run, scans, view, "test-hall")
        assert not model.shadowing.mean.any()
        np.testing.assert_array_equal(model.path_loss.power_1m, view.radio.power_1m)


def test_names_that_go_round_teach_a_model_that_is_less_sure(world: World, tmp_path: Path) -> None:
    view, scans = make_view(tmp_path), scans_of(world)
    right = published(world, {number + 1: str(number) for number in range(4)})
    wrong = published(world, {number + 1: str((number + 1) % 4) for number in range(4)})
    walked = np.concatenate([world.places(world.t0 + t) for t in np.arange(0.5, 60.0, 3.0)])
    sure, doubtful = (learn_from_run(run, scans, view, "test-hall").shadowing.at(walked)[1] for run in (right, wrong))
    assert doubtful.mean() > 1.2 * sure.mean()
