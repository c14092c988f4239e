"""A phone that has said next to nothing is nobody; one whose consent was withdrawn is nobody at once."""

from dataclasses import replace
from pathlib import Path

import pytest
from fusion_world import World, make_site

from services.fusion.area_view import AreaView
from services.fusion.chunks import Chunker
from services.fusion.evidence.tracker import EvidenceTracker
from services.fusion.tracker import Chunk
from shared.messages import Erasure, MotionBatch, RadioScan
from shared.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.mark.parametrize("level", [-35.0, -60.0])
def test_a_phone_that_told_one_scan_and_fell_silent_gets_nobody(site: Site, level: float) -> None:
    world = World(site, seed=3, people=6, seconds=40.0)
    tracker = EvidenceTracker(AreaView.of(site, "hall"))
    named = 0
    for number, chunk in enumerate(world.chunks(motion=False)):
        scans: tuple[RadioScan, ...] = ()
        if number == 60:
            t = chunk.frames[-1].t
            scans = (RadioScan(t=t, device="ghost", seq=1, access_point=["ap-1", "ap-2"], rssi=[level, -75.0]),)
        frame = tracker.step(replace(chunk, scans=scans))
        named += "ghost" in frame.device
    assert named == 0


def test_a_withdrawn_device_is_on_no_track_from_the_same_chunk_on(site: Site) -> None:
    world = World(site, seed=1, seconds=40.0)
    tracker = EvidenceTracker(AreaView.of(site, "hall"))
    chunks = world.chunks()
    half = len(chunks) // 2
    before = [tracker.step(chunk) for chunk in chunks[:half]][-1]
    (victim, *_) = [device for device in before.device if device is not None]
    erasure = Erasure(t=chunks[half].t_end, device=victim)
    after = [tracker.step(replace(chunks[half], erasures=(erasure,)))]
    after += [
        tracker.step(replace(chunk, scans=tuple(scan for scan in chunk.scans if scan.device != victim)))
        for chunk in chunks[half + 1 :]
    ]
    for frame in after:
        assert victim not in frame.device
        assert victim not in frame.runner_up
        assert all(victim not in names for names in frame.sources)
    assert victim not in tracker.identity.devices


def test_a_withdrawal_leaves_with_the_next_chunk_and_is_named_in_its_mark(site: Site) -> None:
    chunker = Chunker()
    frames = World(site, seconds=3.0).frames()
    chunker.add_erasure(Erasure(t=0.0, device="d"), "the withdrawal")
    closed = [one for number, frame in enumerate(frames) for one in chunker.add_frame(frame, f"frame {number}")]
    assert [[erasure.device for erasure in one.chunk.erasures] for one in closed] == [["d"], *[[]] * (len(closed) - 1)]
    assert closed[0].consumed == ("frame 0", "the withdrawal")


def test_without_a_frame_a_withdrawal_leaves_in_a_chunk_of_its_own_and_what_waited_of_the_device_never(
    site: Site,
) -> None:
    chunker, frames = Chunker(), World(site, seconds=4.0).frames()
    chunker.add_erasure(Erasure(t=0.0, device="nobody"), "too early")
    assert chunker.close_for_erasures() is None, "no chunk was closed: there is no time it could be of"
    half = len(frames) // 2
    before = [one for number, frame in enumerate(frames[:half]) for one in chunker.add_frame(frame, f"frame {number}")]
    t = frames[half].t
    for device in ("gone", "stays"):
        scan = RadioScan(t=t, device=device, seq=1, access_point=["ap-1"], rssi=[-50.0])
        chunker.add_scan(scan, f"scan of {device}")
        batch = MotionBatch(t=t, t_start=t - 1.0, device=device, seq=1, activity="still")
        chunker.add_motion(batch, f"motion of {device}")
    chunker.add_erasure(Erasure(t=t + 60.0, device="gone"), "the withdrawal")
    alone = chunker.close_for_erasures()
    assert alone is not None
    assert alone.consumed == ("the withdrawal",)
    assert alone.chunk.index == before[-1].chunk.index + 1
    assert chunker.close_for_erasures() is None
    after = [one for number, frame in enumerate(frames[half:]) for one in chunker.add_frame(frame, f"frame {number}")]
    indices = [one.chunk.index for one in (*before, alone, *after)]
    assert indices == sorted(set(indices))
    consumed = [name for one in after for name in one.consumed]
    assert "scan of stays" in consumed
    assert "motion of stays" in consumed
    assert not any("gone" in name for name in consumed)
    assert sum(len(one.chunk.frames) for one in (*before, *after)) >= len(frames) - 3


def test_a_tracker_takes_a_chunk_of_a_withdrawal_alone(site: Site) -> None:
    world = World(site, seed=1, seconds=30.0)
    tracker = EvidenceTracker(AreaView.of(site, "hall"))
    chunks = world.chunks()
    frame = [tracker.step(chunk) for chunk in chunks][-1]
    (victim, *_) = [device for device in frame.device if device is not None]
    last = chunks[-1]
    erasure = Erasure(t=last.t_end + 60.0, device=victim)
    told = tracker.step(Chunk(last.index + 1, last.t_end, last.t_end + 1 / 15, erasures=(erasure,)))
    assert victim not in told.device
    assert victim not in tracker.identity.devices
    assert told.track == frame.track
