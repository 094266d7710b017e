"""``ros2 bag play``."""

import time

from lpv_ros2cli import discovery
from lpv_ros2cli.bag.reading import opened, topics_of
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.interfaces import load

_LONGEST_NAP = 0.1
"""SIGINT is seen at least so often [s]."""


def add_arguments(parser):
    """Declare the verb's arguments."""
    parser.add_argument('bag_path', help='bag')
    parser.add_argument('-r', '--rate', type=float, default=1.0, metavar='N',
                        help='speed, as a multiple of the recorded one (1)')
    parser.add_argument('--topics', nargs='+', metavar='topic', help='only these')
    parser.add_argument('-m', '--remap', nargs='+', default=[], metavar='old:=new',
                        help='publish topics under other names')
    parser.add_argument('-l', '--loop', action='store_true', help='start again at the end')
    parser.add_argument('-d', '--delay', type=float, default=0.0, metavar='SECONDS',
                        help='wait before the first message')
    parser.add_argument('--start-offset', type=float, default=0.0, metavar='SECONDS',
                        help='begin so long after the start of the bag')
    parser.add_argument('--clock', type=float, nargs='?', const=40.0, default=0.0, metavar='HZ',
                        help='publish /clock at this rate (40)')


def run(arguments):
    """Publish a bag's messages at the times at which they were recorded."""
    if not arguments.rate > 0.0 or not arguments.rate < float('inf'):
        raise CliError('--rate must be greater than zero')
    if arguments.clock < 0.0 or arguments.delay < 0.0 or arguments.start_offset < 0.0:
        raise CliError('--clock, --delay and --start-offset must not be negative')
    with opened(arguments.bag_path) as reader, discovery.command_node('rosbag2_player') as node:
        player = Player(node, reader, arguments)
        print(f'playing {len(player.publishers)} topics of {arguments.bag_path} at '
              f'{arguments.rate:g} x the recorded speed', flush=True)
        player.await_subscribers(1.0)
        time.sleep(arguments.delay)
        while player.play() and arguments.loop:
            time.sleep(_LONGEST_NAP)  # a bag of one message must not flood the graph
        player.finish()
        print(f'published {player.count} messages')


class Player:
    """Publishes the messages of a bag.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishes.
    reader : lpv_bag.run_record.BagReader
        Open bag.
    arguments : argparse.Namespace
        As declared by `add_arguments`.

    Attributes
    ----------
    publishers : dict of str to rclpy.publisher.Publisher
        By the topic's name in the bag.
    count : int
        Messages published.

    Raises
    ------
    CliError
        If no topic can be played.
    """

    def __init__(self, node, reader, arguments):
        self._node, self._reader = node, reader
        self._rate, self.count = arguments.rate, 0
        self._begin = reader.start_time + round(arguments.start_offset * 1e9)
        remaps = dict(_pair(text) for text in arguments.remap)
        topics = topics_of(reader)
        unknown = set(arguments.topics or ()) - set(topics)
        if unknown:
            raise CliError(f'the bag has no topic {min(unknown)}; it has: {", ".join(topics)}')
        self.publishers = {}
        for name, connections in topics.items():
            if arguments.topics and name not in arguments.topics:
                continue
            try:
                message_class = load(connections[0].msgtype, 'msg')
            except CliError as error:
                print(f'{name} is not played: {error}', flush=True)
                continue
            self.publishers[name] = node.create_publisher(
                message_class, remaps.get(name, name), _profile(connections))
        if not self.publishers:
            raise CliError('the bag has no topic that can be played')
        self._connections = [c for name in self.publishers for c in topics[name]]
        self._clock = _Clock(node, arguments.clock) if arguments.clock else None

    def await_subscribers(self, timeout):
        """Give subscribers that are there the time to be found [s]: they miss nothing then."""
        discovery.wait_for(lambda: all(p.get_subscription_count()
                                       for p in self.publishers.values()), timeout)

    def play(self):
        """Publish all messages once; whether there were any."""
        start, before = time.monotonic(), self.count
        for connection, stamp, data in self._reader.messages(self._connections):
            if stamp < self._begin:
                continue
            self._wait(start + (stamp - self._begin) / 1e9 / self._rate, stamp)
            self.publishers[connection.topic].publish(bytes(data))
            self.count += 1
        return self.count > before

    def _wait(self, due, stamp):
        while True:
            left = due - time.monotonic()
            if self._clock is not None:
                self._clock.tick(stamp - round(max(0.0, left) * self._rate * 1e9))
            if left <= 0.0:
                return
            time.sleep(min(left, _LONGEST_NAP if self._clock is None else self._clock.period))

    def finish(self):
        """Let slow readers take the last messages."""
        from rclpy.duration import Duration
        for publisher in self.publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=1.0))


class _Clock:
    """/clock, at most at its rate."""

    def __init__(self, node, rate):
        from rosgraph_msgs.msg import Clock
        self._out, self._message = node.create_publisher(Clock, '/clock', 10), Clock()
        self.period = min(1.0 / rate, _LONGEST_NAP)
        self._due = 0.0

    def tick(self, stamp):
        if time.monotonic() < self._due:
            return
        self._due = time.monotonic() + self.period
        self._message.clock.sec, self._message.clock.nanosec = divmod(max(0, stamp), 10**9)
        self._out.publish(self._message)


def _pair(text):
    old, found, new = text.partition(':=')
    if not found or not old or not new:
        raise CliError(f'malformed remap {text!r}, expected old:=new')
    return old, new


def _profile(connections):
    """QoS that the recorded publishers offered, as far as it was stored."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
    offered = [q for c in connections for q in (c.ext.offered_qos_profiles or ())]
    reliable = all(q.reliability.name != 'BEST_EFFORT' for q in offered)
    latched = bool(offered) and all(q.durability.name == 'TRANSIENT_LOCAL' for q in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=100,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
