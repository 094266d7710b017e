"""``ros2 topic type``."""

from lpv_ros2cli.graph.lookup import TOPICS, TypeVerb

_VERB = TypeVerb(TOPICS)
add_arguments, run = _VERB.add_arguments, _VERB.run
