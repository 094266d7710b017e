"""Input of a recorder: raw messages of topics that appear and disappear."""

from __future__ import annotations

import contextlib
import fnmatch
import os
import socket
import stat
from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import Any, NamedTuple

import rclpy
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosbags.interfaces import Qos

from lpv.bag.rosbag.live import DEEPEST, message_class, ros_qos
from lpv.bag.rosbag.metadata import qos_profile
from lpv.core.support.timestamps import leading_stamp

_MOST = 2000
"""Messages taken from one topic before the others have their turn."""
_RECHECK = 20
"""Searches after which publishers of known topics are looked at again: one second."""
_SOCKET_SIZE = 1 << 23
"""Size that is asked for of buffers of sockets: 20 s at 1 kHz of measurements [bytes]."""
# Stamped with the system's time even where everything else follows /clock.
_SYSTEM_TIME = ('/rosout', '/parameter_events')


class Heard(NamedTuple):
    """A message as received."""

    received: int  # system time at which it arrived in this process [ns]
    topic: str  # its topic
    data: bytes  # CDR
    sent: int  # system time at which it was published [ns]; 0 where unknown
    publisher: bytes | None  # who sent it; None where unknown
    sequence: int | None  # the publisher's number of it; None where unknown
    stamp: int | None  # stamp at its beginning [ns]; None for types without


class Selection(NamedTuple):
    """Which topics are wanted."""

    names: frozenset[str]  # full names; empty for all
    # patterns of shells, against full names; they hold for all topics, not for named ones
    excluded: tuple[str, ...] = ()

    def chosen(self, topics: Iterable[str]) -> list[str]:
        """Those of some topics that are wanted, sorted."""
        if self.names:
            return sorted(self.names.intersection(topics))
        shown = [t for t in topics if '/_' not in t]
        return sorted(t for t in shown if not any(fnmatch.fnmatchcase(t, p) for p in self.excluded))


class _Subscription(NamedTuple):
    handle: Any
    stamped: bool
    msgtype: str
    offer: tuple[bool, bool]  # as of `_offer`


class RecorderInput:
    """Subscriptions that are polled, not served by an executor.

    An executor hands over one message at a time; a poll takes thousands.  Hence a node of its own,
    that no executor has.
    """

    def __init__(
        self, node: rclpy.node.Node, selection: Selection, check_type: Callable[..., Any]
    ) -> None:
        self._node, self._selection, self._check_type = node, selection, check_type
        self._own = rclpy.create_node(
            f'{node.get_name()}_input',
            namespace=node.get_namespace(),
            context=node.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        enlarge_sockets()
        self._subscriptions: dict[str, _Subscription] = {}
        self._complained: set[tuple[str, str]] = set()  # topic and publisher; '' for all of them
        self._searches = 0

    def close(self) -> None:
        """Stop listening."""
        self._subscriptions = {}
        self._own.destroy_node()

    @property
    def complaints(self) -> int:
        """Number of topics and publishers that are not recorded though they are wanted."""
        return len(self._complained)

    def search(self) -> list[tuple[str, str, Qos]]:
        """Subscribe to wanted topics that have a publisher now."""
        found = []
        self._searches += 1
        own = self._node.get_name(), self._node.get_namespace()
        for topic in self._selection.chosen(dict(self._node.get_topic_names_and_types())):
            known = topic in self._subscriptions
            if (topic, '') in self._complained or (known and self._searches % _RECHECK):
                continue
            publishers = [
                p
                for p in self._node.get_publishers_info_by_topic(topic)
                if (p.node_name, p.node_namespace) != own
            ]
            if known:
                self._check_match(topic, publishers)
            elif publishers and (offered := self._subscribe(topic, publishers)) is not None:
                found.append((topic, publishers[0].topic_type, offered))
        return found

    def _subscribe(self, topic: str, publishers: list[TopicEndpointInfo]) -> Qos | None:
        """Subscribe with the QoS that all publishers offer; None if the type is not installed."""
        msgtype, depth = publishers[0].topic_type, publishers[0].qos_profile.depth
        reliable, latched = (all(_offer(p)[i] for p in publishers) for i in (0, 1))
        try:
            self._check_type(msgtype)
            kind = message_class(msgtype)
        except (ValueError, AttributeError, ImportError) as error:
            self._node.get_logger().error(f'{topic} is not recorded: {error}')
            self._complained.add((topic, ''))
            return None
        qos = ros_qos(reliable, latched, DEEPEST)
        handle = self._own.create_subscription(kind, topic, lambda _: None, qos, raw=True)
        first = next(iter(kind.get_fields_and_field_types().values()), '')
        timed = first in ('std_msgs/Header', 'builtin_interfaces/Time')
        self._subscriptions[topic] = _Subscription(
            handle, timed and topic not in _SYSTEM_TIME, msgtype, (reliable, latched)
        )
        return qos_profile(reliable, latched, depth)

    def _check_match(self, topic: str, publishers: list[TopicEndpointInfo]) -> None:
        """A publisher that came later may offer less than was asked for, or another type."""
        ours = self._subscriptions[topic]
        for publisher in publishers:
            if publisher.topic_type != ours.msgtype:
                why = f'has type {publisher.topic_type}, not {ours.msgtype}'
            elif any(asked > offered for asked, offered in zip(ours.offer, _offer(publisher))):
                why = 'offers a lower quality of service than those before it'
            else:
                continue
            who = f'{publisher.node_namespace}/{publisher.node_name}'.replace('//', '/')
            if (topic, who) not in self._complained:
                self._complained.add((topic, who))
                self._node.get_logger().warning(
                    f'{topic}: what {who} publishes is not recorded, it {why}'
                )

    def poll(self) -> list[Heard]:
        """Messages received since the last call, in the order of arrival."""
        found = []  # with the time by which to sort: a topic keeps its order if the clock is set
        for topic, ours in self._subscriptions.items():
            with ours.handle.handle:
                take, msgtype = ours.handle.handle.take_message, ours.handle.msg_type
                newest = 0
                for _ in range(_MOST):
                    taken = take(msgtype, True)
                    if taken is None:
                        break
                    data, info = taken
                    gid = info.get('publisher_gid')  # not known in distributions before Kilted
                    gid = gid.get('data') if isinstance(gid, dict) else gid
                    received, sent = info['received_timestamp'], info['source_timestamp']
                    number = info.get('publication_sequence_number')
                    stamp = leading_stamp(data) if ours.stamped else None
                    newest = max(newest, received)
                    found.append((newest, Heard(received, topic, data, sent, gid, number, stamp)))
        found.sort(key=itemgetter(0))
        return [heard for _, heard in found]


def enlarge_sockets() -> None:
    """Let UDP sockets of this process hold more, as far as the operating system allows.

    What comes while the process waits for a processor is lost beyond that.  Fast DDS takes a size
    from a profile only where discovery is not local.
    """
    for number in map(int, os.listdir('/proc/self/fd')):
        with contextlib.suppress(OSError):  # of one that is closed meanwhile
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as one:
                    _enlarge(one)


def _enlarge(one: socket.socket) -> None:
    size = one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if one.type == socket.SOCK_DGRAM and size < _SOCKET_SIZE:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_SIZE)


def _offer(publisher: TopicEndpointInfo) -> tuple[bool, bool]:
    """Whether a publisher is reliable, and keeps its last messages for those who come later."""
    qos = publisher.qos_profile
    return (
        qos.reliability == ReliabilityPolicy.RELIABLE,
        qos.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )
