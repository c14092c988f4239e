"""The process in which other detector options are tried; its parent gives it what time nobody else wants.

The parent sends a job and then picture after picture through its standard input; the answer leaves by standard output.
"""

from __future__ import annotations

import pickle
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from typing import BinaryIO

import cv2
import msgspec

from services.camera.frame_ring import KeptFrame
from services.camera.redetection import Job, redetect

__all__ = ["send"]

_HEAD = struct.Struct("<dI")
"""Of each picture: time and length."""


def send(stream: BinaryIO, job: Job, kept: Sequence[KeptFrame]) -> None:
    """Write a job and its pictures for a worker, one by one: no second copy of all of them is made."""
    packed = pickle.dumps(job)
    stream.write(struct.pack("<I", len(packed)) + packed)
    for frame in kept:
        stream.write(_HEAD.pack(frame.t, len(frame.jpeg)))
        stream.write(frame.jpeg)


def _received(stream: BinaryIO) -> Iterator[KeptFrame]:
    while head := stream.read(_HEAD.size):
        t, length = _HEAD.unpack(head)
        yield KeptFrame(t, stream.read(length))


def _work() -> None:
    began = time.perf_counter()
    stream = sys.stdin.buffer
    # From our own parent process, over a pipe nobody else holds.
    job: Job = pickle.loads(stream.read(struct.unpack("<I", stream.read(4))[0]))  # noqa: S301
    told = redetect(job, _received(stream))
    for _ in _received(stream):  # what is later than was asked for: let the parent finish its sentence
        pass
    told = msgspec.structs.replace(told, took=time.perf_counter() - began)
    sys.stdout.buffer.write(msgspec.json.encode(told))


if __name__ == "__main__":
    cv2.setNumThreads(1)
    _work()
