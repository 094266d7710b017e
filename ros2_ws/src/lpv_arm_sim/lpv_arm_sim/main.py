"""Entry point of ``ros2 run lpv_arm_sim simulator``."""

from lpv_node.start import start


def main(argv: list[str] | None = None) -> None:
    """Start the node."""
    start('lpv_arm_sim.node', 'SimulatorNode', argv)
