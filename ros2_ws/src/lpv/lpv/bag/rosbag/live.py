"""Types and quality of service of a bag's topics in a running graph."""

import importlib
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

DEEPEST = 20_000
"""Messages in the deepest queues, which must lose none: 20 s at 1 kHz, a whole run."""


def message_class(msgtype: str) -> Any:
    """Class of a message type; ValueError, AttributeError, ImportError if it is not installed."""
    package, kind, name = msgtype.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), name)


def type_name(kind: type) -> str:
    """Name of a message type by its class."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def ros_qos(reliable: bool, latched: bool, depth: int) -> QoSProfile:
    """QoS of a publisher or subscription."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
