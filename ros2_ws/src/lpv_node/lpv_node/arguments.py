"""Start of ROS from a node's command line, with errors in one line."""

import sys
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from lpv.core.support.errors import ConfigError


def initialise(argv: list[str] | None = None) -> None:
    """Start ROS without its signal handlers, from ``argv`` or the process's command line.

    Raises ConfigError if a parameter file is missing, or the ROS arguments cannot be parsed.
    """
    argv = sys.argv if argv is None else argv
    for option, path in zip(argv, argv[1:]):
        if option == '--params-file' and not Path(path).is_file():
            raise ConfigError(
                '--params-file',
                f'there is no file {path}; gains of an arm are '
                'written by: lpv design --arm ARM --out GAINS.yaml',
            )
    try:
        # rclpy's own handler shuts the context down at once, with messages still in the queues.
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:  # rcl's errors, arguments that rcl does not know
        reason = ' '.join(str(error).split()).partition(', at /')[0]
        raise ConfigError('--ros-args', reason) from error
