"""Entry point of ``ros2 run lpv_node recorder``."""

from functools import partial

from lpv_node.start import start

main = partial(start, 'lpv_node.recorder.node', 'RecorderNode')
