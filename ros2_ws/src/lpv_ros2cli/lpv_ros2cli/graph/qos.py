"""Quality of service on the command line, and what fits the publishers that are there."""

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from lpv_ros2cli.errors import CliError

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos import QoSProfile

_PROFILES = ('default', 'sensor_data', 'services_default', 'parameters', 'system_default')
_RELIABILITY = ('reliable', 'best_effort', 'system_default')
_DURABILITY = ('volatile', 'transient_local', 'system_default')
_HISTORY = ('keep_last', 'keep_all', 'system_default')


def add_arguments(parser: ArgumentParser, default: str) -> None:
    """Declare the QoS options."""
    parser.add_argument(
        '--qos-profile', choices=_PROFILES, default=None, help=f'profile to start from ({default})'
    )
    parser.add_argument('--qos-depth', type=int, default=None, metavar='N', help='queue length')
    parser.add_argument('--qos-history', choices=_HISTORY, default=None)
    parser.add_argument('--qos-reliability', choices=_RELIABILITY, default=None)
    parser.add_argument('--qos-durability', choices=_DURABILITY, default=None)


def chosen_profile(arguments: Namespace, base: 'QoSProfile') -> 'QoSProfile':
    """Profile with what the options ask for."""
    from rclpy import qos

    if arguments.qos_profile is not None:
        base = qos.QoSPresetProfiles.get_from_short_key(arguments.qos_profile)
    if arguments.qos_depth is not None and arguments.qos_depth < 0:
        raise CliError('--qos-depth must not be negative')
    profile = qos.QoSProfile(
        history=base.history,
        depth=base.depth,
        reliability=base.reliability,
        durability=base.durability,
    )
    if arguments.qos_history is not None:
        profile.history = qos.HistoryPolicy.get_from_short_key(arguments.qos_history)
    if arguments.qos_depth is not None:
        profile.depth = arguments.qos_depth
    if arguments.qos_reliability is not None:
        profile.reliability = qos.ReliabilityPolicy.get_from_short_key(arguments.qos_reliability)
    if arguments.qos_durability is not None:
        profile.durability = qos.DurabilityPolicy.get_from_short_key(arguments.qos_durability)
    return profile


def matching(node: 'Node', topic: str, depth: int = 10) -> 'QoSProfile':
    """Profile that is compatible with every publisher of a topic."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    profiles = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    reliable = bool(profiles) and all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles)
    latched = bool(profiles) and all(
        p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles
    )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
