"""Calls of services with a limit of time."""

import time
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph.discovery import wait_for

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.node import Node

_TIMEOUT = 5.0
"""Longest wait for a service, and for its answer [s]."""


def call(node: 'Node', client: 'Client', request: object, timeout: float | None = _TIMEOUT) -> Any:
    """Call a service that is there."""
    import rclpy

    future = client.call_async(request)
    deadline = None if timeout is None else time.monotonic() + timeout
    while not future.done():
        if deadline is not None and time.monotonic() > deadline:
            client.remove_pending_request(future)
            raise CliError(f"service '{client.srv_name}' did not answer within {timeout:g} s")
        rclpy.spin_until_future_complete(node, future, timeout_sec=0.1)
    return future.result()


def ready_client(
    node: 'Node', service_class: Any, name: str, timeout: float = _TIMEOUT
) -> 'Client':
    """Client of a service, as soon as the service is there."""
    client: Client = node.create_client(service_class, name)
    if not wait_for(client.service_is_ready, timeout):
        node.destroy_client(client)
        raise CliError(f"service '{client.srv_name}' is not available (waited {timeout:g} s)")
    return client
