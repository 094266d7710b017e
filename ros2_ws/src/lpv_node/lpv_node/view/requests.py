"""Commands of the page as service calls."""

import queue
import time

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from lpv.core.support.limits import PATIENCE
from lpv_msgs.srv import ClearFaults, InjectFault
from lpv_node.view.access import MOST_CLIENTS
from lpv_node.view.commands import Command, Reply

_INACTIVE = 'the view node is not active: nothing was done'


class Requests:
    """Calls the services of simulator and observer on behalf of the page, by a node's clients."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clients: dict[str, Client] = {
            'inject': node.create_client(InjectFault, 'arm_sim/inject_fault'),
            'clear': node.create_client(ClearFaults, 'arm_sim/clear_faults'),
            'reset': node.create_client(Trigger, 'uio/reset'),
        }
        self._incoming: queue.Queue[tuple[Command, Reply]] = queue.Queue(MOST_CLIENTS)
        self._pending: list[tuple[Client, Future, Reply, float]] = []
        self._is_open = False

    def submit(self, command: Command, reply: Reply) -> bool:
        """Queue a command, or refuse it, in the server's thread; False if too many are waiting."""
        if not self._is_open:
            reply(False, _INACTIVE)
            return True
        has_room = not self._incoming.full()  # nobody else puts anything
        if has_room:
            self._incoming.put_nowait((command, reply))
        return has_room

    def open(self, is_open: bool) -> None:
        """Whether commands are taken from now on; none that waits acts when nobody expects it."""
        self._is_open = False
        while not self._incoming.empty():
            _, reply = self._incoming.get_nowait()
            reply(False, _INACTIVE)
        self._is_open = is_open

    def available(self) -> dict[str, bool]:
        """Whether each service is there, by name."""
        return {name: client.service_is_ready() for name, client in self._clients.items()}

    def work(self) -> None:
        """Send queued commands, pass on answers; called regularly in the node's thread."""
        while len(self._pending) < MOST_CLIENTS and not self._incoming.empty():
            command, reply = self._incoming.get_nowait()
            client = self._clients[command.name]
            if not client.service_is_ready():
                reply(False, f'{client.srv_name} is not there')
                continue
            asked = f'{command.name} {command.fields or ""}, asked for by a page'
            self._node.get_logger().info(asked)
            future = client.call_async(client.srv_type.Request(**command.fields))
            self._pending.append((client, future, reply, time.monotonic() + PATIENCE))
        waiting = []
        for client, future, reply, deadline in self._pending:
            if future.done():
                answer = future.result()
                if answer is None:
                    reply(False, str(future.exception()))
                else:
                    reply(answer.success, answer.message)
            elif time.monotonic() > deadline:
                client.remove_pending_request(future)
                reply(False, f'{client.srv_name} does not answer')
            else:
                waiting.append((client, future, reply, deadline))
        self._pending = waiting

    def close(self) -> None:
        for client in self._clients.values():
            self._node.destroy_client(client)
