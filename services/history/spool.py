"""What waits for the database, on disk: files of framed entries, oldest first.

Everything passes through here, whether the database is there or not: what ``append`` returned from is on the disk, and
leaves it only when the database has it. So neither a database that is away nor a killed process loses anything.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
import zlib
from collections.abc import Sequence
from io import FileIO
from pathlib import Path

import msgspec

from services.history.entries import Entry, pack, unpack

__all__ = ["Spool", "SpoolFullError"]

_FRAME = struct.Struct("<II")
"""Length and checksum of an entry."""
LONGEST_FILE = 4 * 2**20
"""Bytes after which the next file begins: as much as is brought into the database at once."""


class SpoolFullError(OSError):
    """No more may wait: the text says how much does."""


class Spool:
    """A queue on disk between two threads: one appends, the other takes whole files and removes them.

    Args:
        folder: made if it does not exist; nobody else's.
        most: bytes that may wait.

    Raises:
        OSError: the folder cannot be made, read or written.
    """

    def __init__(self, folder: Path, most: int) -> None:
        self._folder = folder
        self._most = most
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "test-of-writing").write_bytes(b"")
        (folder / "test-of-writing").unlink()
        self._sizes = {path.name: path.stat().st_size for path in sorted(folder.glob("*.spool"))}
        self._number = max((int(name.partition("-")[0]) for name in self._sizes), default=0)
        self._open: tuple[str, FileIO] | None = None

    @property
    def waiting(self) -> int:
        """Bytes that wait."""
        with self._lock:
            return sum(self._sizes.values())

    def append(self, entries: Sequence[Entry]) -> None:
        """Put entries on the disk; returns when they lie there.

        Raises:
            SpoolFullError: too much waits.
            OSError: the disk is full or fails; nothing of these entries is kept.
        """
        framed = b"".join(_framed(pack(entry)) for entry in entries)
        with self._lock:
            waits = sum(self._sizes.values())
            if waits + len(framed) > self._most:
                raise SpoolFullError(f"{waits / 1e6:.0f} MB wait, no more than {self._most / 1e6:.0f} MB may")
            name, file = self._open or self._begin()
            before = self._sizes[name]
            try:
                rest = memoryview(framed)
                while rest:
                    rest = rest[file.write(rest) :]
                os.fsync(file.fileno())
            except OSError:
                with contextlib.suppress(OSError):  # what stands half written is cut off, now or when it is read
                    file.truncate(before)
                self._close()
                raise
            self._sizes[name] = before + len(framed)
            if self._sizes[name] > LONGEST_FILE:
                self._close()

    def files(self) -> list[str]:
        """Return the names of all files that wait, oldest first; what is appended from now on goes into another."""
        with self._lock:
            self._close()
            return list(self._sizes)

    def read(self, name: str) -> tuple[list[Entry], str]:
        """Return the entries of a file, and in words what of it could not be read; empty: all could.

        Raises:
            OSError: the file cannot be read.
        """
        content = (self._folder / name).read_bytes()
        entries: list[Entry] = []
        place = 0
        while place < len(content):
            if place + _FRAME.size > len(content):
                return entries, "cut off"
            length, checksum = _FRAME.unpack_from(content, place)
            payload = content[place + _FRAME.size : place + _FRAME.size + length]
            if len(payload) < length or zlib.crc32(payload) != checksum:
                return entries, "cut off or damaged"
            try:
                entries.append(unpack(payload))
            except msgspec.MsgspecError as error:
                return entries, f"written by another version: {error}"
            place += _FRAME.size + length
        return entries, ""

    def remove(self, name: str) -> None:
        """Remove a file that is in the database."""
        (self._folder / name).unlink(missing_ok=True)
        with self._lock:
            self._sizes.pop(name, None)

    def close(self) -> None:
        """Close what is open; all of it stays."""
        with self._lock:
            self._close()

    def _begin(self) -> tuple[str, FileIO]:
        self._number += 1
        # By chance too: numbers begin anew in an empty folder, and the database remembers names.
        name = f"{self._number:012d}-{os.urandom(6).hex()}.spool"
        file = FileIO(self._folder / name, "xb")
        self._sizes[name] = 0
        self._open = name, file
        return name, file

    def _close(self) -> None:
        if self._open is not None:
            name, file = self._open
            self._open = None
            file.close()
            if self._sizes.get(name) == 0:
                (self._folder / name).unlink(missing_ok=True)
                self._sizes.pop(name)


def _framed(payload: bytes) -> bytes:
    return _FRAME.pack(len(payload), zlib.crc32(payload)) + payload
