"""Input of a recorder: raw messages of topics that appear and disappear."""

from __future__ import annotations

import contextlib
import fnmatch
import operator
import os
import socket
import stat
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import rclpy
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import MessageInfo
from rosbags.interfaces import Qos

from lpv.bag.rosbag.live import DEEPEST, message_class, ros_qos
from lpv.bag.rosbag.mcap_file import error_text
from lpv.bag.rosbag.metadata import qos_profile
from lpv.core.support.timestamps import leading_stamp

if TYPE_CHECKING:  # later distributions have it elsewhere
    from rclpy.topic_endpoint_info import TopicEndpointInfo

MOST = 2000
"""Messages taken from one topic before the others have their turn."""
_RECHECK = 20
"""Searches after which publishers of known topics are looked at again, one second, also where their
number is the same."""
_TELLS_PUBLISHERS = 'publisher_gid' in MessageInfo.__annotations__
"""Whether messages say who sent them; distributions before Kilted do not."""
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


_Offer = tuple[bool, bool]
"""Of a publisher: reliable, and keeps its last messages for those who come later."""


@dataclass
class _Topic:
    """A topic that is recorded, by subscriptions with what they ask for.

    One that asks for more than a publisher offers does not hear it; one that asks for less hears
    also those that offer more.  Hence a publisher is taken from one subscription only.
    """

    msgtype: str
    kind: Any  # class of the messages
    stamped: bool
    subscriptions: dict[_Offer, Any] = field(default_factory=dict)
    owners: dict[bytes, _Offer] = field(default_factory=dict)  # by publisher

    def unheard(self, publisher: TopicEndpointInfo) -> _Offer | None:
        """What a publisher offers if no subscription hears it; the best one that does owns it."""
        offer = _offer(publisher)
        heard = [asked for asked in self.subscriptions if all(map(operator.le, asked, offer))]
        # Who was heard from before stays where it is: nothing is taken twice, nothing missed.
        self.owners.setdefault(bytes(publisher.endpoint_gid), max(heard, default=offer))
        return None if heard else offer


class RecorderInput:
    """Subscriptions that are polled, not served by an executor.

    An executor hands over one message at a time; a poll takes thousands.  Hence a node of its own,
    that no executor has, and without remappings: what it looks for are topics of the graph.
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
        self._topics: dict[str, _Topic] = {}
        self._publishers: dict[str, int] = {}  # by topic: number of them at the last look
        # Why a topic is not recorded, by its name and a publisher or type; '' for all of it.
        self._refused: dict[tuple[str, str], str] = {}
        self._searches = 0

    def close(self) -> None:
        self._topics = {}
        self._own.destroy_node()

    @property
    def refused(self) -> dict[str, str]:
        """Why wanted topics are not recorded, or not from all publishers, by name."""
        return {name: why for (name, _), why in sorted(self._refused.items())}

    def search(self) -> list[tuple[str, str, Qos]]:
        """Subscribe to wanted topics that have a publisher now."""
        found = []
        self._searches += 1
        for name in self._selection.chosen(dict(self._own.get_topic_names_and_types())):
            try:
                if self._is_due(name):
                    found += self._look(name)
            except Exception as error:  # of many kinds; the other topics are recorded nevertheless
                self._refuse(name, '', f'is not recorded, or only in part: {error_text(error)}')
        return found

    def _is_due(self, name: str) -> bool:
        """Whether the publishers of a topic are to be looked at: they changed, or may have."""
        before = self._publishers.get(name)
        self._publishers[name] = self._own.count_publishers(name)
        return self._publishers[name] != before or not self._searches % _RECHECK

    def _look(self, name: str) -> list[tuple[str, str, Qos]]:
        """Subscribe to the publishers of a topic that nothing is heard of; the topic if new."""
        own = self._node.get_name(), self._node.get_namespace()
        there = self._own.get_publishers_info_by_topic(name)
        publishers = [p for p in there if (p.node_name, p.node_namespace) != own]
        if name in self._topics:
            self._hear_all(name, self._topics[name], publishers)
            return []
        for msgtype in dict.fromkeys(p.topic_type for p in publishers):
            if (name, msgtype) in self._refused:
                continue
            try:
                return [(name, msgtype, self._subscribe(name, msgtype, publishers))]
            except Exception as error:  # of many kinds, of texts, modules and middlewares
                self._refuse(name, msgtype, f'is not recorded: {error_text(error)}')
        return []

    def _subscribe(self, name: str, msgtype: str, publishers: list[TopicEndpointInfo]) -> Qos:
        """Subscribe to all publishers of a type; any exception if it cannot be recorded.

        Returns the QoS that all of them offer.
        """
        self._check_type(msgtype)
        kind = message_class(msgtype)
        first = next(iter(kind.get_fields_and_field_types().values()), '')
        timed = first in ('std_msgs/Header', 'builtin_interfaces/Time')
        topic = _Topic(msgtype, kind, timed and name not in _SYSTEM_TIME)
        same = [p for p in publishers if p.topic_type == msgtype]
        offers = {_offer(p) for p in same}
        reliable, latched = (all(offer[i] for offer in offers) for i in (0, 1))
        # The highest first: `poll` then finds there who is heard by several.
        for asked in sorted(offers, reverse=True) if _TELLS_PUBLISHERS else [(reliable, latched)]:
            self._add(name, topic, asked)
        self._hear_all(name, topic, publishers)
        self._topics[name] = topic
        return qos_profile(reliable, latched, same[0].qos_profile.depth)

    def _add(self, name: str, topic: _Topic, asked: _Offer) -> None:
        qos = ros_qos(*asked, DEEPEST)
        subscribe = self._own.create_subscription
        topic.subscriptions[asked] = subscribe(topic.kind, name, lambda _: None, qos, raw=True)

    def _hear_all(self, name: str, topic: _Topic, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe to publishers that nothing is heard of, as they offer less than those before.

        One with another type is not recorded.
        """
        unheard = set()
        for publisher in publishers:
            if publisher.topic_type != topic.msgtype:
                why = f'has type {publisher.topic_type}, not {topic.msgtype}'
                self._complain(name, publisher, why)
            elif (offer := topic.unheard(publisher)) is None:
                continue
            elif _TELLS_PUBLISHERS:
                unheard.add(offer)
            else:
                why = 'offers a lower quality of service than those before it'
                self._complain(name, publisher, why)
        # All publishers have their owners by now: a new subscription hears of others, too.
        for offer in sorted(unheard, reverse=True):
            self._add(name, topic, offer)

    def _complain(self, name: str, publisher: TopicEndpointInfo, why: str) -> None:
        who = f'{publisher.node_namespace}/{publisher.node_name}'.replace('//', '/')
        self._refuse(name, who, f'what {who} publishes is not recorded, it {why}')

    def _refuse(self, name: str, what: str, why: str) -> None:
        """Note, and say once, why a publisher or a type of a topic is not recorded."""
        if (name, what) not in self._refused:
            self._refused[name, what] = why
            self._node.get_logger().warning(f'{name}: {why}')

    def poll(self) -> list[Heard]:
        """Messages received since the last call, in the order of arrival."""
        found: list[tuple[int, Heard]] = []  # with the time by which to sort
        for name, topic in self._topics.items():
            for asked, subscription in topic.subscriptions.items():
                self._take(name, topic, asked, subscription, found)
        found.sort(key=operator.itemgetter(0))
        return [heard for _, heard in found]

    @staticmethod
    def _take(
        name: str, topic: _Topic, asked: _Offer, subscription: Any, found: list[tuple[int, Heard]]
    ) -> None:
        """Messages of one subscription; they keep their order if the clock is set."""
        with subscription.handle:
            take, msgtype = subscription.handle.take_message, subscription.msg_type
            newest = 0
            for _ in range(MOST):
                taken = take(msgtype, True)
                if taken is None:
                    break
                data, info = taken
                gid: Any = info.get('publisher_gid')
                gid = gid.get('data') if isinstance(gid, dict) else gid
                alone = gid is None or len(topic.subscriptions) == 1
                if not (alone or topic.owners.setdefault(gid, asked) == asked):
                    continue  # a publisher is taken from one subscription
                received, sent = info['received_timestamp'], info['source_timestamp']
                number = info.get('publication_sequence_number')
                stamp = leading_stamp(data) if topic.stamped else None
                newest = max(newest, received)
                found.append((newest, Heard(received, name, data, sent, gid, number, stamp)))


def enlarge_sockets() -> None:
    """Let UDP sockets of this process hold more, as far as the operating system allows.

    What comes while the process waits for a processor is lost beyond that.  Fast DDS takes a size
    from a profile only where discovery is not local.
    """
    for number in map(int, os.listdir('/proc/self/fd')):
        with contextlib.suppress(OSError):  # of one that is closed meanwhile
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as one:
                    size = one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
                    if one.type == socket.SOCK_DGRAM and size < _SOCKET_SIZE:
                        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_SIZE)


def _offer(publisher: TopicEndpointInfo) -> _Offer:
    """Whether a publisher is reliable, and keeps its last messages for those who come later."""
    qos = publisher.qos_profile
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return qos.reliability == ReliabilityPolicy.RELIABLE, latched
