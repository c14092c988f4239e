"""Messages survive the wire, and nothing that is not a message gets in."""

import contextlib
import json
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.messages import (
    Alert,
    CameraStatus,
    ChunkMark,
    DetectionFrame,
    InertialColumns,
    Message,
    MessageError,
    MotionBatch,
    RadioScan,
    StrideModel,
    TrackFrame,
    covariances,
    decode,
    encode,
    pack_covariances,
    positions,
)
from shared.truth import GroundTruth

KINDS: list[type[Message]] = [
    Alert,
    CameraStatus,
    ChunkMark,
    DetectionFrame,
    GroundTruth,
    MotionBatch,
    RadioScan,
    StrideModel,
    TrackFrame,
]
number = st.floats(allow_nan=False, allow_infinity=False)
share = st.floats(0.0, 1.0)
name = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True)


def _of(kind: Any) -> st.SearchStrategy[Any]:
    info = msgspec.inspect
    if isinstance(kind, info.Metadata):
        return _of(kind.type)
    if isinstance(kind, info.FloatType):
        return share if kind.ge == 0.0 and kind.le == 1.0 else number
    if isinstance(kind, info.BoolType):
        return st.booleans()
    if isinstance(kind, info.IntType):
        return st.integers(0, 2**40)
    if isinstance(kind, info.StrType):
        return st.text(max_size=12)
    if isinstance(kind, info.NoneType):
        return st.none()
    if isinstance(kind, info.LiteralType):
        return st.sampled_from(kind.values)
    if isinstance(kind, info.UnionType):
        return st.one_of([_of(member) for member in kind.types])
    if isinstance(kind, info.TupleType):
        return st.tuples(*[_of(member) for member in kind.item_types])
    if isinstance(kind, info.ListType):
        return st.lists(_of(kind.item_type), max_size=4)
    raise AssertionError(f"no strategy for {kind}")


@st.composite
def messages(draw: st.DrawFn) -> Message:
    kind = draw(st.sampled_from(KINDS))
    rows, events = draw(st.integers(0, 5)), draw(st.integers(0, 3))
    described = msgspec.inspect.type_info(kind)
    assert isinstance(described, msgspec.inspect.StructType)
    values = {}
    for field in described.fields:
        size = rows if field.name in kind.columns() else None
        if field.name in kind.optional_columns():
            size = draw(st.sampled_from([0, rows]))
        if field.name in kind.event_columns():
            size = events
        if size is not None:
            assert isinstance(field.type, msgspec.inspect.ListType)
            values[field.name] = draw(st.lists(_of(field.type.item_type), min_size=size, max_size=size))
        else:
            values[field.name] = draw(_of(field.type))
    return kind(**values)


@given(messages())
def test_every_message_comes_back_as_it_was_sent(message: Message) -> None:
    assert decode(encode(message), type(message)) == message


@given(messages())
def test_encoding_is_a_pure_function_so_recordings_replay_to_the_byte(message: Message) -> None:
    wire = encode(message)
    assert encode(decode(wire, type(message))) == wire


@given(messages(), st.dictionaries(st.text(max_size=8).map("x-".__add__), st.integers() | st.text() | st.none()))
def test_fields_of_a_later_version_are_ignored(message: Message, extra: dict[str, object]) -> None:
    document = json.loads(encode(message)) | extra
    assert decode(json.dumps(document).encode(), type(message)) == message


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.columns()])
def test_columns_of_different_length_are_refused_where_made_and_where_read(kind: type[Message]) -> None:
    required = {
        "camera": "c", "floor": "f", "seq": 1, "device": "d", "t_start": 0.0, "activity": "still",
        "area": "a", "chunk": 1, "tracker": "gnn",
    }  # fmt: skip
    fields = [f for f in kind.__struct_fields__ if f in required and f not in kind.columns()]
    ragged = kind.columns()[0]
    values: dict[str, Any] = {"t": 1.0, **{f: required[f] for f in fields}}
    sample: Any = 1 if ragged == "track" else "p" if ragged in ("access_point", "person") else 0.5
    with pytest.raises(ValueError, match=r"columns of different lengths.*" + ragged):
        kind(**values, **{ragged: [sample]})
    with pytest.raises(MessageError, match=rf"{kind.__name__}.*columns of different lengths"):
        decode(json.dumps(values | {ragged: [sample]}).encode(), kind)


@pytest.mark.parametrize("poison", [math.nan, math.inf, -math.inf])
def test_a_position_that_is_no_number_cannot_travel(poison: float) -> None:
    frame = DetectionFrame(
        t=1.0, camera="c", floor="f", seq=1,
        x=[poison], y=[0.0], covariance=[(1.0, 0.0, 1.0)], confidence=[0.5], box=[(0.0, 0.0, 1.0, 1.0)],
    )  # fmt: skip
    with pytest.raises(MessageError, match=r"float.*null.*\$\.x\[0\]"):
        decode(encode(frame), DetectionFrame)


def test_a_time_of_measurement_that_is_no_number_is_refused() -> None:
    with pytest.raises(MessageError, match=r"\$\.t"):
        decode(encode(RadioScan(t=math.nan, device="d", seq=1)), RadioScan)


@pytest.mark.parametrize("missing", ["t", "device", "seq"])
def test_a_missing_field_is_named(missing: str) -> None:
    document = {"t": 1.0, "device": "d", "seq": 1}
    del document[missing]
    with pytest.raises(MessageError, match=rf"RadioScan.*missing required field `{missing}`"):
        decode(json.dumps(document).encode(), RadioScan)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("seq", "one"),
        ("seq", 1.5),
        ("device", 7),
        ("kind", "zigbee"),
        ("access_point", "ap-1"),
        ("rssi", [None]),
        ("rssi", ["-60"]),
        ("t", "now"),
        ("t", None),
    ],
)
def test_a_wrong_type_is_named_with_its_place(field: str, value: object) -> None:
    document = {"t": 1.0, "device": "d", "seq": 1, field: value}
    with pytest.raises(MessageError, match=rf"RadioScan: .*\$\.{field}"):
        decode(json.dumps(document).encode(), RadioScan)


def test_a_probability_above_one_is_refused() -> None:
    document = {"t": 1, "camera": "c", "floor": "f", "seq": 0, "x": [0], "y": [0], "covariance": [[1, 0, 1]]}
    document |= {"confidence": [1.2], "box": [[0, 0, 1, 1]]}
    with pytest.raises(MessageError, match=r"\$\.confidence\[0\]"):
        decode(json.dumps(document).encode(), DetectionFrame)


@pytest.mark.parametrize(
    "payload",
    [b"", b"null", b"[]", b"{", b"\xff\xfe", b'{"t": 1e999}', b'{"t": NaN}', b"7", b'"text"', b"{}" * 2],
)
def test_what_is_no_message_is_an_error_of_ours(payload: bytes) -> None:
    with pytest.raises(MessageError, match="RadioScan: "):
        decode(payload, RadioScan)


@given(st.binary(max_size=200))
def test_random_bytes_never_raise_anything_else(payload: bytes) -> None:
    with contextlib.suppress(MessageError):
        decode(payload, TrackFrame)


def test_a_bomb_of_brackets_in_an_ignored_field_is_refused_not_fatal() -> None:
    payload = b'{"t":1,"device":"d","seq":1,"later":' + b"[" * 200_000 + b"]" * 200_000 + b"}"
    with pytest.raises(MessageError):
        decode(payload, RadioScan)


def test_raw_samples_need_their_axes() -> None:
    columns: dict[str, list[float]] = {axis: [0.0] for axis in ("t", "ax", "ay", "az", "gx", "gy", "gz")}
    assert msgspec.convert(columns, InertialColumns).mx == []
    del columns["gy"]
    with pytest.raises(msgspec.ValidationError, match="gy"):
        msgspec.convert(columns, InertialColumns)


@given(st.lists(st.tuples(number, number, number, number, number), max_size=5))
def test_positions_and_covariances_come_out_as_arrays(rows: list[tuple[float, float, float, float, float]]) -> None:
    frame = DetectionFrame(
        t=0.0, camera="c", floor="f", seq=0,
        x=[r[0] for r in rows], y=[r[1] for r in rows], covariance=[(r[2], r[3], r[4]) for r in rows],
        confidence=[1.0] * len(rows), box=[(0.0, 0.0, 1.0, 1.0)] * len(rows),
    )  # fmt: skip
    assert positions(frame).shape == (len(rows), 2)
    matrices = covariances(frame)
    assert matrices.shape == (len(rows), 2, 2)
    assert np.array_equal(matrices, matrices.transpose(0, 2, 1))
    assert pack_covariances(matrices) == frame.covariance
