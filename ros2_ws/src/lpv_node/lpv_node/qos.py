"""Quality of service of the graph's topics."""

from rclpy.qos import QoSProfile

from lpv.bag.rosbag.live import DEEPEST, ros_qos


def stream(lockstep: bool, depth: int = 5, reliable: bool = False) -> QoSProfile:
    """QoS of measurements and commands: best effort in real time, where old ones mislead.

    Publishers for other packages are ``reliable``: subscriptions that ask for it, as by default,
    receive nothing else.
    """
    return ros_qos(lockstep or reliable, False, DEEPEST if lockstep else depth)


def latched() -> QoSProfile:
    """QoS of alarms, reliable and transient local: late subscribers get the last ones."""
    return ros_qos(True, True, 50)
