"""Entry point of ``ros2 run lpv_uio uio``."""

from lpv_node.start import start


def main(argv: list[str] | None = None) -> None:
    """Start the node."""
    start('lpv_uio.node', 'UioNode', argv)
