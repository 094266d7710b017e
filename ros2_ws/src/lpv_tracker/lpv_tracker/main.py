"""Entry point of ``ros2 run lpv_tracker tracker``."""

from functools import partial

from lpv_node.start import start

main = partial(start, 'lpv_tracker.node', 'TrackerNode')
