"""Takes questions about detector options from the bus: answers wrong ones at once, tries one at a time elsewhere."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, BinaryIO, cast

import cv2
import msgspec
import numpy as np
import structlog
from numpy.typing import NDArray

from services.camera.detector import Image
from services.camera.frame_ring import FrameRing, KeptFrame, unpack
from services.camera.redetect_worker import send
from services.camera.redetection import Job, RedetectError, read_question, reported
from shared.bus import Question
from shared.site import Camera

__all__ = ["RedetectDesk"]

LEAST_NICE = 19
"""The lowest priority there is."""

log = structlog.get_logger(__name__)


class RedetectDesk:
    """Answers one camera's questions.

    Args:
        camera: returns the camera as it is calibrated now.
        floor: id of the floor it watches.
        detector: name of the detector.
        configured: its options as configured.
        ring: the last minutes' pictures.
        empty: returns the scene without people, or None while it is not known.
        alignment: returns the learned correction of the plan (3, 3) in use, and its version.
        sizes: returns how tall and wide people were seen to be, as options; empty while that is not known.
        doubt: returns why the view cannot teach, in plain words; empty where it can.
        patience: seconds a trial may take.
    """

    def __init__(
        self,
        camera: Callable[[], Camera],
        floor: str,
        detector: str,
        configured: Mapping[str, Any],
        ring: FrameRing,
        empty: Callable[[], Image | None],
        alignment: Callable[[], tuple[NDArray[np.float64], int]],
        sizes: Callable[[], Mapping[str, float]],
        doubt: Callable[[], str],
        patience: float,
    ) -> None:
        self._camera, self._floor = camera, floor
        self._detector, self._configured = detector, configured
        self._ring = ring
        self._empty = empty
        self._alignment = alignment
        self._sizes = sizes
        self._doubt = doubt
        self._patience = patience
        self._free = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def take(self, question: Question) -> None:
        """Answer a question, soon or when its trial is over; returns at once."""
        try:
            options, since, until = read_question(question.payload, self._detector, self._configured)
        except RedetectError as error:
            question.answer(_refusal(str(error)))
            return
        if not self._ring.keeps:
            question.answer(_refusal("no pictures: none are kept, ring_megabytes is 0"))
            return
        if doubt := self._doubt():
            question.answer(_refusal(f"its pictures cannot teach: {doubt}"))
            return
        if self._closed or not self._free.acquire(blocking=False):
            question.answer(_refusal("busy: other options are being tried; ask again later"))
            return
        threading.Thread(target=self._try, args=(question, options, since, until), name="redetect", daemon=True).start()

    def close(self) -> None:
        """End what is being tried: the service stops."""
        self._closed = True
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def _try(self, question: Question, options: Mapping[str, Any], since: float | None, until: float | None) -> None:
        try:
            kept = self._ring.ask()
            try:
                begin, end = reported(kept, since, until)
            except RedetectError as error:
                question.answer(_refusal(str(error)))
                return
            job = Job(
                self._camera(),
                self._floor,
                self._detector,
                options,
                self._ring.size,
                _resized(self._empty(), kept[-1]),
                begin,
                end,
                *self._alignment(),
                self._sizes(),
            )
            question.answer(self._run(job, kept))
            self._ring.ask()  # the next question's patience begins now
        finally:
            self._free.release()

    def _run(self, job: Job, kept: Sequence[KeptFrame]) -> bytes:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(
            [sys.executable, "-m", "services.camera.redetect_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
        ) as self._process:
            _give_way(self._process.pid)
            expired = threading.Event()
            late = threading.Timer(self._patience, _end, (self._process, expired))
            late.start()
            try:
                if self._closed:
                    self._process.kill()
                with contextlib.suppress(BrokenPipeError):  # its status says why
                    send(cast(BinaryIO, self._process.stdin), job, kept)
                told, said = self._process.communicate()
            finally:
                late.cancel()
        if self._process.returncode != 0:
            if expired.is_set():
                return _refusal(
                    f"the trial took more than {self._patience:g} s: the machine has little time to spare, "
                    "or too many pictures are kept (ring_minutes)"
                )
            log.warning("a trial failed", status=self._process.returncode, reason=said.decode(errors="replace")[-500:])
            return _refusal("the trial failed; the camera's log says why")
        return told


def _end(process: subprocess.Popen[bytes], expired: threading.Event) -> None:
    expired.set()  # first: what waits for the process goes on as soon as it is gone
    process.kill()


def _give_way(process: int) -> None:
    """Let a process have only what time nobody else wants: live pictures, ours and other cameras', come first."""
    with contextlib.suppress(OSError):  # it ended already, or this machine's owner forbids it
        os.setpriority(os.PRIO_PROCESS, process, LEAST_NICE)
        if hasattr(os, "SCHED_IDLE"):
            os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))


def _resized(empty: Image | None, like: KeptFrame) -> Image | None:
    if empty is None:
        return None
    height, width = unpack(like).shape[:2]
    return cast(Image, cv2.resize(empty, (width, height), interpolation=cv2.INTER_AREA))


def _refusal(words: str) -> bytes:
    return msgspec.json.encode({"error": words})
