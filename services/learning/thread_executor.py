"""One thing at a time in a thread that ends with the process, whatever it waits for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

__all__ = ["DaemonExecutor"]


class DaemonExecutor(Executor):
    """Runs each call in a daemon thread of its own.

    ``ThreadPoolExecutor`` joins its threads when the interpreter ends: a service told to stop while fusion tries a
    candidate would stand there for minutes.
    """

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Begin a call; the future holds what comes of it."""
        future: Future[Any] = Future()

        def work() -> None:
            try:
                future.set_result(fn(*args, **kwargs))
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=work, name="trial", daemon=True).start()
        return future
