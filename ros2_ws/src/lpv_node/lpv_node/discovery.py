"""How soon nodes find each other. Needs no ROS."""

import os
from pathlib import Path

_PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def announce_often() -> None:
    """Let Fast DDS use the profile ``fastdds.xml`` of this package, unless the user has one.

    To be called before rclpy.init; other middlewares ignore it.
    """
    if not any(os.environ.get(name) for name in _PROFILE_VARIABLES):
        os.environ[_PROFILE_VARIABLES[0]] = str(Path(__file__).with_name('fastdds.xml'))
