"""Which radio model is in use, which may follow, what is kept of it beside a state, and that it replays."""

import dataclasses
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from fusion_world import World, frame, make_site

from services.fusion.active_radio import ActiveRadio
from services.fusion.area_view import AreaView
from services.fusion.chunks import Chunker
from services.fusion.radio_file import RadioFile
from services.fusion.rbmcda.particles import Particles
from services.fusion.registry import make_tracker
from services.fusion.replay import StateAnswer, replay_steps
from services.fusion.tracker import Chunk, TrackerStateError
from services.fusion.trained_view import radio_digest, under_model
from shared.messages import ChunkMark, Message, RadioModelFile, RadioModelUpdate, encode
from shared.radio import RadioModel, RadioModelError, ShadowingMap, pack_radio_model
from shared.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return make_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def view(site: Site) -> AreaView:
    return AreaView.of(site, "hall")


def learned(view: AreaView, power: float = 3.0, located: tuple[str, ...] = (), **changes: Any) -> RadioModelFile:
    radio = dataclasses.replace(
        view.filed, power_1m=view.filed.power_1m + power, positions=view.filed.positions + np.array([1.0, 0.0, 0.0])
    )
    flat = np.zeros((len(radio.names), 2, 2))
    model = RadioModel(view.site, radio, ShadowingMap(radio.names, np.zeros(2), 5.0, flat, flat + 4.0))
    return msgspec.structs.replace(pack_radio_model(model, located), **changes)


def update(model: RadioModelFile | None, version: int = 1, area: str = "hall") -> RadioModelUpdate:
    return RadioModelUpdate(t=100.0, area=area, version=version, model=model)


def test_access_points_stand_where_they_were_located_and_else_where_the_site_file_says(view: AreaView) -> None:
    moved = under_model(view, learned(view, located=("ap-2",)))
    off = moved.radio.positions - view.filed.positions
    assert off[:, 0].tolist() == [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    assert moved.radio.power_1m.tolist() == (view.filed.power_1m + 3.0).tolist()
    back = under_model(moved, None)
    assert back.shadowing is None
    assert radio_digest(back) == radio_digest(view) != radio_digest(moved)


def test_only_a_newer_version_goes_live_and_the_first_always_does(view: AreaView) -> None:
    radio, tracker = ActiveRadio(view), make_tracker("anonymous", view)
    assert radio.accept(update(learned(view), version=0))
    assert not radio.accept(update(learned(view, 9.0), version=0))
    newest = update(learned(view, 5.0), version=4)
    assert radio.accept(newest)
    assert radio.older(update(None, version=3))
    assert not radio.older(newest)
    assert radio.update is None  # accepted, and not yet live
    radio.step(tracker, Chunk(1, 1.0, 2.0, models=(newest,)))
    assert radio.update is newest
    assert radio.view.radio.power_1m.tolist() == (view.filed.power_1m + 5.0).tolist()
    assert radio.digest == radio_digest(radio.view)
    assert radio.accept(update(None, version=5))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"site": "another"}, "learned at site 'another', expected 'test-hall'"),
        ({"access_points": ["ap-1", "ap-2", "ap-3", "ap-4", "ap-5", "ap-9"]}, "lacks ap-6; has ap-9"),
        ({"power_1m": [0.0, 0.0, 0.0, 0.0, 0.0, 1e9]}, "power_1m: found 1e+09; allowed: -150 … 50"),
        ({"exponent": [2.0, 2.0, -2.0, 2.0, 2.0, 2.0]}, "exponent: found -2; allowed: 0 … 10"),
        ({"mean": [[[1e4]]] * 6, "variance": [[[1.0]]] * 6}, "mean: found 10000; allowed: -100 … 100"),
        ({"located": ["ap-9"]}, "located: 'ap-9' is none of its access points"),
        ({"located": ["ap-1"], "positions": [(9e3, 0.0, 2.0)] * 6}, "positions: ap-1 at (9000.0, 0.0, 2.0); allowed"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(view: AreaView, changes: dict[str, Any], words: str) -> None:
    radio = ActiveRadio(view)
    with pytest.raises(RadioModelError) as caught:
        radio.accept(update(learned(view, **changes), version=9))
    assert words in str(caught.value)
    with pytest.raises(RadioModelError, match="of area 'gallery', expected 'hall'"):
        radio.accept(update(None, area="gallery"))
    assert radio.accept(update(learned(view), version=1))


def test_a_model_waits_for_the_next_chunk_and_the_newest_takes_its_place() -> None:
    chunker = Chunker()
    chunker.add_model(update(None, version=1), "m-1")
    chunker.add_model(update(None, version=2), "m-2")
    closed = [one for number in range(30) for one in chunker.add_frame(frame(100.0 + number / 10), f"f-{number}")]
    assert [one.version for one in closed[0].chunk.models] == [2]
    assert closed[0].consumed[-1] == "m-2"
    assert len(closed) > 20
    assert all(not one.chunk.models for one in closed[1:])


def test_a_model_is_kept_as_long_as_a_state_names_it(view: AreaView, tmp_path: Path) -> None:
    kept = RadioFile(tmp_path / "fusion-hall.json")
    digests = [letter * 64 for letter in "abc"]
    neighbour = tmp_path / f"fusion-hall.north.{'a' * 16}.radio"
    neighbour.write_text("another area's")
    first, second = update(learned(view), 1), update(learned(view, 8.0), 2)
    kept.write(digests[0], first)
    written = (tmp_path / f"fusion-hall.{'a' * 16}.radio").stat().st_mtime_ns
    kept.write(digests[0], first)
    assert (tmp_path / f"fusion-hall.{'a' * 16}.radio").stat().st_mtime_ns == written
    kept.write(digests[1], second)
    # The state of the first model lies on the disk until that of the second does.
    assert (kept.read(digests[0]), RadioFile(tmp_path / "fusion-hall.json").read(digests[1])) == (first, second)
    kept = RadioFile(tmp_path / "fusion-hall.json")
    assert kept.read(digests[1]) == second
    kept.write(digests[1], second)
    assert kept.read(digests[0]) is None
    (tmp_path / f"fusion-hall.{'b' * 16}.radio").write_bytes(b"{")
    assert kept.read(digests[1]) is None
    assert kept.read(digests[2]) is None
    assert neighbour.exists()
    RadioFile(None).write(digests[0], first)


def test_what_particles_hear_stays_what_it_was_where_models_differ_by_a_slope() -> None:
    """Position and bias under a new model are another way to say the same of what will be heard."""
    rng = np.random.default_rng(8)
    spread = rng.normal(size=(5, 5))
    before = Particles.empty(4, 3).with_device(rng.normal(size=5), spread @ spread.T)
    slope, level = rng.normal(size=(2, 3)), rng.normal(size=3)
    after = before.retuned(lambda places: places @ slope + level)
    # heard = bias + expected, and the new model expects ``places @ slope + level`` less.
    back = np.eye(5)
    back[2:, :2] = -slope.T
    same = back @ after.covariance[:, :, 0] @ back.T
    np.testing.assert_allclose(same, before.covariance[:, :, 0], atol=1e-9)
    np.testing.assert_allclose(after.mean[2:, 0] - before.mean[2:, 0], before.mean[:2, 0] @ slope + level)
    np.testing.assert_array_equal(after.mean[:2], before.mean[:2])


def recorded(chunks: list[Chunk]) -> list[tuple[ChunkMark, tuple[Message, ...]]]:
    return [
        (
            ChunkMark(t=one.t_end, area="hall", chunk=one.index, t_start=one.t_start, t_end=one.t_end),
            (*one.frames, *one.scans, *one.motions, *one.models),
        )
        for one in chunks
    ]


@pytest.mark.parametrize("name", ["evidence", "rbmcda"])
def test_a_swap_in_mid_run_replays_from_the_start_and_from_a_state_after_it(
    site: Site, view: AreaView, name: str
) -> None:
    tracker, radio = make_tracker(name, view), ActiveRadio(view)
    chunks = World(site, seed=3, seconds=14.0).chunks(period=tracker.cycle or 1 / 15)
    swap, asked = len(chunks) // 3, 2 * len(chunks) // 3
    chunks[swap] = dataclasses.replace(chunks[swap], models=(update(learned(view, located=("ap-1",)), 7),))
    live, state = [], StateAnswer(chunk=-1, tracker=name, state={})
    for number, one in enumerate(chunks):
        live.append(encode(radio.step(tracker, one)))
        if number == asked:
            whole = msgspec.Raw(tracker.state())
            state = StateAnswer(chunk=one.index, tracker=name, radio=radio.digest, model=radio.update, state=whole)
    answer = msgspec.json.encode(state)
    again = [encode(told) for told, _ in replay_steps(recorded(chunks), site, "hall", tracker=name)]
    assert again == live
    without = [dataclasses.replace(one, models=()) for one in chunks]
    assert [encode(told) for told, _ in replay_steps(recorded(without), site, "hall", tracker=name)] != live
    after = [encode(told) for told, _ in replay_steps(recorded(chunks), site, "hall", answer)]
    assert after == live[asked + 1 :]
    foreign = update(learned(view, site="x"), 7)
    for model, words in ((None, "another radio model"), (foreign, "does not fit any more: learned at site 'x'")):
        other = msgspec.json.encode(msgspec.structs.replace(state, model=model))
        with pytest.raises(TrackerStateError, match=words):
            list(replay_steps([], site, "hall", other))
