"""Commands of the page as service calls."""

import queue
import time
from collections.abc import Callable
from typing import Any

from std_srvs.srv import Trigger

from lpv_msgs.srv import ClearFaults, InjectFault

_PATIENCE = 3.0
"""How long an answer may take [s]."""
_MOST = 8
"""Commands that may wait or be under way."""


class Requests:
    """Calls the services of simulator and observer on behalf of the page.

    Parameters
    ----------
    node : rclpy.node.Node
        Owns the clients.
    """

    def __init__(self, node) -> None:
        self._node = node
        self._clients = {
            'inject': node.create_client(InjectFault, 'arm_sim/inject_fault'),
            'clear': node.create_client(ClearFaults, 'arm_sim/clear_faults'),
            'reset': node.create_client(Trigger, 'uio/reset'),
        }
        self._incoming = queue.Queue(_MOST)
        self._pending = []

    def submit(self, command, reply: Callable[..., Any]) -> bool:
        """Queue a command; called in the server's thread.

        Parameters
        ----------
        command : Command
            The command.
        reply : callable
            Gets success and a text.

        Returns
        -------
        bool
            False if there are too many already.
        """
        try:
            self._incoming.put_nowait((command, reply))
        except queue.Full:
            return False
        return True

    def available(self):
        """Whether each service is there, by name."""
        return {name: client.service_is_ready() for name, client in self._clients.items()}

    def work(self) -> None:
        """Send queued commands, pass on answers; called regularly in the node's thread."""
        while len(self._pending) < _MOST and not self._incoming.empty():
            self._send(*self._incoming.get_nowait())
        waiting = []
        for client, future, reply, deadline in self._pending:
            if future.done():
                answer, error = future.result(), future.exception()
                reply(
                    error is None and answer.success,
                    str(error) if error is not None else answer.message,
                )
            elif time.monotonic() > deadline:
                client.remove_pending_request(future)
                reply(False, f'{client.srv_name} does not answer')
            else:
                waiting.append((client, future, reply, deadline))
        self._pending = waiting

    def _send(self, command, reply) -> None:
        client = self._clients[command.name]
        if not client.service_is_ready():
            reply(False, f'{client.srv_name} is not there')
            return
        self._node.get_logger().info(f'{command.name} {command.fields or ""}, asked for by a page')
        future = client.call_async(client.srv_type.Request(**command.fields))
        self._pending.append((client, future, reply, time.monotonic() + _PATIENCE))

    def close(self) -> None:
        """Destroy the clients."""
        for client in self._clients.values():
            self._node.destroy_client(client)
