"""Messages of a lockstep run in an order that does not depend on the order of arrival."""

import heapq
from collections.abc import Callable
from typing import Any

WINDOW = 500_000_000
"""How far stamps may run ahead of a message that is still to come [ns].

What is held back is lost if the recorder is killed.  In a loop that waits for each answer a message
comes some ten milliseconds of stamps late at the most."""


class StampSorter:
    """Releases messages sorted by stamp, then topic.

    In lockstep all messages of one stamp are published before those of the next, but a recorder
    hears several publishers in an order that differs from run to run.
    """

    def __init__(self, write: Callable[..., Any]) -> None:
        self._write = write
        self._heap: list[tuple[int, str, int, bytes]] = []
        self._count = 0
        self._newest = 0

    def add(self, topic: str, stamp: int, data: bytes) -> None:
        """Take one message."""
        # The counter keeps messages of one topic and stamp in the order of their arrival.
        heapq.heappush(self._heap, (stamp, topic, self._count, data))
        self._count += 1
        self._newest = max(self._newest, stamp)
        while self._heap[0][0] < self._newest - WINDOW:
            self._release()

    def flush(self) -> None:
        """Release everything that is left."""
        while self._heap:
            self._release()

    def _release(self) -> None:
        stamp, topic, _, data = heapq.heappop(self._heap)
        self._write(topic, stamp, data)
