"""Quality of service of the graph's topics."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# Lockstep must not lose a message however slow the recorder is: it may lag by a whole run.
_LOCKSTEP_DEPTH = 20000


def stream(lockstep: bool) -> QoSProfile:
    """QoS of measurements, estimates and commands.

    Reliable with deep queues in lockstep; sensor-data QoS (best effort, the latest few) in real
    time, where an old sample is worth less than none.
    """
    if lockstep:
        return QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=_LOCKSTEP_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE,
        )
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=5, reliability=ReliabilityPolicy.BEST_EFFORT
    )


def latched() -> QoSProfile:
    """QoS of alarms, reliable and transient local: late subscribers get the last ones."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=50,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )
