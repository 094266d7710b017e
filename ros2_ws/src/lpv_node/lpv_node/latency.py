"""Limits of latency: from the gains, or as parameters set them."""

from rclpy.node import Node

FROM_GAINS = '0: as the gains allow'
"""What a parameter means that was not set."""


def chosen_limit(node: Node, name: str, certified: float) -> float:
    """Value of a parameter, or what follows from the gains if it is 0 [s].

    A longer one is taken, with a warning: nothing is known of the loop there.
    """
    value = float(node.get_parameter(name).value)
    if value > certified:
        node.get_logger().warning(
            f'{name}: {value:g} s is longer than the {certified:.3g} s that the gains allow; '
            'the loop may become unstable before the arm is stopped'
        )
    return value or certified
