"""One thread that takes what waits at once, small tasks first: what comes one by one is worked on as arrays."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import structlog

__all__ = ["ClosedError", "FullError", "GroupWorker"]

T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")

LARGEST_GROUP = 64
"""More would let the first of a group wait too long for the last."""
HEAVIEST_GROUP = 20_000
"""Weight of all tasks of a group, unless one alone is heavier."""
LIGHT = 1000
"""Weight up to which a task goes before heavy ones."""
TICK = 1.0
"""Seconds without work after which the thread looks after other things."""

log = structlog.get_logger(__name__)


class FullError(RuntimeError):
    """More waits than may."""


class ClosedError(RuntimeError):
    """The worker has been closed."""


@dataclass(slots=True)
class _Waiting(Generic[T, R]):
    task: T
    answer: Future[R] | asyncio.Future[R]
    weight: int
    owner: str


class GroupWorker(Generic[T, R]):
    """Answers tasks in groups; everything it calls runs in its one thread.

    Light tasks go first, and heavy ones in between, a group of light ones and one of heavy ones in turn. The tasks of
    one owner stay in their order: a light one waits behind a heavy one of the same owner.

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
        self._light: deque[_Waiting[T, R]] = deque()
        self._heavy: deque[_Waiting[T, R]] = deque()
        self._heavy_of: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, task: T, weight: int = 0, owner: str = "") -> Future[R]:
        """Let a task wait for its turn; from any thread.

        Args:
            task: what ``work`` takes.
            weight: how long it takes, compared with ``HEAVIEST_GROUP``.
            owner: whose tasks stay in order.

        Raises:
            FullError: too many wait.
            ClosedError: nobody works any more.
        """
        answer: Future[R] = Future()
        self._append(_Waiting(task, answer, weight, owner))
        return answer

    def submit_soon(self, task: T, weight: int = 0, owner: str = "") -> asyncio.Future[R]:
        """Let a task wait for its turn; from an event loop, whose future it returns.

        Args:
            task: what ``work`` takes.
            weight: how long it takes, compared with ``HEAVIEST_GROUP``.
            owner: whose tasks stay in order.

        Raises:
            FullError: too many wait.
            ClosedError: nobody works any more.
        """
        answer: asyncio.Future[R] = asyncio.get_running_loop().create_future()
        self._append(_Waiting(task, answer, weight, owner))
        return answer

    def call(self, function: Callable[[], S]) -> S:
        """Return what a function returns that is called in the worker's thread, between groups.

        Raises:
            ClosedError: nobody works any more.
        """
        if threading.current_thread() is self._thread:
            return function()
        answer: Future[S] = Future()

        def run() -> None:
            try:
                answer.set_result(function())
            except Exception as error:
                answer.set_exception(error)

        self._put(run)
        return answer.result()

    def close(self) -> None:
        """Answer what waits, then end the thread."""
        with self._lock:
            self._closed = True
            self._queue.put(None)
        self._thread.join()

    def _append(self, waiting: _Waiting[T, R]) -> None:
        if self._queue.qsize() + len(self._light) + len(self._heavy) >= self._most:
            raise FullError
        self._put(waiting)

    def _put(self, entry: _Waiting[T, R] | Callable[[], None]) -> None:
        with self._lock:
            if self._closed:
                raise ClosedError("the worker has been closed")
            self._queue.put(entry)

    def _run(self) -> None:
        ending = False
        while not (ending and not self._light and not self._heavy):
            ending = self._sort(wait=not (ending or self._light or self._heavy)) or ending
            for tasks in (self._light, self._heavy):
                group = self._take(tasks)
                if group:
                    self._answer(group)
                    self._look_after_things()

    def _sort(self, wait: bool) -> bool:
        """Sort what has come by weight and call what is to be called; whether the last has come."""
        try:
            entry = self._queue.get(timeout=TICK) if wait else self._queue.get_nowait()
            while entry is not None:
                if isinstance(entry, _Waiting):
                    heavy = entry.weight > LIGHT or entry.owner in self._heavy_of
                    if heavy:
                        self._heavy_of[entry.owner] += 1
                    (self._heavy if heavy else self._light).append(entry)
                else:
                    entry()
                entry = self._queue.get_nowait()
        except queue.Empty:
            if wait and not self._light and not self._heavy:
                self._look_after_things()
            return False
        return True

    def _take(self, tasks: deque[_Waiting[T, R]]) -> list[_Waiting[T, R]]:
        group: list[_Waiting[T, R]] = []
        weight = 0
        while tasks and len(group) < LARGEST_GROUP and (not group or weight + tasks[0].weight <= HEAVIEST_GROUP):
            group.append(tasks.popleft())
            weight += group[-1].weight
        if tasks is self._heavy:
            for waiting in group:
                self._heavy_of[waiting.owner] -= 1
                if not self._heavy_of[waiting.owner]:
                    del self._heavy_of[waiting.owner]
        return group

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
