"""Where nodes are looked for."""

import os


def stay_on_this_machine() -> None:
    """Find nodes of this machine only, unless the user has asked for more."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
