"""Answers questions for a still: off by default, opened by name for some minutes, never often, always logged."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import cast

import cv2
import msgspec
import numpy as np
import structlog
from prometheus_client import Counter

from services.camera.checkerboard import find_board
from services.camera.detector import Image
from shared.bus import Question
from shared.camera_still import StillAnswer, StillQuestion

__all__ = ["StillDesk"]

EVERY = 1.0
"""Seconds between two answers that need the picture: a still is for an installer, not a video."""
QUALITY = 92

log = structlog.get_logger(__name__)

STILLS = Counter("atrium_camera_stills_total", "Questions for a still, by what came of them", ["camera", "result"])


class StillDesk:
    """Keeps the newest picture of one camera, if stills are allowed at all, and hands it out on demand.

    Args:
        camera: its id.
        allowed: the setting ``allow_stills``; where it is off no picture is kept here.
        minutes: how long an operator's permission lasts.
        now: wall clock, seconds since the epoch.
        clock: seconds that only grow.
        trouble: returns why no picture comes, in plain words; empty where one may still come.
    """

    def __init__(
        self,
        camera: str,
        allowed: bool,
        minutes: float,
        now: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
        trouble: Callable[[], str] = lambda: "",
    ) -> None:
        self._camera = camera
        self._allowed = allowed
        self._minutes = minutes
        self._trouble = trouble
        self._now, self._clock = now, clock
        self._until = -1.0
        self._last = -EVERY
        self._newest: tuple[Image, float] | None = None
        self._lock = threading.Lock()

    def offer(self, image: Image, t: float) -> None:
        """Take note of the newest picture, taken at ``t``; nobody may write into it afterwards."""
        if self._allowed:
            self._newest = (image, t)

    def take(self, question: Question) -> None:
        """Answer a question; what takes long is done in a thread of its own."""
        try:
            asked = msgspec.json.decode(question.payload, type=StillQuestion)
        except msgspec.MsgspecError as error:
            self._refuse(question, StillAnswer(refusal="not-understood", words=f"the question: {error}"))
            return
        answer, picture = self._admit(asked)
        if picture is None:
            self._tell(asked, answer)
            question.answer(msgspec.json.encode(answer))
            return
        threading.Thread(target=self._show, args=(question, asked, answer, *picture), name="still", daemon=True).start()

    def close(self) -> None:
        """Forget the picture and the permission: the service stops."""
        self._allowed = False
        self._newest = None

    def _admit(self, asked: StillQuestion) -> tuple[StillAnswer, tuple[Image, float] | None]:
        """Return a refusal or the beginning of an answer, and the picture where one may be shown."""
        if not self._allowed:
            words = (
                f"camera {self._camera} gives no pictures away: its setting allow_stills is off "
                "(ATRIUM_ALLOW_STILLS=true for its process, and start it again)"
            )
            return StillAnswer(refusal="off", words=words), None
        with self._lock:
            now, clock = self._now(), self._clock()
            if asked.do == "open":
                self._until = clock + 60.0 * self._minutes
                words = f"camera {self._camera} gives stills for {self._minutes:g} minutes"
                return StillAnswer(words=words, until=now + 60.0 * self._minutes), None
            left = self._until - clock
            if left <= 0.0:
                words = f"stills of camera {self._camera} are not open now: open them first"
                return StillAnswer(refusal="closed", words=words), None
            if clock - self._last < EVERY:
                return StillAnswer(refusal="busy", words="one still a second: ask again", until=now + left), None
            if self._newest is None:
                words = f"camera {self._camera} has no picture yet: {self._trouble() or 'ask again in some seconds'}"
                return StillAnswer(refusal="no-picture", words=words, until=now + left), None
            self._last = clock
            return StillAnswer(until=now + left), self._newest

    def _show(self, question: Question, asked: StillQuestion, answer: StillAnswer, image: Image, t: float) -> None:
        height, width = image.shape[:2]
        shown = msgspec.structs.replace(answer, t=t, width=width, height=height)
        try:
            if asked.do == "board":
                corners = find_board(image, asked.columns, asked.rows)
                if corners is None:
                    words = (
                        f"no checkerboard with {asked.columns} x {asked.rows} inner corners is seen whole in the "
                        "picture: flat, evenly lit, with a white border, and near enough"
                    )
                    shown = msgspec.structs.replace(shown, refusal="no-board", words=words)
                else:
                    shown = msgspec.structs.replace(shown, corners=[(float(u), float(v)) for u, v in corners])
            else:
                coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
                shown = msgspec.structs.replace(shown, jpeg=cast(np.ndarray, coded).tobytes())
        except (cv2.error, ValueError) as error:
            shown = msgspec.structs.replace(answer, refusal="not-understood", words=str(error))
        self._tell(asked, shown)
        question.answer(msgspec.json.encode(shown))

    def _tell(self, asked: StillQuestion, answer: StillAnswer) -> None:
        result = answer.refusal or {"open": "opened", "look": "given", "board": "corners"}[asked.do]
        STILLS.labels(self._camera, result).inc()
        log.warning("still", camera=self._camera, do=asked.do, by=asked.by[:64], result=result, bytes=len(answer.jpeg))

    def _refuse(self, question: Question, answer: StillAnswer) -> None:
        STILLS.labels(self._camera, answer.refusal).inc()
        question.answer(msgspec.json.encode(answer))
