"""Entry point of ``ros2 run lpv_uio uio``."""

from functools import partial

from lpv_node.start import start

main = partial(start, 'lpv_uio.node', 'UioNode')
