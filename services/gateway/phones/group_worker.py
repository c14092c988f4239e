"""One thread that takes everything waiting at once: what comes one by one is worked on as arrays."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import structlog

__all__ = ["FullError", "GroupWorker"]

T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")

LARGEST_GROUP = 64
"""More would let the first of a group wait too long for the last."""
TICK = 1.0
"""Seconds without work after which the thread looks after other things."""

log = structlog.get_logger(__name__)


class FullError(RuntimeError):
    """More waits than may."""


@dataclass(slots=True)
class _Waiting(Generic[T, R]):
    task: T
    answer: Future[R] | asyncio.Future[R]


class GroupWorker(Generic[T, R]):
    """Answers tasks, in their order, in groups; everything it calls runs in its one thread.

    Args:
        work: answers a group: a result or an exception for each task.
        most: tasks that may wait at once.
        tick: called between groups, at least every ``TICK`` seconds.
        name: of the thread.
    """

    def __init__(
        self, work: Callable[[Sequence[T]], Sequence[R | Exception]], most: int, tick: Callable[[], None], name: str
    ) -> None:
        self._work = work
        self._most = most
        self._tick = tick
        self._queue: queue.SimpleQueue[_Waiting[T, R] | Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, task: T) -> Future[R]:
        """Let a task wait for its turn; from any thread.

        Raises:
            FullError: too many wait.
        """
        answer: Future[R] = Future()
        self._append(_Waiting(task, answer))
        return answer

    def submit_soon(self, task: T) -> asyncio.Future[R]:
        """Let a task wait for its turn; from an event loop, whose future it returns.

        Raises:
            FullError: too many wait.
        """
        answer: asyncio.Future[R] = asyncio.get_running_loop().create_future()
        self._append(_Waiting(task, answer))
        return answer

    def call(self, function: Callable[[], S]) -> S:
        """Return what a function returns that is called in the worker's thread, after all that waits now."""
        if not self._thread.is_alive() or threading.current_thread() is self._thread:
            return function()
        answer: Future[S] = Future()

        def run() -> None:
            try:
                answer.set_result(function())
            except Exception as error:
                answer.set_exception(error)

        self._queue.put(run)
        return answer.result()

    def close(self) -> None:
        """Answer what waits, then end the thread."""
        self._queue.put(None)
        self._thread.join()

    def _append(self, waiting: _Waiting[T, R]) -> None:
        if self._queue.qsize() >= self._most:
            raise FullError
        self._queue.put(waiting)

    def _run(self) -> None:
        group: list[_Waiting[T, R]] = []
        while True:
            try:
                entry = self._queue.get(timeout=TICK)
                while isinstance(entry, _Waiting):
                    group.append(entry)
                    if len(group) >= LARGEST_GROUP:
                        break
                    entry = self._queue.get_nowait()
            except queue.Empty:
                entry = group[-1] if group else self._look_after_things
            if group:
                self._answer(group)
                group = []
                self._look_after_things()
            if entry is None:
                return
            if callable(entry):
                entry()

    def _look_after_things(self) -> None:
        try:
            self._tick()
        except Exception:
            log.exception("not looked after")

    def _answer(self, group: list[_Waiting[T, R]]) -> None:
        try:
            results = self._work([waiting.task for waiting in group])
        except Exception as error:
            log.exception("a group failed", tasks=len(group))
            results = [error] * len(group)
        of_loop: dict[asyncio.AbstractEventLoop, list[tuple[asyncio.Future[R], R | Exception]]] = {}
        for waiting, result in zip(group, results, strict=True):
            if isinstance(waiting.answer, asyncio.Future):
                of_loop.setdefault(waiting.answer.get_loop(), []).append((waiting.answer, result))
            else:
                _settle([(waiting.answer, result)])
        for loop, answers in of_loop.items():
            try:
                loop.call_soon_threadsafe(_settle, answers)  # once for the group: each wakes the loop
            except RuntimeError:
                log.info("nobody waits any more", answers=len(answers))  # the loop has been closed


def _settle(answers: Sequence[tuple[Any, Any]]) -> None:
    for answer, result in answers:
        if answer.done():
            continue  # whoever asked went away
        if isinstance(result, Exception):
            answer.set_exception(result)
        else:
            answer.set_result(result)
