"""Hostile messages, parameters and services on a running graph.

The rule: no process ends, no output is NaN or infinite, no traceback is logged, memory stays
bounded, what is refused is said on /diagnostics, and the arm is driven again.  How soon each node
recovers is in the nodes' own fuzzers, sockets in those of `lpv_node.view`.  LPV_FUZZ_SECONDS makes
it long, LPV_FUZZ_SEED another one.
"""

import os
import time

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hostile import damaged_bytes, fill, forge, parameter, sized
from rcl_interfaces.srv import SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from test_restart import files, rig_on  # noqa: F401

from lpv_msgs.msg import (
    FaultAlarm,
    FaultEstimate,
    GroundTruth,
    JointReference,
    StateEstimate,
    TorqueCommand,
)
from lpv_msgs.srv import ClearFaults, InjectFault

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.fuzz]

SECONDS = float(os.environ.get('LPV_FUZZ_SECONDS', '3'))
SEED = int(os.environ.get('LPV_FUZZ_SEED', '1'))
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
NODES = ('uio', 'tracker', 'simulator', 'view')
INPUTS = {
    'joint_states': JointState,
    'state_estimate': StateEstimate,
    'torque_command': TorqueCommand,
    'fault_estimate': FaultEstimate,
    'fault_alarm': FaultAlarm,
    'reference': JointReference,
    'ground_truth': GroundTruth,
    '/diagnostics': DiagnosticArray,
}
NUMBERS = {
    'state_estimate': (StateEstimate, ('position', 'velocity', 'compensated_position')),
    'fault_estimate': (FaultEstimate, ('estimate', 'bound', 'threshold')),
    'torque_command': (TorqueCommand, ('torque',)),
    'reference': (JointReference, ('position', 'velocity', 'acceleration')),
}
PARAMETERS = ('diagnosis.minimum_threshold', 'compensation', 'arm_file', 'lockstep')
MEMORY = 150e6
"""Most that a process may grow [byte]."""


class Fuzzer:
    """Sends hostile input of all kinds into a graph."""

    def __init__(self, rig, rng):
        self._rng, self._rig, self.sent = rng, rig, 0
        node = rig.client.node
        self._publishers = [
            (node.create_publisher(kind, topic, BEST_EFFORT), kind)
            for topic, kind in INPUTS.items()
        ]
        self._setters = [
            node.create_client(SetParameters, f'{name}/set_parameters')
            for name in ('uio', 'tracker', 'arm_sim', 'view')
        ]
        self._services = [
            (node.create_client(InjectFault, 'arm_sim/inject_fault'), InjectFault.Request),
            (node.create_client(ClearFaults, 'arm_sim/clear_faults'), ClearFaults.Request),
        ]

    def messages(self, count):
        """Some messages on each topic: what fits its type and is wrong, and bytes that do not."""
        for publisher, kind in self._publishers:
            for _ in range(count):
                publisher.publish(self._message(kind))
                publisher.publish(damaged_bytes(self._rng, kind()))
                self.sent += 2

    def _message(self, kind):
        if self._rng.random() < 0.3:
            return fill(self._rng, kind())
        return forge(self._rng, sized(kind(), 2))

    def requests(self):
        """A parameter for each node, and a fault that cannot be injected."""
        for setter in self._setters:
            setter.call_async(SetParameters.Request(parameters=[parameter(self._rng, PARAMETERS)]))
        for client, request in self._services:
            hostile = fill(self._rng, request())
            hostile.sensor = 'no such sensor'
            client.call_async(hostile)
        self.sent += len(self._setters) + len(self._services)


def assert_finite(heard, hostile):
    """Numbers of outputs; messages of the fuzzer itself carry no frame of the arm."""
    for topic, (_, fields) in NUMBERS.items():
        for message in heard[topic]:
            if message.header.frame_id == 'paper':
                for name in fields:
                    assert np.isfinite(getattr(message, name)).all(), (topic, message)
    assert hostile > 100


def test_given_hostile_input_when_the_graph_runs_then_it_lives_and_recovers(tmp_path, files):  # noqa: F811
    rng = np.random.default_rng(SEED)
    with rig_on(tmp_path, files) as rig:
        heard = {
            topic: rig.client.listen(kind, topic, BEST_EFFORT)
            for topic, (kind, _) in NUMBERS.items()
        }
        reports = rig.client.listen(DiagnosticArray, '/diagnostics', QoSProfile(depth=1000))
        for name in NODES:
            own = [f'arm_file:={files["arm"]}', 'port:=0'] if name == 'view' else []
            rig.start(name, *own)
        rig.logged('simulator', 'brakes released', 0)
        before = {name: memory(rig, name) for name in NODES}
        fuzzer = Fuzzer(rig, rng)
        deadline = time.monotonic() + SECONDS
        while time.monotonic() < deadline:
            fuzzer.messages(5)
            fuzzer.requests()
            rig.spin(0.05)
        rig.spin(1.0)
        for service in ('tracker/resume', 'arm_sim/release_brakes'):  # what an operator does
            answer = rig.client.node.create_client(Trigger, service).call_async(Trigger.Request())
            assert rig.client.wait(answer.done, 30.0), f'{service} does not answer'
        assert rig.client.wait(lambda: not rig.is_braked(), 150.0), 'braked for ever'
        grown = {name: memory(rig, name) - before[name] for name in NODES}
        assert max(grown.values()) < MEMORY, grown
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
    assert_finite(heard, fuzzer.sent)
    texts = [f'{v.key}' for m in reports for s in m.status for v in s.values]
    assert any('not finite' in text for text in texts), 'what is refused is not said'
    for name in NODES:
        assert 'Traceback' not in rig.log(name), rig.log(name)[-3000:]
    print(f'{fuzzer.sent} hostile inputs; grown by {max(grown.values()) / 1e6:.0f} MB')


def memory(rig, name):
    """Resident memory of a process [byte]."""
    return psutil.Process(rig.nodes[name].process.pid).memory_info().rss
