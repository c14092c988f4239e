"""Arrays in a saved state: exact to the bit, small where they can be, quick where they cannot."""

from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from services.fusion.snapshot import encode_snapshot, unpack

RNG = np.random.default_rng(8)
DENSE = RNG.normal(size=(100, 900))
HARDLY_EVER = np.where(RNG.random((300, 900)) < 0.01, 1.5, 0.0)


@pytest.mark.parametrize(
    "array",
    [
        DENSE,
        DENSE.T,
        DENSE[:, ::7],
        HARDLY_EVER,
        np.array([np.nan, np.inf, -np.inf, -0.0]),
        np.zeros((0, 5)),
        np.array(3.5),
        RNG.integers(0, 400, (60, 70, 26)),
        RNG.random((90, 90)) < 0.5,
    ],
    ids=["dense", "transposed", "strided", "sparse", "odd floats", "empty", "scalar", "integers", "booleans"],
)
def test_what_is_read_is_what_was_written(array: NDArray[Any]) -> None:
    read = unpack(msgspec.json.decode(encode_snapshot({"a": array}))["a"])
    assert (read.dtype, read.shape) == (array.dtype, array.shape)
    assert read.tobytes() == array.tobytes()
    assert read.flags.writeable


def test_what_was_never_heard_takes_no_room_and_what_does_not_compress_no_more_than_it_must() -> None:
    assert len(encode_snapshot(HARDLY_EVER)) < 0.05 * HARDLY_EVER.nbytes
    assert len(encode_snapshot(DENSE)) < 1.34 * DENSE.nbytes
