"""One process at a time does what is named; the others wait and find it done."""

import fcntl
import os
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PATIENCE = 300.0
"""Seconds after which a process no longer waits for one that may have been stopped."""


class ProcessLock:
    """Locks by name that a process loses when it ends, however it ends.

    Each name is a byte of one file that is locked, and never written.  Where the file cannot be
    opened, or the file system knows no such locks, nobody waits.

    Parameters
    ----------
    file : pathlib.Path
        File that all processes share; made if it is missing.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._descriptor: int | None = None
        self._held: set[int] = set()

    @contextmanager
    def held(self, name: str) -> Iterator[None]:
        """Keep other processes from what has this name; threads need a lock of their own."""
        place = zlib.crc32(name.encode())
        if place in self._held or not self._acquire(place):
            yield
            return
        self._held.add(place)
        try:
            yield
        finally:
            self._held.discard(place)
            with suppress(OSError):
                fcntl.lockf(self._open(), fcntl.LOCK_UN, 1, place)

    def _open(self) -> int:
        if self._descriptor is None:
            self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        return self._descriptor

    def _acquire(self, place: int) -> bool:
        """Whether the lock is held now."""
        try:
            descriptor = self._open()
        except OSError:
            return False
        give_up, pause = time.monotonic() + _PATIENCE, 0.001
        while time.monotonic() < give_up:
            try:
                fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            except (BlockingIOError, PermissionError):  # another process has it
                time.sleep(pause)
                pause = min(2 * pause, 0.1)
            except OSError:
                return False
            else:
                return True
        return False
