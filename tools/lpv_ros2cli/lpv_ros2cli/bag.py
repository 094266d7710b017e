"""``ros2 bag``: record, info."""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

from lpv.core.support.resources import executable
from lpv_ros2cli import graph
from lpv_ros2cli.command_line import CliError, takes


@takes('topics', nargs='*', metavar='topic', help='topics')
@takes('-a', '--all', action='store_true', help='all topics')
@takes('-o', '--output', help='folder to create (rosbag2_<date>-<time>)')
def run_record(arguments: argparse.Namespace) -> None:
    """Record topics into a bag, which is complete after SIGINT or SIGTERM."""
    if not arguments.topics and not arguments.all:
        raise CliError('what is to be recorded? Name topics, or give --all')
    output = arguments.output or time.strftime('rosbag2_%Y_%m_%d-%H_%M_%S')
    if os.path.lexists(output):
        raise CliError(f"output folder '{output}' already exists")
    topics = [graph.absolute(name) for name in arguments.topics]
    chosen: dict[str, Any] = {'all': True} if arguments.all else {'topics': topics}
    program = str(executable('lpv_node', 'recorder'))
    words = [program, '--ros-args', '-r', '__node:=rosbag2_recorder']
    for name, value in {'output': output, **chosen}.items():
        words += ['-p', f'{name}:={json.dumps(value)}']  # JSON is YAML: quoted texts
    print('press Ctrl-C to end the recording', flush=True)
    os.execv(program, words)


@takes('bag_path')
def run_info(arguments: argparse.Namespace) -> None:
    """Print files, times and topics of a bag."""
    from rosbags.rosbag2 import Reader

    path = Path(arguments.bag_path)
    try:
        with Reader(path) as reader:
            lines = _lines(reader, path)
    except Exception as error:  # of a damaged file the library raises whatever it met
        raise CliError(f'bag {path} cannot be read: {error or type(error).__name__}') from error
    print()
    for heading, text in lines.items():
        print(f'{heading:<19}' + str(text).replace('\n', f'\n{"":<19}'))


def _lines(reader: Any, path: Path) -> dict[str, Any]:
    files = [path] if path.is_file() else sorted(path.glob('*.mcap')) or sorted(path.glob('*.db3'))
    size = sum(file.stat().st_size for file in files) / 1024
    start, end = (reader.start_time, reader.end_time - 1) if reader.message_count else (0, 0)
    topics = [
        f'Topic: {name} | Type: {topic.msgtype} | Count: {topic.msgcount}'
        ' | Serialization Format: cdr'
        for name, topic in sorted(reader.topics.items())
    ]
    return {
        'Files:': '\n'.join(file.name for file in files),
        'Bag size:': f'{size:.1f} KiB' if size < 1024 else f'{size / 1024:.1f} MiB',
        'Storage id:': 'sqlite3' if files[0].suffix == '.db3' else 'mcap',
        'ROS Distro:': reader.ros_distro or 'unknown',
        'Duration:': f'{(end - start) / 1e9:.9f}s',
        'Start:': _date(start),
        'End:': _date(end),
        'Messages:': reader.message_count,
        'Topic information:': '\n'.join(topics),
    }


def _date(stamp: int) -> str:
    seconds, rest = divmod(stamp, 10**9)
    date = time.strftime('%b %e %Y %H:%M:%S', time.localtime(seconds))
    return f'{date}.{rest:09d} ({seconds}.{rest:09d})'
