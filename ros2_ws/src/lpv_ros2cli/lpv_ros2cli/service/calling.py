"""Calls of services with a limit of time."""

import time

from lpv_ros2cli.discovery import wait_for
from lpv_ros2cli.errors import CliError

_PATIENCE = 5.0
"""Longest wait for a service, and for its answer [s]."""


def call(node, client, request: object, timeout: float | None = _PATIENCE) -> object:
    """Call a service that is there.

    Parameters
    ----------
    node : rclpy.node.Node
        Spins.
    client : rclpy.client.Client
        Of the node.
    request : object
        Request message.
    timeout : float or None, optional
        Longest wait for the answer [s].

    Returns
    -------
    object
        Response message.

    Raises
    ------
    CliError
        If no answer comes.
    """
    import rclpy

    future = client.call_async(request)
    deadline = None if timeout is None else time.monotonic() + timeout
    while not future.done():
        if deadline is not None and time.monotonic() > deadline:
            client.remove_pending_request(future)
            raise CliError(f"service '{client.srv_name}' did not answer within {timeout:g} s")
        rclpy.spin_until_future_complete(node, future, timeout_sec=0.1)
    return future.result()


def ready_client(node, service_class, name: str, timeout: float = _PATIENCE):
    """Client of a service, as soon as the service is there.

    Parameters
    ----------
    node : rclpy.node.Node
        Owns the client.
    service_class : type
        Class of the service.
    name : str
        Service.
    timeout : float, optional
        Longest wait [s].

    Returns
    -------
    rclpy.client.Client
        Ready.

    Raises
    ------
    CliError
        If it does not appear.
    """
    client = node.create_client(service_class, name)
    if not wait_for(client.service_is_ready, timeout):
        node.destroy_client(client)
        raise CliError(f"service '{client.srv_name}' is not available (waited {timeout:g} s)")
    return client
