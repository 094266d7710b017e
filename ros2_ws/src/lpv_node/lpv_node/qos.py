"""Quality of service of the graph's topics."""

from rclpy.qos import QoSProfile

from lpv.bag.rosbag.live import ros_qos

LOCKSTEP_DEPTH = 20000
"""Lockstep must not lose a message however slow the recorder is: it may lag by a whole run."""


def stream(lockstep: bool) -> QoSProfile:
    """QoS of measurements, estimates and commands.

    Reliable with deep queues in lockstep; sensor-data QoS (best effort, the latest few) in real
    time, where an old sample is worth less than none.
    """
    return ros_qos(lockstep, False, LOCKSTEP_DEPTH if lockstep else 5)


def latched() -> QoSProfile:
    """QoS of alarms, reliable and transient local: late subscribers get the last ones."""
    return ros_qos(True, True, 50)
