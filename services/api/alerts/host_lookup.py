"""Where is a host? Asked of the system in threads of their own: a name server that hangs holds up nobody else.

The system's lookup cannot be broken off. Those of one name share one thread, so that a webhook whose name server hangs
takes one; and there is a bound to all of them.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Future

__all__ = ["HostLookup"]

PATIENCE = 5.0
"""Seconds."""

Ask = Callable[[str, int], list[str]]


def _ask_system(host: str, port: int) -> list[str]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))


class HostLookup:
    """A ``Resolve``; of any thread and event loop.

    Args:
        most: names that are looked up at once; of one more is said that it cannot be.
        ask: returns the addresses of a host and port, and may take as long as it likes.
    """

    def __init__(self, most: int, ask: Ask = _ask_system) -> None:
        self._most = most
        self._ask = ask
        self._lock = threading.Lock()
        self._under_way: dict[tuple[str, int], Future[list[str]]] = {}

    async def __call__(self, host: str, port: int) -> list[str]:
        """Return the addresses of a host.

        Raises:
            OSError: its name is not known, nobody answers, or too many others are being looked up.
        """
        async with asyncio.timeout(PATIENCE):
            return await asyncio.wrap_future(self._begun(host, port))

    def _begun(self, host: str, port: int) -> Future[list[str]]:
        name = (host, port)
        with self._lock:
            begun = self._under_way.get(name)
            if begun is None:
                if len(self._under_way) >= self._most:
                    raise OSError(f"{self._most} names are being looked up")
                begun = self._under_way[name] = Future()
                begun.set_running_or_notify_cancel()  # whoever loses patience does not end it for the others
                threading.Thread(target=self._work, args=(name, begun), name="host lookup", daemon=True).start()
            return begun

    def _work(self, name: tuple[str, int], begun: Future[list[str]]) -> None:
        try:
            found: list[str] | Exception = self._ask(*name)
        except Exception as error:  # told to whoever asked
            found = error
        with self._lock:
            del self._under_way[name]
        if isinstance(found, Exception):
            begun.set_exception(found)
        else:
            begun.set_result(found)
