"""Messages of a bag at their recorded times: common to all players of this software."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Connection, QosDurability, QosReliability
from rosgraph_msgs.msg import Clock

from lpv_bag.blocks.message_blocks import ahead
from lpv_bag.rosbag.offered_qos import offered_qos
from lpv_bag.rosbag.reading import BagReader
from lpv_core.support.timestamps import NANOSECONDS

_DEEPEST = 20000
_LONGEST_NAP = 0.1
"""A player that is told to end is awake at least so often [s]."""


class Playback:
    """Publishes messages of an open bag, byte for byte."""

    def __init__(
        self,
        reader: BagReader,
        connections: Sequence[Connection],
        publishers: dict[str, Publisher],
        rate: float = 1.0,
        clock: Publisher | None = None,
        tick: int | None = None,
        keep_going: Callable[..., Any] = lambda: True,
    ) -> None:
        self._reader, self._connections, self._publishers = reader, connections, publishers
        self._rate, self._clock, self._tick = rate, clock, tick
        self._keep_going = keep_going

    def run(
        self, start: int | None = None, stop: int | None = None, origin: int | None = None
    ) -> int:
        """Play once."""
        wall, published = time.monotonic(), 0
        tick: float | None = None  # of the next message on /clock [ns]
        for connection, stamp, data in self._messages(start, stop):
            if tick is None:
                wall, origin = time.monotonic(), stamp if origin is None else origin
                tick = origin if self._clock is not None else math.inf
            assert origin is not None
            while tick <= stamp and self._sleep(wall, tick - origin):
                tick += self._publish_clock(int(tick))
            if not self._sleep(wall, stamp - origin):
                break
            self._publishers[connection.topic].publish(data)
            published += 1
        return published

    def _publish_clock(self, now: int) -> int:
        """Publish a time [ns] on /clock; the time until the next one [ns]."""
        assert self._clock is not None and self._tick is not None
        self._clock.publish(Clock(clock=Time(sec=now // NANOSECONDS, nanosec=now % NANOSECONDS)))
        return self._tick

    def _messages(
        self, start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages one by one, unpacked ahead of their time."""
        for block in ahead(self._reader.blocks(self._connections, start, stop)):
            for i in range(len(block)):
                yield (self._connections[block.connection[i]], int(block.time[i]), block.message(i))

    def _sleep(self, wall: float, elapsed: float) -> bool:
        """Sleep until a time of the bag has come; False if the player is to end."""
        while self._keep_going():
            rest = wall + elapsed / NANOSECONDS / self._rate - time.monotonic()
            if rest <= 0.0:
                return True
            time.sleep(min(rest, _LONGEST_NAP))
        return False


def await_acknowledgement(publishers: Iterable[Publisher], longest: float) -> None:
    """Wait until slow subscribers have received the last messages."""
    for publisher in publishers:
        if publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE:
            publisher.wait_for_all_acked(Duration(seconds=longest))


def recorded_qos(connections: Sequence[Connection]) -> QoSProfile:
    """The QoS with which a topic was offered when it was recorded."""
    offered = [q for c in connections for q in offered_qos(c)]
    reliable = not any(q.reliability == QosReliability.BEST_EFFORT for q in offered)
    latched = bool(offered) and all(q.durability == QosDurability.TRANSIENT_LOCAL for q in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(max([10, *(q.depth for q in offered)]), _DEEPEST),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )
