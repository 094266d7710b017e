"""Quality of service of the graph's topics."""

from rclpy.qos import QoSProfile

from lpv.bag.rosbag.live import DEEPEST, ros_qos


def stream(lockstep: bool) -> QoSProfile:
    """QoS of measurements, estimates and commands.

    Reliable with deep queues in lockstep; sensor-data QoS (best effort, the latest few) in real
    time, where an old sample is worth less than none.
    """
    return ros_qos(lockstep, False, DEEPEST if lockstep else 5)


def latched() -> QoSProfile:
    """QoS of alarms, reliable and transient local: late subscribers get the last ones."""
    return ros_qos(True, True, 50)
