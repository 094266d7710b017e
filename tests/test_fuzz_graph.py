"""Hostile messages, parameters and services on a running graph.

The rule: no process ends, no output is NaN or infinite, no traceback is logged, memory stays
bounded, what is refused is said on /diagnostics, and the arm is driven again.  How soon each node
recovers is in the nodes' own fuzzers, sockets in those of `lpv_node.view`.  LPV_FUZZ_SECONDS makes
it long, LPV_FUZZ_SEED another one.
"""

import os
from itertools import chain, takewhile

import numpy as np
import psutil
import pytest
import ros
from diagnostic_msgs.msg import DiagnosticArray
from fuzzing import cases
from hostile import damaged_bytes, fill, forge, numbers, parameter, sized
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from test_restart import RESUME, files, rig_on  # noqa: F401

from lpv_msgs import msg, srv

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.fuzz]
SEED = int(os.environ.get('LPV_FUZZ_SEED', '1'))
BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
NODES = {'uio': 'uio', 'tracker': 'tracker', 'simulator': 'arm_sim', 'view': 'view'}
"""Names in the graph by those of the programs."""
OUTPUTS = {'state_estimate': msg.StateEstimate, 'fault_estimate': msg.FaultEstimate,
           'torque_command': msg.TorqueCommand, 'reference': msg.JointReference}  # fmt: skip
INPUTS = {'joint_states': JointState, 'fault_alarm': msg.FaultAlarm, **OUTPUTS,
          'ground_truth': msg.GroundTruth, '/diagnostics': DiagnosticArray}  # fmt: skip
SERVICES = {'arm_sim/inject_fault': srv.InjectFault, 'arm_sim/clear_faults': srv.ClearFaults}
PARAMETERS = ('diagnosis.minimum_threshold', 'compensation', 'arm_file', 'lockstep')
MEMORY = 150e6
"""Most that a process may grow [byte]."""


def hostile_senders(node, rng):
    """Functions that each send one kind of hostile input into a graph."""

    def publisher(kind, topic):
        out = node.create_publisher(kind, topic, BEST_EFFORT)

        def send():
            for _ in range(5):  # what fits its type and is wrong, and bytes that do not
                whole = rng.random() < 0.3
                out.publish(fill(rng, kind()) if whole else forge(rng, sized(kind())))
                out.publish(damaged_bytes(rng, kind()))

        return send

    def caller(kind, name):
        client = node.create_client(kind, name)

        def send():
            request = kind.Request()
            if kind is SetParameters:
                request.parameters = [parameter(rng, PARAMETERS)]
            else:
                fill(rng, request).sensor = 'no such sensor'
            client.call_async(request)

        return send

    return [
        *(publisher(kind, topic) for topic, kind in INPUTS.items()),
        *(caller(SetParameters, f'{name}/set_parameters') for name in NODES.values()),
        *(caller(kind, name) for name, kind in SERVICES.items()),
    ]


def test_given_hostile_input_when_the_graph_runs_then_it_lives_and_recovers(tmp_path, files):  # noqa: F811
    with rig_on(tmp_path, files) as rig:
        node, listen = rig.client.node, rig.client.listen
        heard = {topic: listen(kind, topic, BEST_EFFORT) for topic, kind in OUTPUTS.items()}
        reports = listen(DiagnosticArray, '/diagnostics', QoSProfile(depth=1000))
        for name in NODES:
            rig.start(name, parameters=['port:=0'] if name == 'view' else ())
        rig.logged('simulator', 'brakes released')
        before = memory(rig)
        senders = hostile_senders(node, np.random.default_rng(SEED))
        # Nodes may not have found these senders yet, and report once a second.
        for _ in chain(cases(30), takewhile(lambda _: not is_said(reports), range(3000))):
            for send in senders:
                send()
            rig.spin(0.05)
        rig.spin(1.0)
        wall = Parameter('use_sim_time', value=False).to_parameter_msg()
        for name in NODES.values():  # there is no /clock that a node may have been told to follow
            rig.client.call(SetParameters, f'{name}/set_parameters', parameters=[wall])
        for service in RESUME.values():
            answer = node.create_client(Trigger, service).call_async(Trigger.Request())
            assert rig.client.wait(answer.done, 30.0), f'{service} does not answer'
        assert rig.client.wait(lambda: not rig.is_braked(), 150.0), 'braked for ever'
        count = len(rig.heard['ground_truth'])
        assert rig.client.wait(lambda: len(rig.heard['ground_truth']) > count + 100), (
            'it stands still'
        )
        grown = {name: size - before[name] for name, size in memory(rig).items()}
        assert max(grown.values()) < MEMORY, grown
        assert is_said(reports), 'what is refused is not said'
        ros.end(rig.running)
    for message in sum(heard.values(), []):
        if message.header.frame_id == 'paper':  # those of the fuzzer carry no frame of the arm
            assert all(np.isfinite(values).all() for values in numbers(message).values()), message
    for name in NODES:
        assert 'Traceback' not in rig.log(name), rig.log(name)[-3000:]


def is_said(reports):
    """Whether a report on /diagnostics counts values that are not finite."""
    keys = (value.key for report in reports for s in report.status for value in s.values)
    return any('not finite' in key for key in keys)


def memory(rig):
    """Resident memory of all processes [byte]."""
    return {name: psutil.Process(n.process.pid).memory_info().rss for name, n in rig.nodes.items()}
