"""On which machines nodes find each other. Needs no ROS."""

import os
from collections.abc import MutableMapping

DISCOVERY_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def stay_local(environment: MutableMapping[str, str] = os.environ) -> None:
    """Restrict discovery to this machine, unless the user has chosen a range.

    ``environment`` may be that of a process that is about to be started.
    """
    environment.setdefault(DISCOVERY_RANGE, 'LOCALHOST')
