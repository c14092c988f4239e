"""A recording must give back exactly what fusion consumed, whatever order it reached the recorder in."""

import random
import threading
from pathlib import Path

import pytest
from fusion_world import SITE
from mcap.reader import make_reader

from services.cli.recording import Recording, RecordingError, RecordingWriter
from services.cli.replay import play, verify
from services.fusion.active_radio import ActiveRadio
from services.fusion.area_view import AreaView
from services.fusion.registry import make_tracker
from services.fusion.tracker import Chunk
from shared.bus import Bus, Trace
from shared.keys import Keys
from shared.messages import ChunkMark, DetectionFrame, RadioModelUpdate, RadioScan, Revision, TrackFrame, encode
from shared.site import load_site

KEYS = Keys("test")


def frame(n: int) -> DetectionFrame:
    return DetectionFrame(
        t=n / 10,
        camera="c",
        floor="f",
        seq=n,
        x=[0.1 * n],
        y=[1 / 3],
        covariance=[(0.1, 0.0, 0.1)],
        confidence=[0.5],
        box=[(1.0, 2.0, 3.0, 4.0)],
    )


def scan(n: int) -> RadioScan:
    return RadioScan(t=n / 10, device="d", seq=n, access_point=["ap"], rssi=[-50.0 - n])


def write_chunks(path: Path, chunks: int, order: random.Random) -> None:
    """Each chunk consumes one frame and, each third one, a scan; arrival order is shuffled within five messages."""
    entries = []
    for n in range(chunks):
        consumed = [f"f{n}"]
        entries.append((KEYS.detections("c"), frame(n), f"f{n}"))
        if n % 3 == 0:
            consumed.append(f"r{n}")
            entries.append((KEYS.radio("d"), scan(n), f"r{n}"))
        entries.append(
            (
                KEYS.chunks("a"),
                ChunkMark(t=n / 10, area="a", chunk=n, t_start=n / 10, t_end=(n + 1) / 10, consumed=consumed),
                f"m{n}",
            )
        )
        entries.append((KEYS.tracks("a"), TrackFrame(t=n / 10, area="a", chunk=n, tracker="x"), f"t{n}"))
    for start in range(0, len(entries), 5):
        block = entries[start : start + 5]
        order.shuffle(block)
        entries[start : start + 5] = block
    with RecordingWriter(path, "test", Path("site.yaml")) as writer:
        for sent, (key, message, trace) in enumerate(entries):
            writer.write(key, message, Trace(trace, 0.0, 1000.0 + sent / 100))


@pytest.mark.parametrize("seed", range(5))
def test_inputs_come_back_in_the_order_consumed_whatever_order_they_arrived_in(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "r.mcap"
    write_chunks(path, 60, random.Random(seed))
    chunks = sorted(Recording(path).consumed("a"), key=lambda chunk: chunk.mark.chunk)
    assert len(chunks) == 60
    for n, chunk in enumerate(chunks):
        expected = (frame(n), scan(n)) if n % 3 == 0 else (frame(n),)
        assert chunk.inputs == expected
        assert chunk.missing == 0
        assert chunk.tracks is not None
        assert chunk.tracks.chunk == n


def test_messages_survive_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, "test", Path("site.yaml")) as writer:
        writer.write(KEYS.detections("c"), frame(7), Trace('odd "trace"', 0.0, 5.0))
    (back,) = Recording(path).messages()
    assert encode(back.message) == encode(frame(7))
    assert back.trace == 'odd "trace"'
    assert back.key == KEYS.detections("c")


def test_an_input_the_recorder_never_got_is_counted_not_hidden(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, "test", Path("site.yaml")) as writer:
        mark = ChunkMark(t=0, area="a", chunk=0, t_start=0, t_end=1, consumed=["gone"])
        writer.write(KEYS.chunks("a"), mark, Trace("m", 0.0, 1.0))
    (chunk,) = Recording(path).consumed("a")
    assert (chunk.missing, chunk.inputs, chunk.tracks) == (1, (), None)


def test_a_recording_cut_off_by_a_crash_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    writer = RecordingWriter(path, "test", Path("site.yaml"))
    for n in range(20_000):
        writer.write(KEYS.detections("c"), frame(n), Trace(f"f{n}", 0.0, n / 10))
    writer._file.flush()  # the process is killed here: no footer, no last block
    recording = Recording(path)
    got = list(recording.messages())
    assert recording.truncated
    assert 1000 < len(got) < 20_000
    assert [recorded.message.seq for recorded in got] == list(range(len(got)))  # type: ignore[attr-defined]


def test_the_tracker_state_at_the_start_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    with RecordingWriter(path, "test", Path("site.yaml")) as writer:
        writer.attach_state("a", b'{"chunk": 3}', now=12.0)
    assert Recording(path).state("a") == b'{"chunk": 3}'
    assert Recording(path).state("b") is None


def test_viewers_find_a_schema_for_every_channel(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write_chunks(path, 3, random.Random(0))
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert schema.encoding == "jsonschema"
        assert b'"type"' in schema.data


@pytest.mark.parametrize("content", [b"", b"not an mcap file at all", b"\x89MCAP0\r\n"])
def test_other_files_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"other\.mcap"):
        Recording(path)
    with pytest.raises(RecordingError, match=r"missing\.mcap"):
        Recording(tmp_path / "missing.mcap")


def test_verifying_compares_revisions_too(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text(SITE)
    site = load_site(tmp_path / "site.yaml")
    keys = Keys(site.site)
    view = AreaView.of(site, "hall")
    told = ActiveRadio(view).step(make_tracker("anonymous", view), Chunk(15, 1.0, 16 / 15))
    mark = ChunkMark(t=1.0, area="hall", chunk=15, t_start=1.0, t_end=16 / 15)
    for invented in (False, True):
        path = tmp_path / f"{invented}.mcap"
        with RecordingWriter(path, site.site, tmp_path / "site.yaml") as writer:
            writer.write(keys.chunks("hall"), mark, Trace("1-1", 0.0, 1.0))
            writer.write(keys.tracks("hall"), told, Trace("1-2", 0.0, 1.1))
            if invented:  # this tracker never revises anything
                revision = Revision(t=1.0, area="hall", chunk=15, tracker="anonymous", device=["d"], since=[0.0])
                writer.write(keys.revisions("hall"), revision, Trace("1-3", 0.0, 1.2))
        (verdict,) = verify(Recording(path), site)
        assert (verdict.revisions, verdict.identical) == (int(invented), not invented)


def test_a_radio_model_told_an_hour_before_is_found_whenever_a_mark_names_it_and_sets_no_pace(
    tmp_path: Path, zenoh_router: str
) -> None:
    path = tmp_path / "r.mcap"
    model = RadioModelUpdate(t=0.0, area="a", version=1)
    with RecordingWriter(path, "test", Path("site.yaml")) as writer:
        writer.write(KEYS.radio_model("a"), model, Trace("old", 0.0, 100.0))
        for n in range(5000):
            writer.write(KEYS.detections("c"), frame(n), Trace(f"f{n}", 0.0, 3700.0 + n / 50))
        mark = ChunkMark(t=0.0, area="a", chunk=0, t_start=0.0, t_end=1.0, consumed=["f4999", "old"])
        writer.write(KEYS.chunks("a"), mark, Trace("m", 0.0, 3801.0))
        writer.write(KEYS.tracks("a"), TrackFrame(t=0.0, area="a", chunk=0, tracker="x"), Trace("t", 0.0, 3801.0))
    (chunk,) = Recording(path).consumed("a")
    assert chunk.inputs == (frame(4999), model)
    assert chunk.missing == 0

    class Impatient(threading.Event):
        longest = 0.0

        def wait(self, timeout: float | None = None) -> bool:
            self.longest = max(self.longest, timeout or 0.0)
            return False

    stopping = Impatient()
    with Bus([zenoh_router]) as bus:
        assert play(Recording(path), bus, 1.0, stopping) == 5001
    assert stopping.longest < 200.0  # of the frames' own time, not of the hour before
