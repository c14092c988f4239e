"""Recordings: MCAP files of what travelled on the bus, with the JSON schema of every message embedded.

Each message is stored as it was sent, with one more field, ``trace``, the id under which fusion's chunk marks name it.
A mark lists exactly what fusion consumed, in order, so the order of arrival at the recorder does not matter.
"""

from __future__ import annotations

import io
import json
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import msgspec
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from shared.bus import Trace
from shared.keys import Keys
from shared.messages import (
    Alert,
    CameraStatus,
    ChunkMark,
    DetectionFrame,
    Erasure,
    Message,
    MotionBatch,
    RadioModelUpdate,
    RadioScan,
    Revision,
    TrackFrame,
    decode,
    encode,
)

__all__ = [
    "RECORDED_KINDS",
    "TOPICS",
    "Consumed",
    "Recorded",
    "Recording",
    "RecordingError",
    "RecordingWriter",
    "check_writable",
]

TOPICS: dict[type[Message], Callable[[Keys], str]] = {
    DetectionFrame: Keys.detections,
    RadioScan: Keys.radio,
    MotionBatch: Keys.motion,
    Erasure: Keys.erasure,
    RadioModelUpdate: Keys.radio_model,
    ChunkMark: Keys.chunks,
    TrackFrame: Keys.tracks,
    Revision: Keys.revisions,
    CameraStatus: Keys.camera_status,
    Alert: Keys.alert,
}
"""What is recorded, and on which keys it travels."""
RECORDED_KINDS: dict[str, type[Message]] = {kind.__name__: kind for kind in TOPICS}
INPUT_KINDS = (DetectionFrame, RadioScan, MotionBatch, Erasure, RadioModelUpdate)
STATE_KINDS = (CameraStatus, Erasure, RadioModelUpdate)
"""Of these a recorder also wants what was told before it began, for a chunk may name it at any time."""

LOOK_AHEAD = 10.0
"""Seconds of recording in which an input may follow the mark that names it."""


class RecordingError(ValueError):
    """The file is not a recording of Atrium, or does not hold what is asked for; the text names the file."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """One message of a recording."""

    key: str
    message: Message
    trace: str
    sent: float


@dataclass(frozen=True, slots=True)
class Consumed:
    """What fusion consumed in one chunk, in order, and the tracks it made of it (None if they were not recorded).

    ``process`` names the fusion process that did: it changes when fusion was started anew.
    """

    mark: ChunkMark
    inputs: tuple[Message, ...]
    missing: int
    tracks: TrackFrame | None
    process: str


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written, before anything is started for it.

    Raises:
        RecordingError: naming the file and the reason.
    """
    try:
        path.open("ab").close()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


class RecordingWriter:
    """Writes one recording; use as a context manager so that the file is finished properly."""

    def __init__(self, path: Path, site: str, site_file: Path) -> None:
        self.counts: Counter[str] = Counter()
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=256 * 1024)
        self._writer.start(profile="", library="atrium")
        self._writer.add_metadata("atrium", {"site": site, "site_file": str(site_file)})
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._last_time = 0

    def write(self, key: str, message: Message, trace: Trace) -> None:
        """Append one message."""
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._writer.register_channel(key, "json", self._schema(type(message)))
        # Readers order by log time: it is the time of sending, made strictly increasing.
        self._last_time = max(self._last_time + 1, _nanoseconds(trace.sent))
        data = encode(message)[:-1] + b',"trace":' + json.dumps(trace.id).encode() + b"}"
        self._writer.add_message(channel, self._last_time, data, publish_time=_nanoseconds(message.t))
        self.counts[type(message).__name__] += 1

    def attach_state(self, area: str, answer: bytes, now: float) -> None:
        """Attach a tracker's state (fusion's answer to a state query) so that replay can begin in mid-run."""
        self._writer.add_attachment(
            _nanoseconds(now), max(self._last_time, 1), f"fusion-state/{area}", "application/json", answer
        )

    def close(self, dropped: int = 0) -> None:
        """Finish the file."""
        if self._file.closed:
            return
        summary = {name: str(count) for name, count in self.counts.items()}
        self._writer.add_metadata("atrium-summary", {**summary, "dropped": str(dropped)})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def __enter__(self) -> RecordingWriter:
        """Write within a block."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        """Finish the file."""
        self.close()

    def _schema(self, kind: type[Message]) -> int:
        name = kind.__name__
        if name not in self._schemas:
            # Viewers want one self-contained object schema, not a reference into definitions.
            (_,), definitions = msgspec.json.schema_components([kind])
            schema = {**definitions[name], "$defs": definitions}
            self._schemas[name] = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        return self._schemas[name]


class Recording:
    """Reads one recording.

    A recording whose writer was killed is read as far as it goes; ``truncated`` then says so after reading.

    Raises:
        RecordingError: the file cannot be read or is no recording of Atrium.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        try:
            with path.open("rb") as stream:
                first = next((record for record in StreamReader(stream).records if isinstance(record, Metadata)), None)
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror}") from error
        except McapError as error:
            raise RecordingError(f"{path}: not an MCAP file: {error or type(error).__name__}") from error
        if first is None or first.name != "atrium":
            raise RecordingError(f"{path}: an MCAP file, but not a recording of Atrium")
        self.site = first.metadata["site"]
        self.site_file = Path(first.metadata["site_file"])

    def messages(self) -> Iterator[Recorded]:
        """Yield every message in the order of the file.

        Raises:
            RecordingError: a message does not fit this version's messages.
        """
        with self.path.open("rb") as stream:
            reader = NonSeekingReader(stream)
            try:
                for schema, channel, record in reader.iter_messages(log_time_order=False):
                    kind = RECORDED_KINDS.get(schema.name if schema else "")
                    if kind is None:
                        continue
                    try:
                        message = decode(record.data, kind)
                        trace = _trace_of(record.data)
                    except (ValueError, msgspec.DecodeError) as error:
                        raise RecordingError(f"{self.path}: {channel.topic}: {error}") from error
                    yield Recorded(channel.topic, message, trace, record.log_time / 1e9)
            except (McapError, EOFError, io.UnsupportedOperation):
                self.truncated = True

    def state(self, area: str) -> bytes | None:
        """Return fusion's answer to the state query from which the recording is whole, if there was one.

        The recorder asks again while fusion still consumes what was sent before the recording began; the last counts.
        """
        state = None
        with self.path.open("rb") as stream:
            try:
                for record in StreamReader(stream).records:
                    if isinstance(record, Attachment) and record.name == f"fusion-state/{area}":
                        state = record.data
            except (McapError, EOFError):
                self.truncated = True
        return state

    def areas(self) -> list[str]:
        """Return the areas whose fusion was recorded."""
        return sorted(
            {recorded.message.area for recorded in self.messages() if isinstance(recorded.message, ChunkMark)}
        )

    def revisions(self, area: str) -> dict[int, Revision]:
        """Return what fusion of ``area`` revised, by the chunk with which it did."""
        key = Keys(self.site).revisions(area)
        found = (recorded.message for recorded in self.messages() if recorded.key == key)
        return {message.chunk: message for message in found if isinstance(message, Revision)}

    def consumed(self, area: str) -> Iterator[Consumed]:
        """Yield chunk by chunk what fusion of ``area`` consumed and what it published."""
        chunk_key, track_key = Keys(self.site).chunks(area), Keys(self.site).tracks(area)
        inputs: dict[str, tuple[Message, float]] = {}
        tracks: dict[int, TrackFrame] = {}
        marks: deque[tuple[ChunkMark, float, str]] = deque()
        for recorded in self.messages():
            message = recorded.message
            if isinstance(message, INPUT_KINDS):
                inputs[recorded.trace] = (message, recorded.sent)
            elif recorded.key == chunk_key and isinstance(message, ChunkMark):
                marks.append((message, recorded.sent, recorded.trace.rpartition("-")[0]))
            elif recorded.key == track_key and isinstance(message, TrackFrame):
                tracks[message.chunk] = message
            while marks and (_complete(marks[0][0], inputs, tracks) or recorded.sent > marks[0][1] + LOOK_AHEAD):
                yield _take(marks.popleft(), inputs, tracks)
            if len(inputs) > 4096:
                horizon = recorded.sent - 6.0 * LOOK_AHEAD
                inputs = {
                    trace: entry
                    for trace, entry in inputs.items()
                    if entry[1] > horizon or isinstance(entry[0], STATE_KINDS)
                }
        while marks:
            yield _take(marks.popleft(), inputs, tracks)


class _TraceOnly(msgspec.Struct):
    trace: str = ""


_trace_decoder = msgspec.json.Decoder(_TraceOnly)


def _trace_of(data: bytes) -> str:
    return _trace_decoder.decode(data).trace


def _nanoseconds(seconds: float) -> int:
    return max(0, round(seconds * 1e9))


def _complete(mark: ChunkMark, inputs: dict[str, tuple[Message, float]], tracks: dict[int, TrackFrame]) -> bool:
    return mark.chunk in tracks and all(trace in inputs for trace in mark.consumed)


def _take(
    entry: tuple[ChunkMark, float, str], inputs: dict[str, tuple[Message, float]], tracks: dict[int, TrackFrame]
) -> Consumed:
    mark, _, process = entry
    # Inputs stay in the buffer until they age: another area's marks may name the same radio scans.
    found = tuple(inputs[trace][0] for trace in mark.consumed if trace in inputs)
    return Consumed(mark, found, len(mark.consumed) - len(found), tracks.pop(mark.chunk, None), process)
