"""``ros2 topic find``."""

from lpv_ros2cli.graph.lookup import TOPICS, FindVerb

_VERB = FindVerb(TOPICS)
add_arguments, run = _VERB.add_arguments, _VERB.run
