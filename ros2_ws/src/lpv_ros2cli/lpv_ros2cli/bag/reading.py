"""Bags, read by lpv_bag; what it refuses is an error of the command line."""

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lpv_ros2cli.errors import CliError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

    from lpv_bag.rosbag.reading import BagReader


@contextlib.contextmanager
def opened(path: str) -> Iterator['BagReader']:
    """Context with an open bag."""
    from lpv_bag.run.record import open_bag
    from lpv_core.support.errors import LpvError

    try:
        with open_bag(path) as reader:
            yield reader
    except LpvError as error:
        raise CliError(str(error)) from error


def topics_of(reader: 'BagReader') -> dict[str, list['Connection']]:
    """Topics of a bag."""
    topics: dict[str, list[Connection]] = {}
    for connection in reader.connections:
        topics.setdefault(connection.topic, []).append(connection)
    return dict(sorted(topics.items()))
