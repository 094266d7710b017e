"""Recorder node: topics into a rosbag2 directory, exact bytes as they came."""

import importlib
import struct
import sys

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from lpv_bag.ordering import StampOrder
from lpv_bag.writing import BagWriter, qos_profile
from lpv_core.errors import LpvError
from lpv_node.managed import ManagedNode, run_node
from lpv_node.parameters import Spec, required_text

SPECS = (
    Spec('output', '', 'bag directory to create', read_only=True),
    Spec('topics', ['joint_states', 'torque_command', 'state_estimate', 'fault_estimate',
                    'fault_alarm', 'reference', 'ground_truth', '/diagnostics'],
         'topics to record; relative names are resolved in the node\'s namespace',
         read_only=True),
)
_DEPTH = 20000


class RecorderNode(ManagedNode):
    """Records topics as soon as they have a publisher, with its QoS.

    Messages are not deserialised.  The log time is the time of reception; in lockstep it is the
    message's own stamp, and messages are sorted, so that runs with the same seed give the same
    bag byte by byte.
    """

    drain_time = 0.5

    def __init__(self):
        super().__init__('recorder', SPECS)
        self._writer = self._search = None
        self._recorded, self._announced = {}, {}
        self._order = StampOrder(self._write)
        self._taken = 0

    def setup(self):
        """Open the bag."""
        self._writer = BagWriter(required_text(self, 'output'))
        self._wanted = {self.resolve_topic_name(name)
                        for name in self.get_parameter('topics').value}

    def progress(self):
        """Messages taken so far."""
        return self._taken

    def begin(self):
        """Look for publishers of the wanted topics."""
        self._search = self.steady_timer(0.05, self._subscribe_new)
        self.get_logger().info(f'recording {len(self._wanted)} topics into {self._writer.path}')

    def end(self):
        """Unsubscribe, and close the bag."""
        if self._search is not None:
            self.destroy_timer(self._search)
            self._search = None
        for subscription in self._recorded.values():
            self.destroy_subscription(subscription)
        self._recorded = {}
        if self._writer is not None:
            self._order.flush()
            self._announce_all()
            total = sum(self._writer.counts.values())
            self._writer.close()
            self._writer = None
            self.get_logger().info(f'bag closed with {total} messages')

    def _subscribe_new(self):
        for topic in sorted(self._wanted - set(self._recorded)):
            publishers = self.get_publishers_info_by_topic(topic)
            if publishers:
                self._subscribe(topic, publishers)

    def _subscribe(self, topic, publishers):
        msgtype, depth = publishers[0].topic_type, publishers[0].qos_profile.depth
        reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                       for p in publishers)
        latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                      for p in publishers)
        try:
            self._writer.check_type(msgtype)
            message_class = _message_class(msgtype)
        except (LpvError, AttributeError, ImportError, ValueError) as error:
            self.get_logger().error(f'{topic} is not recorded: {error}')
            self._wanted.discard(topic)
            return
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched
                        else DurabilityPolicy.VOLATILE))
        self._announced[topic] = (msgtype, qos_profile(reliable, latched, depth))
        stamped = self.lockstep and _starts_with_time(message_class)

        def store(data):
            self._taken += 1
            if stamped:
                self._order.add(topic, _leading_stamp(data), data)
            else:
                self._write(topic, self.get_clock().now().nanoseconds, data)

        self._recorded[topic] = self.create_subscription(message_class, topic, store, qos, raw=True)

    def _announce_all(self):
        """Topics in the order of their names, however they were found."""
        for topic in sorted(self._announced):
            msgtype, offered = self._announced.pop(topic)
            self._writer.add_topic(topic, msgtype, [offered])

    def _write(self, topic, stamp, data):
        if self._announced:
            self._announce_all()
        try:
            self._writer.write_raw(topic, stamp, data)
        except OSError as error:
            self.get_logger().fatal(f'recording stopped: {error}')
            self._wanted = set()
            self.finish(1)


def _message_class(msgtype):
    package, kind, name = msgtype.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), name)


def _starts_with_time(message_class):
    first = next(iter(message_class.get_fields_and_field_types().values()), '')
    return first in ('std_msgs/Header', 'builtin_interfaces/Time')


def _leading_stamp(data):
    """Stamp of a CDR message whose first field is a Header or a Time [ns]."""
    order = '<' if data[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(order + 'iI', data, 4)
    return seconds * 1_000_000_000 + nanoseconds


def main(argv=None):
    """Entry point of ``ros2 run lpv_bag recorder``."""
    sys.exit(run_node(RecorderNode, argv))


if __name__ == '__main__':
    main()
