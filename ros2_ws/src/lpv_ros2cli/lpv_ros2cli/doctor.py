"""``ros2 doctor``."""

import importlib.metadata
import os
import platform
import shutil
import socket
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path

from lpv_ros2cli import packages
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import node_names

_VARIABLES = (
    'ROS_DISTRO',
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_STATIC_PEERS',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
    'AMENT_PREFIX_PATH',
    'FASTRTPS_DEFAULT_PROFILES_FILE',
    'FASTDDS_DEFAULT_PROFILES_FILE',
)
_SMALLEST_SHM = 64 << 20
_HIGHEST_DOMAIN = 101


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('-r', '--report', action='store_true', help='print all that was found')


def run(arguments: Namespace) -> int:
    """Check the set-up of ROS on this machine; 1 if a check failed."""
    problems = list(_problems())
    if arguments.report:
        for heading, lines in _report():
            print(f'\n   {heading}')
            for name, value in lines:
                print(f'{name:<32}: {value}')
        print()
    for problem in problems:
        print(f'UserWarning: {problem}', file=sys.stderr)
    print(f'\n{len(problems)} check(s) failed\n' if problems else '\nAll checks passed\n')
    return int(bool(problems))


def _problems() -> Iterator[str]:
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    if not domain.isdigit() or int(domain) > _HIGHEST_DOMAIN:
        yield (
            f'ROS_DOMAIN_ID is {domain!r}: it should be a number from 0 to {_HIGHEST_DOMAIN}; '
            'the ports of higher ones are also given to other programs'
        )
    memory = Path('/dev/shm')
    if memory.is_dir() and shutil.disk_usage(memory).free < _SMALLEST_SHM:
        yield (
            f'{memory} is nearly full: middleware falls back to slow transports; end the '
            'nodes, then run: fastdds shm clean'
        )
    try:
        with discovery.command_node():
            pass
    except CliError as error:
        yield str(error)
    known = packages.names()
    for package in ('rclpy', 'lpv_msgs', 'lpv_bringup'):
        if package not in known:
            yield f'package {package} is not found: build the workspace, and source it'


def _report() -> Iterator[tuple[str, list[tuple[str, object]]]]:
    import rclpy

    yield (
        'PLATFORM INFORMATION',
        [
            ('system', platform.system()),
            ('release', platform.release()),
            ('machine', platform.machine()),
            ('processors', os.cpu_count()),
            ('python', f'{platform.python_version()} ({sys.executable})'),
        ],
    )
    yield (
        'ROS 2 INFORMATION',
        [
            *((name.lower(), os.environ.get(name, 'not set')) for name in _VARIABLES),
            ('middleware name', rclpy.get_rmw_implementation_identifier()),
            ('rclpy', _version('ros-rclpy')),
            ('packages', len(packages.names())),
        ],
    )
    yield 'NETWORK CONFIGURATION', [(name, _state(name)) for _, name in socket.if_nameindex()]
    with discovery.command_node() as node:
        discovery.settle(node)
        names = node_names(node, hidden=False)
        topics = node.get_topic_names_and_types()
        yield 'GRAPH', [('nodes', ', '.join(names) or 'none'), ('topics', len(topics))]
        yield (
            'TOPIC LIST',
            [
                (
                    topic,
                    f'{node.count_publishers(topic)} publishers, '
                    f'{node.count_subscribers(topic)} subscribers',
                )
                for topic, _ in sorted(topics)
            ],
        )


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return 'not a wheel'


def _state(interface: str) -> str:
    folder = Path('/sys/class/net') / interface
    try:
        state = (folder / 'operstate').read_text(encoding='ascii').strip()
        size = (folder / 'mtu').read_text(encoding='ascii').strip()
    except OSError:
        return 'unknown'
    return f'{state}, mtu {size}'
