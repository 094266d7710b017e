"""How soon nodes find each other. Needs no ROS."""

import os
from pathlib import Path

_FAST_DDS_2 = ('humble', 'jazzy')
"""Distributions whose Fast DDS does not read profiles of the next one."""
_PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def announce_often() -> None:
    """Let Fast DDS use the profiles ``fastdds.xml`` of this package, unless the user has some.

    To be called before rclpy.init; other middlewares ignore it.
    """
    if not any(os.environ.get(name) for name in _PROFILE_VARIABLES):
        is_old = os.environ.get('ROS_DISTRO') in _FAST_DDS_2
        name = 'fastdds_2.xml' if is_old else 'fastdds.xml'
        os.environ[_PROFILE_VARIABLES[0]] = str(Path(__file__).with_name(name))
