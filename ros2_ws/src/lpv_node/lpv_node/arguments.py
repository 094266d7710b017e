"""Start of ROS from a node's command line, with errors in one line; how nodes meet."""

import os
import sys
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from lpv.core.support.errors import ConfigError

_PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def use_profiles() -> None:
    """Let Fast DDS use this package's ``fastdds.xml`` from rclpy.init on, but for own profiles."""
    if not any(os.environ.get(name) for name in _PROFILE_VARIABLES):
        # Fast DDS 2 does not read profiles of the next one.
        name = 'fastdds_2.xml' if os.environ.get('ROS_DISTRO') == 'jazzy' else 'fastdds.xml'
        os.environ[_PROFILE_VARIABLES[0]] = str(Path(__file__).with_name(name))


def initialise() -> None:
    """Start ROS without its signal handlers; ConfigError for wrong arguments or files."""
    use_profiles()
    for option, path in zip(sys.argv, sys.argv[1:]):
        if option == '--params-file' and not Path(path).is_file():
            raise ConfigError(
                '--params-file',
                f'there is no file {path}; gains of an arm are written by: lpv design --arm ARM '
                '--out GAINS.yaml; arm:= of a launch file is a shipped arm or a file, NAME.yaml',
            )
    try:
        # rclpy's own handler shuts the context down at once, with messages still in the queues.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:  # rcl's errors, arguments that rcl does not know
        raise refused(error) from error


def refused(error: Exception) -> ConfigError:
    """What rcl says of arguments."""
    return ConfigError('--ros-args', one_line(error))


def one_line(error: Exception) -> str:
    """What rcl says, without the place in its sources."""
    return ' '.join(str(error).split()).partition(', at /')[0]
