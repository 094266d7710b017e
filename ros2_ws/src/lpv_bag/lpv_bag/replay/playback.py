"""Messages of a bag in their rhythm: what all players of this software have in common."""

import math
import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import QosDurability, QosReliability
from rosgraph_msgs.msg import Clock

from lpv_bag.rosbag.message_blocks import read_blocks
from lpv_bag.rosbag.prefetch import ahead
from lpv_core.observer.sampled_observer import NANOSECONDS

_DEEPEST = 20000
_LONGEST_NAP = 0.1
"""A player that is told to end is awake at least so often [s]."""


class Playback:
    """Publishes messages of an open bag, byte for byte."""

    def __init__(
        self,
        reader,
        connections,
        publishers,
        rate: float = 1.0,
        clock=None,
        tick: int | None = None,
        going_on: Callable[..., Any] = lambda: True,
    ) -> None:
        self._reader, self._connections, self._publishers = reader, connections, publishers
        self._rate, self._clock, self._tick = rate, clock, tick
        self._going_on = going_on

    def run(
        self, start: int | None = None, stop: int | None = None, origin: int | None = None
    ) -> int:
        """Play once."""
        wall, published, tick = time.monotonic(), 0, None
        for connection, stamp, data in self._messages(start, stop):
            if tick is None:
                wall, origin = time.monotonic(), stamp if origin is None else origin
                tick = origin if self._clock is not None else math.inf
            while tick <= stamp and self._sleep(wall, tick - origin):
                self._clock.publish(
                    Clock(clock=Time(sec=tick // NANOSECONDS, nanosec=tick % NANOSECONDS))
                )
                tick += self._tick
            if not self._sleep(wall, stamp - origin):
                break
            self._publishers[connection.topic].publish(data)
            published += 1
        return published

    def _messages(self, start, stop):
        """Messages one by one, unpacked ahead of their time."""
        for block in ahead(read_blocks(self._reader, self._connections, start, stop)):
            for i in range(len(block)):
                yield (self._connections[block.connection[i]], int(block.time[i]), block.message(i))

    def _sleep(self, wall, elapsed) -> bool:
        """Sleep until a time of the bag has come; False if the player is to end."""
        while self._going_on():
            rest = wall + elapsed / NANOSECONDS / self._rate - time.monotonic()
            if rest <= 0.0:
                return True
            time.sleep(min(rest, _LONGEST_NAP))
        return False


def await_acknowledgement(publishers, longest: float) -> None:
    """Let slow subscribers take the last messages."""
    for publisher in publishers:
        if publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE:
            publisher.wait_for_all_acked(Duration(seconds=longest))


def recorded_qos(connections):
    """The QoS with which a topic was offered when it was recorded."""
    offered = [q for c in connections for q in (c.ext.offered_qos_profiles or ())]
    reliable = not any(q.reliability == QosReliability.BEST_EFFORT for q in offered)
    latched = bool(offered) and all(q.durability == QosDurability.TRANSIENT_LOCAL for q in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=min(max([10, *(q.depth for q in offered)]), _DEEPEST),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )
