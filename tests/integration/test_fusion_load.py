"""The load benchmark of fusion: what it sends arrives, and what it says of latency, drops and memory is so."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import SITE, World, frame, make_site

from benchmarks.fusion_live import LiveRun, latency_of, memory_slope, run_live
from benchmarks.fusion_load import LoadFile, Said, Sent, looped, thinned
from benchmarks.fusion_speed import crowd_figures
from shared.messages import ChunkMark, DetectionFrame, MotionBatch, RadioScan

SECONDS = 2.0


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[float, Said]]:
    folder = tmp_path_factory.mktemp("site")
    world = World(make_site(folder), seconds=SECONDS, rate=15.0, cameras=("west", "east"))
    messages: list[Said] = [*world.frames(), *world.scans(), *world.motions()]
    return sorted(((message.t, message) for message in messages), key=lambda one: one[0])


def a_run(sent: list[float], received: dict[int, float], consumed: dict[int, list[str]]) -> LiveRun:
    names = [f"m{number}" for number in range(len(sent))]
    marks = [ChunkMark(t=0.0, area="a", chunk=n, t_start=0.0, t_end=1.0, consumed=ids) for n, ids in consumed.items()]
    memory = np.array([[0.0, 100.0], [1800.0, 110.0], [3600.0, 112.0]])
    return LiveRun(Sent(names, sent, [0.0, 0.1], 0.2), marks, received, memory, 0.3, 0.0)


def test_latency_is_from_each_message_to_the_tracks_of_its_chunk_and_what_is_in_no_chunk_took_for_ever() -> None:
    run = a_run([10.0, 10.02, 11.0, 12.0], {7: 10.05, 8: 11.01}, {7: ["m0", "m1", "scan"], 8: ["m2"], 9: ["m3"]})
    latency = latency_of(run)
    assert latency.seconds == pytest.approx([0.05, 0.03, 0.01, np.inf])
    assert latency.closing == pytest.approx([0.03, 0.01])
    assert latency.closing_sent == pytest.approx([10.02, 11.0])
    assert latency.drop_share == 0.25


def test_drops_count_from_the_beginning_and_times_after_warming_up() -> None:
    run = a_run([10.0, 16.0, 17.0], {8: 16.04, 9: 17.02}, {8: ["m1"], 9: ["m2"]})
    figures = crowd_figures(run, run)
    assert figures["crowd_p99_ms"] == pytest.approx(40.0)
    assert figures["crowd_drop_share"] == pytest.approx(1 / 3)
    assert figures["crowd_rss_mb"] == 112.0


def test_the_slope_of_memory_is_of_the_second_half() -> None:
    hours = np.linspace(0.0, 1.0, 50)
    memory = np.column_stack([3600.0 * hours, np.where(hours < 0.5, 300.0 * hours, 150.0 + 4.0 * (hours - 0.5))])
    assert memory_slope(memory) == pytest.approx(4.0)


def test_a_thinned_load_keeps_every_nth_frame_and_scan_of_each_source_and_all_steps(
    said: list[tuple[float, Said]],
) -> None:
    kept = [message for _, message in thinned(said, 5)]
    everything = [message for _, message in said]
    for kind, share in ((DetectionFrame, 5), (MotionBatch, 1)):
        assert sum(isinstance(message, kind) for message in kept) == (
            sum(isinstance(message, kind) for message in everything) / share
        )
    assert {m.device for m in kept if isinstance(m, RadioScan)} == {
        m.device for m in everything if isinstance(m, RadioScan)
    }


def test_a_message_told_again_later_has_all_its_times_shifted(said: list[tuple[float, Said]]) -> None:
    motion = next(message for _, message in said if isinstance(message, MotionBatch))
    later = looped(motion, 100.0)
    assert isinstance(later, MotionBatch)
    assert (later.t - motion.t, later.t_start - motion.t_start) == (100.0, 100.0)
    assert np.subtract(later.step_t, motion.step_t) == pytest.approx(100.0)
    assert looped(frame(5.0), 100.0).t == 105.0


def test_a_load_keeps_its_order_through_its_file(said: list[tuple[float, Said]]) -> None:
    load = LoadFile.of("tcp/x", "s", "a", said, period=SECONDS)
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(load), type=LoadFile)
    assert list(again.messages()) == [(t - said[0][0], message) for t, message in said]


@pytest.mark.parametrize(("clock", "rounds"), [(True, 1), (False, 3)])
def test_a_small_load_reaches_fusion_and_every_message_is_accounted_for(
    tmp_path: Path, said: list[tuple[float, Said]], clock: bool, rounds: int
) -> None:
    file = tmp_path / "site.yaml"
    file.write_text(SITE)
    run = run_live(file, "test-hall", "hall", said, period=SECONDS, rounds=rounds, clock=clock)
    latency = latency_of(run)
    assert len(latency.seconds) == rounds * sum(isinstance(message, DetectionFrame) for _, message in said)
    assert (latency.seconds > 0.0).all()
    if clock:  # a machine that is busy with other tests may drop frames, as it may those of cameras
        assert latency.drop_share < 0.5
    else:  # the two frames of the end may wait for a chunk that nothing closes any more
        assert np.isfinite(latency.seconds[:-2]).all()
    assert len(run.sent.late) == (len(said) if clock else 0)
    assert run.memory[-1, 0] == pytest.approx(rounds * SECONDS, abs=0.5)
    assert 50.0 < run.memory[-1, 1] < 500.0
    assert 0.0 < run.cpu_share < 1.5
