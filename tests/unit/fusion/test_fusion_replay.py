"""Replaying recorded chunks gives the bytes that were published."""

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import World, make_site

from services.fusion.active_radio import ActiveRadio
from services.fusion.area_view import AreaView
from services.fusion.evidence.tracker import AnonymousTracker
from services.fusion.registry import TRACKERS, make_tracker
from services.fusion.replay import StateAnswer, chunk_of, replay_steps, replay_tracks
from services.fusion.tracker import Chunk, TrackerStateError
from services.fusion.trained_view import radio_digest, trained_view
from shared.messages import ChunkMark, Message, Revision, encode
from shared.radio import RadioModel, ShadowingMap, write_radio_model
from shared.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


def recorded(chunks: list[Chunk], area: str = "hall") -> list[tuple[ChunkMark, tuple[Message, ...]]]:
    return [
        (
            ChunkMark(t=one.t_end, area=area, chunk=one.index, t_start=one.t_start, t_end=one.t_end),
            (*one.frames, *one.scans, *one.motions),
        )
        for one in chunks
    ]


def test_a_recorded_chunk_is_the_chunk_that_was_consumed(site: Site) -> None:
    chunks = World(site, seconds=5.0).chunks()
    assert [chunk_of(mark, inputs) for mark, inputs in recorded(chunks)] == chunks


def test_from_the_start_and_from_the_middle_the_bytes_are_the_same(site: Site) -> None:
    chunks = World(site, seed=3, seconds=12.0).chunks()
    view = AreaView.of(site, "hall")
    tracker, radio = make_tracker("evidence", view), ActiveRadio(view)
    live, state = [], b""
    for number, one in enumerate(chunks):
        live.append(encode(radio.step(tracker, one)))
        if number == 30:
            state = msgspec.json.encode(
                StateAnswer(chunk=one.index, tracker="evidence", state=msgspec.Raw(tracker.state()))
            )
    others = recorded(chunks, area="gallery")
    everything = [entry for pair in zip(recorded(chunks), others, strict=True) for entry in pair]
    assert [encode(frame) for frame in replay_tracks(everything, site, "hall")] == live
    assert [encode(frame) for frame in replay_tracks(everything, site, "hall", state)] == live[31:]


def test_a_state_before_the_first_chunk_is_no_state_but_names_the_tracker(site: Site) -> None:
    chunks = World(site, seconds=2.0).chunks()
    state = msgspec.json.encode(StateAnswer(chunk=-1, tracker="anonymous", state={}))
    frames = list(replay_tracks(recorded(chunks), site, "hall", state))
    assert {frame.tracker for frame in frames} == {"anonymous"}


def test_a_state_that_does_not_fit_is_an_error_in_words(site: Site) -> None:
    state = msgspec.json.encode(StateAnswer(chunk=5, tracker="evidence", state={"tracker": "evidence"}))
    with pytest.raises(TrackerStateError, match="evidence"):
        list(replay_tracks([], site, "hall", state))


def test_revisions_are_computed_anew_as_well(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    class Reviser(AnonymousTracker):
        name = "reviser"

        def revision(self) -> Revision | None:
            chunk = self.positions.tracks.ids.size
            return Revision(t=1.0, area="hall", chunk=chunk, tracker=self.name) if chunk else None

    monkeypatch.setitem(TRACKERS, "reviser", lambda view, seed: Reviser(view))
    chunks = World(site, seconds=2.0).chunks()
    steps = list(replay_steps(recorded(chunks), site, "hall", tracker="reviser"))
    assert [frame.chunk for frame, _ in steps] == [one.index for one in chunks]
    assert sum(revision is not None for _, revision in steps) > 10


def test_a_state_of_another_radio_model_is_an_error_in_words(site: Site, tmp_path: Path) -> None:
    view = AreaView.of(site, "hall")
    state = StateAnswer(
        chunk=5,
        tracker="evidence",
        radio=radio_digest(view),
        state=msgspec.Raw(make_tracker("evidence", view).state()),
    )
    assert list(replay_tracks([], site, "hall", msgspec.json.encode(state))) == []
    grid = np.zeros((len(view.radio.names), 2, 2))
    shadowing = ShadowingMap(view.radio.names, np.zeros(2), 1.0, grid, grid + 9.0)
    moved = dataclasses.replace(view.radio, positions=view.radio.positions + 1.0)
    file = tmp_path / "radio.json"
    write_radio_model(RadioModel(site.site, moved, shadowing), file)
    with pytest.raises(TrackerStateError, match="another radio model"):
        list(replay_steps([], site, "hall", msgspec.json.encode(state), radio_model=file))
    # Where the access points stand is for the site file to say, whatever the trained model was made with.
    assert trained_view(site, "hall", file).radio.positions.tolist() == view.radio.positions.tolist()
    others = [
        dataclasses.replace(view.radio, power_1m=view.radio.power_1m - 8.0),
        dataclasses.replace(view.radio, exponent=view.radio.exponent + 0.1),
        moved,
    ]
    digests = {radio_digest(dataclasses.replace(view, radio=other)) for other in (view.radio, *others)}
    assert len(digests | {radio_digest(dataclasses.replace(view, shadowing=shadowing))}) == 5
