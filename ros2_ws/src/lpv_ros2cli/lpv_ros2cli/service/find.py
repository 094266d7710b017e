"""``ros2 service find``."""

from lpv_ros2cli.graph.lookup import SERVICES, FindVerb

_VERB = FindVerb(SERVICES)
add_arguments, run = _VERB.add_arguments, _VERB.run
