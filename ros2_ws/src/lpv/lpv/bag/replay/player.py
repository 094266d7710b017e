"""Plays a bag into a live graph, with its clock."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from rclpy.time import Time
from rosbags.interfaces import Connection, QosDurability, QosReliability
from rosgraph_msgs.msg import Clock

from lpv.bag.blocks.message_blocks import ahead
from lpv.bag.errors import BagError
from lpv.bag.replay.writer import OUTPUTS
from lpv.bag.rosbag.live import DEEPEST, message_class, node_alone, ros_qos
from lpv.bag.rosbag.metadata import offered_qos
from lpv.bag.rosbag.reading import BagReader, open_bag
from lpv.bag.run.record import DIAGNOSTICS
from lpv.core.support.limits import AT_ONCE, PATIENCE, QUIET
from lpv.core.support.timestamps import NANOSECONDS

_CLOCK = '/clock'


@dataclass
class Player:
    """Publishes the messages of a bag, byte for byte, at their recorded times."""

    bag: str | Path
    # topics to play; otherwise all but the answers of the diagnosis, which a live one gives
    topics: Sequence[str] | None = None
    rate: float = 1.0  # speed; 2 is twice as fast as recorded
    loop: bool = False  # start again at the end, until interrupted
    clock_rate: float = 100.0  # messages on /clock per second of the bag [Hz]; 0 for none
    wait: float = PATIENCE  # longest time to wait for a subscriber before the first message [s]
    # start and end, counted from the first message [s]
    interval: tuple[float | None, float | None] = (None, None)

    def __post_init__(self) -> None:
        self._tick = round(NANOSECONDS / self.clock_rate) if self.clock_rate else 0
        self._ok: Callable[[], bool] = lambda: False  # whether to go on

    def run(self, say: Callable[..., Any] = lambda text: None, rounds: int | None = None) -> int:
        """Play to the end, ``rounds`` of a loop, or until shutdown; the number of messages."""
        with open_bag(self.bag) as reader:
            chosen = self._choose(reader)
            with node_alone('lpv_player') as (node, _):
                publishers = _publishers(node, chosen, say)
                if not publishers:
                    raise BagError(f'{self.bag}: no type of its topics is installed here')
                clock = node.create_publisher(Clock, _CLOCK, 10) if self._tick else None
                chosen = [c for c in chosen if c.topic in publishers]
                self._await([*publishers.values(), *([clock] if clock else [])], say)
                self._ok, published = node.context.ok, 0
                sinks = [publishers[connection.topic] for connection in chosen]
                for turn in count(1):
                    published += self._play(reader, chosen, sinks, clock)
                    if not self.loop or turn == rounds or not self._ok():
                        break
                for publisher in publishers.values():
                    if publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE:
                        publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
                return published

    def _choose(self, reader: BagReader) -> list[Connection]:
        if self.topics is not None:
            there = {c.topic for c in reader.connections}
            for topic in (t for t in self.topics if t not in there):
                listed = ', '.join(sorted(there))
                raise BagError(f'{self.bag}: the bag has no topic {topic!r}; it has {listed}')
            return [c for c in reader.connections if c.topic in self.topics]
        others = (c for c in reader.connections if c.topic not in (DIAGNOSTICS, _CLOCK))
        chosen = [c for c in others if OUTPUTS.get(c.topic.rpartition('/')[2]) != c.msgtype]
        if not chosen:
            raise BagError(f'{self.bag}: holds answers of the diagnosis alone; name topics to play')
        return chosen

    def _await(self, publishers: list[Publisher], say: Callable[[str], None]) -> None:
        """Wait for a subscriber, and until no more come."""
        counts, since = [0] * len(publishers), time.monotonic()
        deadline = since + self.wait
        while (now := time.monotonic()) < deadline:
            before, counts = counts, [p.get_subscription_count() for p in publishers]
            if counts != before:
                since = now
            if any(counts) and now - since >= QUIET:
                return
            time.sleep(0.02)
        if self.wait and not any(counts):
            say('there are no subscribers; playing nevertheless')

    def _play(
        self,
        reader: BagReader,
        chosen: Sequence[Connection],
        sinks: list[Publisher],
        clock: Publisher | None,
    ) -> int:
        """Play once; the number of messages."""
        origin, tick, published = -1, 0, 0
        wall = time.monotonic()
        for block in ahead(reader.blocks(chosen, *map(reader.log_time, self.interval))):
            for i, stamp in enumerate(block.time.tolist()):
                if origin < 0:
                    wall, origin, tick = time.monotonic(), stamp, stamp
                while clock and tick <= stamp and self._sleep(wall, tick - origin):
                    clock.publish(Clock(clock=Time(nanoseconds=tick).to_msg()))
                    tick += self._tick
                if not self._sleep(wall, stamp - origin):
                    return published
                sinks[block.connection[i]].publish(block.message(i))
                published += 1
        return published

    def _sleep(self, wall: float, elapsed: int) -> bool:
        """Sleep until a time of the bag has come; False if the player is to end."""
        while self._ok():
            rest = wall + elapsed / NANOSECONDS / self.rate - time.monotonic()
            if rest <= 0.0:
                return True
            time.sleep(min(rest, AT_ONCE))
        return False


def _publishers(
    node: Node, connections: Sequence[Connection], say: Callable[[str], None]
) -> dict[str, Publisher]:
    """Publishers by topic, with the QoS with which a topic was offered when it was recorded."""
    found: dict[str, Publisher] = {}
    for connection in connections:
        topic = connection.topic
        try:
            kind = message_class(connection.msgtype)
        except (ImportError, AttributeError, ValueError):
            say(f'{topic} is left out: {connection.msgtype} is not installed')
            continue
        if topic not in found:
            offered = [q for c in connections if c.topic == topic for q in offered_qos(c)]
            reliable = all(q.reliability != QosReliability.BEST_EFFORT for q in offered)
            latched = all(q.durability == QosDurability.TRANSIENT_LOCAL for q in offered)
            depth = min(max([10, *(q.depth for q in offered)]), DEEPEST)
            qos = ros_qos(reliable, latched and bool(offered), depth)
            found[topic] = node.create_publisher(kind, topic, qos)
    return found
