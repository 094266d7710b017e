"""Types and quality of service of a bag's topics in a running graph, and a node in it."""

import contextlib
import importlib
from collections.abc import Iterator
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
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
    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=depth, reliability=reliability, durability=durability)


@contextlib.contextmanager
def node_alone(
    name: str, domain: int | None = None, make: Any = rclpy.create_node, **options: Any
) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """A node in a context of its own, and its executor, for as long as they are needed."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node, executor = make(name, context=context, **options), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
