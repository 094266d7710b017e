"""``ros2 bag info``."""

import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.bag.reading import opened, topics_of

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_SUFFIXES = {'.mcap': 'mcap', '.db3': 'sqlite3'}


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument('bag_path', help='bag')
    parser.add_argument(
        '-t', '--topic-name', action='store_true', help='only show the names of the topics'
    )


def run(arguments: Namespace) -> None:
    """Print files, times and topics of a bag."""
    with opened(arguments.bag_path) as reader:
        topics = topics_of(reader)
        if arguments.topic_name:
            print('\n'.join(topics))
            return
        files = _files(Path(arguments.bag_path))
        count = sum(c.msgcount for items in topics.values() for c in items)
        empty = count == 0
        start, end = (0, 0) if empty else (reader.start_time, reader.end_time)
        lines = {
            'Files:': '\n'.join(file.name for file in files),
            'Bag size:': _size(sum(file.stat().st_size for file in files)),
            'Storage id:': ', '.join(sorted({_SUFFIXES[file.suffix] for file in files})),
            'ROS Distro:': _distribution(Path(arguments.bag_path)),
            'Duration:': f'{(end - start) / 1e9:.9f}s',
            'Start:': _date(start),
            'End:': _date(end),
            'Messages:': count,
            'Topic information:': '\n'.join(_topic(*item) for item in topics.items()),
        }
    print()
    for heading, text in lines.items():
        print(f'{heading:<19}' + str(text).replace('\n', f'\n{"":<19}'))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)


def _distribution(path: Path) -> str:
    """As the bag's metadata says; bags of single files have none."""
    from lpv_ros2cli.command_line.yaml_text import read_yaml
    from lpv_ros2cli.errors import CliError

    try:
        data: Any = read_yaml(path / 'metadata.yaml', 'metadata')
        return data['rosbag2_bagfile_information'].get('ros_distro') or 'unknown'
    except (CliError, KeyError, TypeError, AttributeError):
        return 'unknown'


def _topic(name: str, connections: list['Connection']) -> str:
    first: Any = connections[0]  # of bags of ROS 2 only
    return (
        f'Topic: {name} | Type: {first.msgtype} | Count: {sum(c.msgcount for c in connections)}'
        f' | Serialization Format: {first.ext.serialization_format}'
    )


def _size(number: float) -> str:
    for unit in ('B', 'KiB', 'MiB'):
        if number < 1024:
            return f'{number} {unit}' if unit == 'B' else f'{number:.1f} {unit}'
        number /= 1024
    return f'{number:.1f} GiB'


def _date(stamp: int) -> str:
    seconds, rest = divmod(stamp, 10**9)
    date = time.strftime('%b %e %Y %H:%M:%S', time.localtime(seconds))
    return f'{date}.{rest:09d} ({seconds}.{rest:09d})'
