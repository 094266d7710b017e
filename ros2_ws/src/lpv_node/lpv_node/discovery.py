"""How nodes find each other: how soon, and on which machines. Needs no ROS."""

import os
from collections.abc import MutableMapping
from pathlib import Path

DISCOVERY_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_PROFILE_VARIABLES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def announce_often() -> None:
    """Let Fast DDS use the profile ``fastdds.xml`` of this package, unless the user has one.

    To be called before rclpy.init; other middlewares ignore it.
    """
    if not any(os.environ.get(name) for name in _PROFILE_VARIABLES):
        os.environ[_PROFILE_VARIABLES[0]] = str(Path(__file__).with_name('fastdds.xml'))


def stay_local(environment: MutableMapping[str, str] = os.environ) -> None:
    """Restrict discovery to this machine, unless the user has chosen a range.

    Parameters
    ----------
    environment : mutable mapping, optional
        Environment of the process, or of one that is about to be started.
    """
    environment.setdefault(DISCOVERY_RANGE, 'LOCALHOST')
