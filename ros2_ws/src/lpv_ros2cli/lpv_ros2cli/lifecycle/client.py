"""Managed nodes of the graph, and their services."""

from typing import TYPE_CHECKING, Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.graph.calling import call, ready_client
from lpv_ros2cli.graph.names import find_node, node_names

if TYPE_CHECKING:
    from lifecycle_msgs.msg import State, Transition, TransitionDescription
    from rclpy.node import Node

_STATE_TYPE = 'lifecycle_msgs/srv/GetState'


def managed_nodes(node: 'Node', hidden: bool = False) -> list[str]:
    """Nodes that have a lifecycle."""
    services = dict(node.get_service_names_and_types())
    return [
        name
        for name in dict.fromkeys(node_names(node, hidden))
        if _STATE_TYPE in services.get(f'{name}/get_state', ())
    ]


class Lifecycle:
    """Lifecycle of one node."""

    def __init__(self, node: 'Node', name: str, spin_time: float | None = None) -> None:
        self._node = node
        self.name = find_node(node, name, spin_time)

    def _call(self, service: Any, service_name: str, timeout: float, **fields: object) -> Any:
        try:
            client = ready_client(self._node, service, f'{self.name}/{service_name}', 2.0)
        except CliError as error:
            raise CliError(f'node {self.name} is not managed: {error}') from error
        return call(self._node, client, service.Request(**fields), timeout)

    def state(self) -> 'State':
        """Present state (lifecycle_msgs/State)."""
        from lifecycle_msgs.srv import GetState

        return self._call(GetState, 'get_state', 5.0).current_state

    def transitions(self) -> list['TransitionDescription']:
        """Transitions that are possible now."""
        from lifecycle_msgs.srv import GetAvailableTransitions

        found = self._call(GetAvailableTransitions, 'get_available_transitions', 5.0)
        return list(found.available_transitions)

    def transition_graph(self) -> list['TransitionDescription']:
        """All transitions."""
        from lifecycle_msgs.srv import GetAvailableTransitions

        found = self._call(GetAvailableTransitions, 'get_transition_graph', 5.0)
        return list(found.available_transitions)

    def change(self, transition: 'Transition') -> bool:
        """Trigger a transition; whether it succeeded. Nodes may take long to configure."""
        from lifecycle_msgs.srv import ChangeState

        return self._call(ChangeState, 'change_state', 120.0, transition=transition).success
