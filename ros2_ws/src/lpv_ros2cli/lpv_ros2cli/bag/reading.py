"""Bags, read by lpv_bag; what it refuses is an error of the command line."""

import contextlib

from lpv_ros2cli.errors import CliError


@contextlib.contextmanager
def opened(path: str):
    """Context with an open bag.

    Parameters
    ----------
    path : str
        rosbag2 folder, or a single file of one.

    Yields
    ------
    lpv_bag.run.record.BagReader
        Open reader.

    Raises
    ------
    CliError
        If it is no bag, or damaged.
    """
    from lpv_bag.run.record import open_bag
    from lpv_core.support.errors import LpvError

    try:
        with open_bag(path) as reader:
            yield reader
    except LpvError as error:
        raise CliError(str(error)) from error


def topics_of(reader):
    """Topics of a bag.

    Parameters
    ----------
    reader : lpv_bag.run.record.BagReader
        Open reader.

    Returns
    -------
    dict of str to list of rosbags.interfaces.Connection
        Connections by topic, sorted.
    """
    topics = {}
    for connection in reader.connections:
        topics.setdefault(connection.topic, []).append(connection)
    return dict(sorted(topics.items()))
