"""Joins the graph for some seconds and writes down what is there."""

import os
import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from lpv.bag.rosbag.live import node_alone
from lpv.bag.run.record import CORRECTED
from lpv.core.support.discovery import stay_local
from lpv.core.support.limits import PATIENCE
from lpv.core.support.timestamps import to_nanoseconds

JOINT_STATE = 'sensor_msgs/msg/JointState'
OURS = ('arm_sim', 'uio', 'tracker', 'recorder', 'view')
"""Names of this software's nodes."""
_PARAMETERS = ('use_sim_time', 'lockstep', 'arm_file', 'torque_source', 'gains.arm_sha256')
_QUIET, _LONGEST_SEARCH = 3.2, 2.0 * PATIENCE
"""Time without news that ends the search (DDS announces every 3 s), and that of its end [s]."""
_MOST_TOPICS = 8
"""More joint_states topics than these are not listened to."""


class Endpoint(NamedTuple):
    """A publisher or subscription."""

    node: str  # full name of its node
    msgtype: str
    qos: QoSProfile  # offered or requested


@dataclass
class Snapshot:
    """What was seen of a graph."""

    domain: int = 0  # ROS_DOMAIN_ID
    seconds: float = 3.0  # time of listening [s]
    nodes: list = field(default_factory=list)  # full names; twice where two nodes have one name
    # state of each managed node of ours; None where it did not answer
    states: dict = field(default_factory=dict)
    parameters: dict = field(default_factory=dict)  # of each node of ours that answered
    publishers: dict = field(default_factory=dict)  # by topic
    subscriptions: dict = field(default_factory=dict)  # by topic
    # by topic of JointState: pairs of time of arrival [ns] and message
    measured: dict = field(default_factory=dict)
    clock: list = field(default_factory=list)  # pairs of time of arrival and time on /clock [ns]

    def ours(self) -> list[str]:
        """Full names of this software's nodes, each once."""
        return sorted({n for n in self.nodes if n.rsplit('/', 1)[1] in OURS})


def watch(seconds: float) -> Snapshot:
    """Join the graph of this shell's domain and look around."""
    stay_local()
    options = {'enable_rosout': False, 'start_parameter_services': False}
    with node_alone(f'lpv_doctor_{os.getpid()}', **options) as (node, executor):
        return _look(node, executor, seconds)


def _look(node: Any, executor: Any, seconds: float) -> Snapshot:
    # Wait until everybody has been found.
    end, quiet_since, known = time.monotonic() + _LONGEST_SEARCH, time.monotonic(), None
    while time.monotonic() < min(end, quiet_since + _QUIET):
        executor.spin_once(timeout_sec=0.1)
        found = sorted(node.get_node_names_and_namespaces()), node.get_topic_names_and_types()
        if found != known:
            known, quiet_since = found, time.monotonic()
    shot = Snapshot(node.context.get_domain_id(), seconds)
    names = [f'{ns.rstrip("/")}/{name}' for name, ns in node.get_node_names_and_namespaces()]
    shot.nodes = sorted(n for n in names if not n.startswith('/lpv_doctor_'))
    for topic, _types in node.get_topic_names_and_types():
        shot.publishers[topic] = _endpoints(node.get_publishers_info_by_topic(topic))
        shot.subscriptions[topic] = _endpoints(node.get_subscriptions_info_by_topic(topic))
    _listen(node, shot)
    questions: dict[tuple[str, str], Any] = {}  # by node and parameter: client and request
    for name in shot.ours():
        state = node.create_client(GetState, f'{name}/get_state')
        values = node.create_client(GetParameters, f'{name}/get_parameters')
        questions[name, ''] = state, GetState.Request()
        for one in _PARAMETERS:  # a name that a node does not know spoils the answer to others
            questions[name, one] = values, GetParameters.Request(names=[one])
    futures: dict[tuple[str, str], Any] = {}  # once the service was found
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for key, (client, request) in questions.items():
            if key not in futures and client.service_is_ready():
                futures[key] = client.call_async(request)
        executor.spin_once(timeout_sec=min(0.05, max(0.0, end - time.monotonic())))
    for name, parameter in questions:
        future = futures.get((name, parameter))
        answer = future.result() if future and future.done() else None
        if not parameter:
            shot.states[name] = None if answer is None else answer.current_state.label
        elif answer is not None and answer.values:
            shot.parameters.setdefault(name, {})[parameter] = parameter_value_to_python(
                answer.values[0]
            )
    return shot


def _listen(node: Any, shot: Snapshot) -> None:
    topics = [
        topic
        for topic, ends in sorted(shot.publishers.items())
        if any(e.msgtype == JOINT_STATE for e in ends) and not topic.endswith(f'/{CORRECTED}')
    ]
    for topic in topics[:_MOST_TOPICS]:
        received = shot.measured[topic] = []

        def take(message: Any, to: list = received) -> None:
            to.append((time.time_ns(), message))

        node.create_subscription(JointState, topic, take, qos_profile_sensor_data)

    def tick(message: Any) -> None:
        shot.clock.append((time.time_ns(), to_nanoseconds(message.clock)))

    node.create_subscription(Clock, '/clock', tick, qos_profile_sensor_data)


def _endpoints(infos: list[Any]) -> list[Endpoint]:
    return [
        Endpoint(f'{i.node_namespace.rstrip("/")}/{i.node_name}', i.topic_type, i.qos_profile)
        for i in infos
        if not i.node_name.startswith('lpv_doctor_')
    ]
