"""Two cameras that see the same people: one person is one track, whatever their clocks and projections."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import World, make_site, make_view
from msgspec.structs import replace

from services.fusion.area_view import AreaView
from services.fusion.positions.anonymous import AnonymousLayer
from services.fusion.positions.camera_clocks import CameraClocks
from services.fusion.snapshot import encode_snapshot
from shared.messages import DetectionFrame


def seen_by_both(world: World, ahead: float = 0.0, aside: float = 0.0) -> Iterator[tuple[float, DetectionFrame]]:
    """Frames with their true times; the east camera's clock is ``ahead`` and its floor lies ``aside``."""
    for frame in world.frames():
        if frame.camera == "east":
            yield frame.t, replace(frame, t=frame.t + ahead, y=[y + aside for y in frame.y])
        else:
            yield frame.t, frame


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(make_site(tmp_path), seed=3, seconds=60.0, rate=10.0, cameras=("west", "east"))


@pytest.mark.parametrize("ahead", [0.0, 0.2, 0.4, -0.4])
def test_the_difference_of_two_clocks_is_found_told_and_made_good(world: World, ahead: float) -> None:
    layer = AnonymousLayer(AreaView.of(world.site, "hall"))
    errors, ids = [], set()
    for t, frame in seen_by_both(world, ahead):
        layer.observe(frame)
        if t > world.t0 + 45.0:
            told = layer.tracks.mean[layer.told(), :2]
            # Nobody knows which of two clocks is right: times count from their middle.
            apart = np.linalg.norm(world.places(t)[:, None] - told[None], axis=2)
            errors.append(apart.min(axis=1).mean())
            ids.add(tuple(layer.tracks.ids[layer.told()].tolist()))
    difference = dict(zip(layer.cameras, layer.clocks.offsets, strict=True))
    assert difference["east"] - difference["west"] == pytest.approx(ahead, abs=0.04)
    complaint = f"clocks of cameras east and west differ by {abs(ahead):.1f} s"
    assert layer.clocks.complaints() == ([complaint] if ahead else [])
    assert len(ids) == 1
    assert np.mean(errors) < 0.1 + 1.0 * abs(ahead) / 2.0


def test_floors_that_lie_aside_are_no_clocks_that_differ(world: World) -> None:
    layer = AnonymousLayer(AreaView.of(world.site, "hall"))
    for _, frame in seen_by_both(world, aside=0.3):
        layer.observe(frame)
    assert not layer.clocks.offsets.any()
    assert int(layer.told().sum()) == world.people
    assert layer.tracks.ids.max() <= world.people + 1


def test_of_three_clocks_the_odd_one_is_wrong() -> None:
    clocks = CameraClocks(["a", "b", "c"])
    rng = np.random.default_rng(0)
    ahead = np.array([0.0, 0.0, 0.5])
    for number in range(2000):
        first, second = rng.choice(3, 2, replace=False)
        velocity = rng.normal(0.0, 1.0, (1, 2))
        true = number / 20.0 + np.array([0.0, rng.uniform(0.0, 0.1)])
        places = velocity * true[:, None] + rng.normal(0.0, 0.1, (2, 2))
        fix = np.array([[*places[0], true[0] + ahead[first]]])
        clocks.learn(int(second), true[1] + ahead[second], np.array([first]), fix, velocity, places[1:])
    assert clocks.offsets == pytest.approx(ahead, abs=0.05)
    assert clocks.complaints() == ["clock of camera c is 0.5 s ahead"]


def test_what_was_learned_with_wrong_times_counts_for_little_once_they_are_right() -> None:
    """A clock is set while people walk: the evidence from before has outlived a correction by a fifth at most."""
    clocks = CameraClocks(["a", "b"])
    rng = np.random.default_rng(1)
    weights = []
    for number in range(400):
        velocity = rng.normal(0.0, 1.0, (1, 2))
        t = number / 20.0
        places = velocity * np.array([[t], [t + 0.05]])
        fix = np.array([[*places[0], t]])
        clocks.learn(1, t + 0.05 + 0.4, np.array([0]), fix, velocity, places[1:])
        weights.append(clocks.state()["sums"][0, 1, 0])
        if clocks.offsets.any():
            break
    assert clocks.offsets[1] - clocks.offsets[0] == pytest.approx(0.4, abs=0.02)
    assert weights[-1] == pytest.approx(0.2 * (weights[-2] + 1.0), rel=0.01)


def test_what_was_learned_of_the_clocks_survives_a_restart(world: World) -> None:
    layer = AnonymousLayer(AreaView.of(world.site, "hall"))
    for _, frame in seen_by_both(world, 0.4):
        layer.observe(frame)
    other = AnonymousLayer(layer.view)
    other.restore(msgspec.json.decode(encode_snapshot(layer.state())))
    assert other.clocks.complaints() == layer.clocks.complaints() != []


def test_a_state_of_other_cameras_is_refused(tmp_path: Path) -> None:
    layer = AnonymousLayer(make_view(tmp_path))
    state = msgspec.json.decode(encode_snapshot({"clocks": CameraClocks(["a"]).state()}))
    with pytest.raises(ValueError, match="other cameras"):
        layer.clocks.restore(state["clocks"])
