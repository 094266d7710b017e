"""Plays a bag into a live graph, with its clock."""

import importlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosbags.interfaces import Connection
from rosgraph_msgs.msg import Clock

from lpv_bag.replay.playback import Playback, await_acknowledgement, recorded_qos
from lpv_bag.replay.writer import DIAGNOSTICS, OUTPUTS
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.measurements import MEASUREMENT_TYPE
from lpv_bag.run.record import BagError, find_topic, open_bag
from lpv_core.support.errors import ConfigError
from lpv_core.support.timestamps import NANOSECONDS

_CLOCK = '/clock'
_SETTLING = 1.0
"""Subscribers find publishers one after the other: time to wait after the latest one [s]."""

_LAST_CALL = 5.0
"""How long slow subscribers may take for the last messages [s]."""


class Player:
    """Publishes the messages of a bag, byte for byte, at their recorded times.

    Parameters
    ----------
    bag : str or pathlib.Path
        The bag.
    topics : sequence of str, optional
        Topics to play; otherwise all but the answers of the diagnosis, which a live one gives.
    measured : str, optional
        Topic of the measurements, where there are several.
    rate : float, optional
        Speed; 2 is twice as fast as recorded.
    loop : bool, optional
        Start again at the end, until interrupted.
    clock_rate : float, optional
        Messages on /clock per second of the bag [Hz]; 0 for none.
    wait : float, optional
        Longest time to wait for a subscriber before the first message [s].
    interval : tuple of float or None, optional
        Start and end, counted from the first message [s].
    """

    def __init__(
        self,
        bag: str | Path,
        topics: Sequence[str] | None = None,
        measured: str | None = None,
        rate: float = 1.0,
        loop: bool = False,
        clock_rate: float = 100.0,
        wait: float = 5.0,
        interval: tuple[float | None, float | None] = (None, None),
    ) -> None:
        for name, value, low, high in (
            ('--rate', rate, 1e-3, 1e3),
            ('--wait', wait, 0.0, 1e6),
            ('--clock-rate', clock_rate, 0.0, 1e4),
        ):
            if not low <= value <= high:
                raise ConfigError(name, f'must be a number from {low:g} to {high:g}, got {value}')
        for end in interval:
            if end is not None and not 0.0 <= end < 1e9:
                raise ConfigError('--from, --to', f'must be seconds from 0, got {end}')
        self._bag, self._topics, self._measured = bag, topics, measured
        self._rate, self._loop, self._wait = rate, loop, wait
        self._tick = round(NANOSECONDS / clock_rate) if clock_rate else None
        self._interval = interval

    def run(self, say: Callable[..., Any] = lambda text: None, rounds: int | None = None) -> int:
        """Play until the end, ``rounds`` of a loop, or until the context is shut down.

        ``say`` receives lines for the user.  Returns the number of messages; BagError if the bag
        holds nothing that can be played.
        """
        with open_bag(self._bag) as reader:
            chosen = self._choose(reader)
            context = Context()
            rclpy.init(context=context)
            node = rclpy.create_node('lpv_player', context=context)
            try:
                publishers = _publishers(node, chosen, say)
                if not publishers:
                    raise BagError(f'{self._bag}: no type of its topics is installed here')
                clock = node.create_publisher(Clock, _CLOCK, 10) if self._tick else None
                chosen = [c for c in chosen if c.topic in publishers]
                self._await([*publishers.values(), *([clock] if clock else [])], say)
                playback = Playback(
                    reader, chosen, publishers, self._rate, clock, self._tick, context.ok
                )
                published = turn = 0
                while True:
                    published += playback.run(*map(reader.log_time, self._interval))
                    turn += 1
                    if not self._loop or turn == rounds or not context.ok():
                        break
                await_acknowledgement(publishers.values(), _LAST_CALL)
                return published
            finally:
                node.destroy_node()
                rclpy.try_shutdown(context=context)

    def _choose(self, reader: BagReader) -> list[Connection]:
        if self._topics is not None:
            there = {c.topic for c in reader.connections}
            missing = [t for t in self._topics if t not in there]
            if missing:
                raise BagError(
                    f'{self._bag}: the bag has no topic {missing[0]!r}; it has '
                    + ', '.join(sorted(there))
                )
            return [c for c in reader.connections if c.topic in self._topics]
        measured = find_topic(reader, MEASUREMENT_TYPE, 'joint_states', self._measured).topic
        prefix = measured.rsplit('/', 1)[0]
        answers = {f'{prefix}/{name}' for name, _ in OUTPUTS.values()} | {DIAGNOSTICS, _CLOCK}
        return [c for c in reader.connections if c.topic not in answers]

    def _await(self, publishers: list[Publisher], say: Callable[[str], None]) -> None:
        """Wait for a subscriber, and until no more come."""
        counts, since = [0] * len(publishers), time.monotonic()
        deadline = since + self._wait
        while (now := time.monotonic()) < deadline:
            before, counts = counts, [p.get_subscription_count() for p in publishers]
            if counts != before:
                since = now
            if any(counts) and now - since >= _SETTLING:
                return
            time.sleep(0.02)
        if self._wait and not any(counts):
            say('there are no subscribers; playing nevertheless')


def _publishers(
    node: Node, connections: Sequence[Connection], say: Callable[[str], None]
) -> dict[str, Publisher]:
    found: dict[str, Publisher] = {}
    for connection in connections:
        try:
            package, _, name = connection.msgtype.split('/')
            message = getattr(importlib.import_module(f'{package}.msg'), name)
        except (ImportError, AttributeError, ValueError):
            say(f'{connection.topic} is left out: {connection.msgtype} is not installed')
            continue
        if connection.topic not in found:
            same = [c for c in connections if c.topic == connection.topic]
            found[connection.topic] = node.create_publisher(
                message, connection.topic, recorded_qos(same)
            )
    return found
