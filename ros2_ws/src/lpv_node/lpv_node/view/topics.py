"""Topics that the live view listens to, and how."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from lpv_msgs import msg
from lpv_node.qos import latched

_SHORTEST = 16
"""Least size of a message with a header, in CDR [bytes]."""


@dataclass(frozen=True)
class Topic:
    """One topic."""

    name: str  # as it is resolved in the node's namespace
    kind: type  # message class
    qos: QoSProfile = field(default_factory=lambda: qos_profile_sensor_data)  # of the subscription
    every: bool = False  # whether every message counts; of the others the latest one is enough


TOPICS = (
    Topic('joint_states', JointState),
    Topic('state_estimate', msg.StateEstimate),
    Topic('fault_estimate', msg.FaultEstimate),
    Topic('torque_command', msg.TorqueCommand),
    Topic('reference', msg.JointReference),
    Topic('ground_truth', msg.GroundTruth),
    Topic('fault_alarm', msg.FaultAlarm, latched(), every=True),
    Topic('/diagnostics', DiagnosticArray, QoSProfile(depth=10), every=True),
)


class Inbox:
    """Keeps the latest bytes of a topic, most never looked at, and passes some on at once."""

    def __init__(
        self,
        topic: Topic,
        forward: Callable[..., Any] | None,
        period: float,
        refuse: Callable[[str], None],
    ) -> None:
        self.topic = topic
        self._forward, self._period, self._refuse = forward, period, refuse
        self._waiting: list[tuple[float, bytes]] = []
        self._due = 0.0

    def store(self, data: bytes) -> None:
        """Callback of the subscription."""
        now = time.monotonic()
        if len(data) < _SHORTEST:
            self._refuse(f'bytes on {self.topic.name} that are no message')
            return
        self._waiting = [*(self._waiting[-99:] if self.topic.every else ()), (now, data)]
        if self._forward is not None and (self.topic.every or now >= self._due):
            self._due = max(self._due + self._period, now - self._period)
            self._forward(data)

    def take(self) -> list[tuple[float, Any]]:
        """Steady times of reception [s] and messages since the last call."""
        waiting, self._waiting = self._waiting, []
        messages: list[tuple[float, Any]] = []
        for now, data in waiting:
            try:
                messages.append((now, deserialize_message(data, self.topic.kind)))
            except Exception:  # the middleware's own kind
                self._refuse(f'bytes on {self.topic.name} that are no message')
        return messages
