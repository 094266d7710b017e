"""Messages of a lockstep run in an order that does not depend on the order of arrival."""

import heapq
from collections.abc import Callable, Hashable
from typing import Any

from lpv.core.support import limits
from lpv.core.support.timestamps import NANOSECONDS

WINDOW = 500_000_000
"""How far stamps may run ahead of a message that is still to come [ns].

What is held back is lost if the recorder is killed."""
PATIENCE = 2 * round(limits.PATIENCE * NANOSECONDS)
"""A publisher that lags behind the newest stamp by more, or has not begun, is not waited for
[ns]."""
_SHARED = '/diagnostics'
"""The topic with several senders, whose messages of one stamp arrive in any order."""


class StampSorter:
    """Releases messages sorted by stamp, then topic.

    In lockstep all messages of one stamp are published before those of the next, but a recorder
    hears several publishers in an order that differs from run to run.  A message is released when
    every publisher that still sends has gone on by `WINDOW`: one that is heard late, on a busy
    machine, is waited for.
    """

    def __init__(self, write: Callable[..., Any]) -> None:
        self._write = write
        self._heap: list[tuple[int, str, bytes, int, bytes]] = []
        self._count = 0
        self._first: int | None = None
        self._last: dict[tuple[str, Hashable], int] = {}

    def add(self, topic: str, stamp: int, data: bytes, publisher: Hashable = None) -> None:
        """Take one message of a publisher."""
        # The counter keeps messages of one sender and stamp in the order of their arrival.
        content = data if topic == _SHARED else b''
        heapq.heappush(self._heap, (stamp, topic, content, self._count, data))
        self._count += 1
        sender = topic, publisher
        self._last[sender] = max(stamp, self._last.get(sender, stamp))
        newest = max(self._last.values())
        # The lowest: one that is stamped by another clock must not make the others wait.
        self._first = stamp if self._first is None else min(stamp, self._first)
        if newest - self._first < PATIENCE:
            return
        limit = min(last for last in self._last.values() if newest - last <= PATIENCE) - WINDOW
        while self._heap and self._heap[0][0] < limit:
            self._release()

    def flush(self) -> None:
        """Release everything that is left."""
        while self._heap:
            self._release()

    def _release(self) -> None:
        stamp, topic, _, _, data = heapq.heappop(self._heap)
        self._write(topic, stamp, data)
