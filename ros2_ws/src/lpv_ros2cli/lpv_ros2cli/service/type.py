"""``ros2 service type``."""

from lpv_ros2cli.graph.lookup import SERVICES, TypeVerb

_VERB = TypeVerb(SERVICES)
add_arguments, run = _VERB.add_arguments, _VERB.run
