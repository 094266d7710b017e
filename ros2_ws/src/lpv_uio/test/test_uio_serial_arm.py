"""The observer's node on a serial arm, without a graph."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from hostile import Output, node_of
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from serial_bags import crane_file, crane_run, record_crane

from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.reading import open_bag
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.faults import Fault
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate
from lpv_uio.node import UioNode

pytestmark = pytest.mark.ros

TOPICS = {
    '/lpv/state_estimate': ('state', StateEstimate),
    '/lpv/fault_estimate': ('fault', FaultEstimate),
    '/lpv/joint_states_corrected': ('corrected', JointState),
    '/lpv/fault_alarm': ('alarm', FaultAlarm),
    '/diagnostics': ('diagnostics', DiagnosticArray),
}


def observer(folder, *files):
    return node_of(UioNode, 'uio', *files, arm_file=crane_file(folder), lockstep='true')


def test_given_a_serial_arm_when_observed_then_the_node_publishes_what_a_replay_does(tmp_path):
    run = crane_run(faults=[Fault('encoder2', 'bias', 0.6, size=0.05)])
    bag, sent = record_crane(tmp_path / 'bag', run), {}
    with observer(tmp_path) as node:
        for topic, (name, kind) in TOPICS.items():
            output = Output(kind)
            setattr(node, f'_{name}_out', output)
            sent[topic] = output.sent
        with open_bag(bag) as reader:
            for _, _, data in reader.messages():
                node._on_measurement(deserialize_message(data, JointState))
    assert len(sent['/lpv/fault_alarm']) == 1
    assert len(sent['/lpv/joint_states_corrected']) == len(run.stamps)
    monitor = SerialSensorMonitor('/uio', load_arm(crane_file(tmp_path)))
    Replay(monitor, estimates_only=True).run(bag, tmp_path / 'out')
    with open_bag(tmp_path / 'out') as reader:
        for topic in TOPICS:
            [connection] = [c for c in reader.connections if c.topic == topic]
            expected = [data for _, _, data in reader.messages([connection])]
            types, kind = reader.typestore, connection.msgtype
            # Gaps between the fields of rclpy's messages hold anything.
            found = [reader.deserialize(serialize_message(one), kind) for one in sent[topic]]
            encoded = [bytes(types.serialize_cdr(one, kind)) for one in found]
        assert [one + bytes(-len(one) % 4) for one in encoded] == expected, topic


def test_given_a_measurement_of_another_arm_when_it_comes_then_it_is_refused(tmp_path):
    with observer(tmp_path) as node:
        zeros, names = [0.0, 0.0], ['joint1', 'joint2']
        node._on_measurement(JointState(name=names, position=zeros, velocity=zeros, effort=zeros))
        assert node._monitor.rejected == 1
        assert len(node._torque) == 3 and np.isnan(node._torque).all()
