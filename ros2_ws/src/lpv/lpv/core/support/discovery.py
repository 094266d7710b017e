"""On which machines nodes find each other. Needs no ROS."""

import os

DISCOVERY_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def stay_local() -> None:
    """Restrict discovery to this machine, unless the user has chosen a range."""
    os.environ.setdefault(DISCOVERY_RANGE, 'LOCALHOST')
