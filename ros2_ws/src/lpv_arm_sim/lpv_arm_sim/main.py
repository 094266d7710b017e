"""Entry point of ``ros2 run lpv_arm_sim simulator``."""

from functools import partial

from lpv_node.start import start

main = partial(start, 'lpv_arm_sim.node', 'SimulatorNode')
