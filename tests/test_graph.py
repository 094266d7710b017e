"""The real graph: nodes as processes, services, alarms, recordings; nodes that cannot start."""

import signal
from dataclasses import replace

import numpy as np
import pytest
import ros
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from places import BRINGUP
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters
from rclpy.qos import qos_profile_sensor_data
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from test_restart import rig_on, stamp_of

from lpv.bag.run.record import load_run
from lpv.core.uio.certificate.gains import save_gains
from lpv_arm_sim.node import SimulatorNode
from lpv_msgs.msg import FaultAlarm, GroundTruth, StateEstimate, TorqueCommand
from lpv_msgs.srv import ClearFaults, InjectFault
from lpv_node.managed import run_node
from lpv_node.qos import latched, stream
from lpv_node.recorder.node import RecorderNode
from lpv_node.view.node import ViewNode
from lpv_tracker.node import TrackerNode
from lpv_uio.node import UioNode

pytestmark = pytest.mark.ros

ARM = f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
GAINS = BRINGUP / 'gains' / 'paper.yaml'
PAPER = {'arm': BRINGUP / 'arms' / 'paper.yaml', 'gains': GAINS}
CALM = """
name: calm
duration: 600.0
path: {waypoints: [{t: 0.5, x: -0.8451, y: 1.5893}, {t: 20.0, x: 0.8451, y: 1.5893}]}
"""
WRONG = '--params-file wrong.yaml'


@pytest.fixture
def signals_as_before():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.realtime
def test_given_a_running_graph_when_a_fault_is_injected_then_the_alarm_is_on_topic_and_in_bag(
    tmp_path,
):
    with rig_on(tmp_path, PAPER, scenario=CALM) as rig:
        rig.start('recorder')
        rig.start('uio', 'tracker', 'simulator', parameters=['await_recorders:=1'])
        client = rig.client
        alarms = client.listen(FaultAlarm, 'fault_alarm', latched())
        states = client.listen(StateEstimate, 'state_estimate', qos_profile_sensor_data)
        reports = client.listen(DiagnosticArray, '/diagnostics', 10)

        def errors():
            return [s for r in reports for s in r.status if s.level == DiagnosticStatus.ERROR]

        assert client.wait(lambda: len(states) > 100), 'no estimates'
        fault = {'sensor': 'link2_angle', 'kind': 'bias', 'size': 0.3}
        answer = client.call(InjectFault, 'arm_sim/inject_fault', **fault)
        assert answer.success, answer.message
        assert client.wait(lambda: alarms), 'no alarm'
        assert client.wait(errors)
        cleared = client.call(ClearFaults, 'arm_sim/clear_faults', sensor='')
        assert (cleared.success, cleared.cleared) == (True, 1)
        assert client.wait(lambda: alarms[-1].event == FaultAlarm.CLEARED), 'not cleared'
        for name in ('uio', 'tracker', 'arm_sim', 'recorder'):
            assert_described(client, name)
        ros.end(rig.running)
    raised = alarms[0]
    assert (raised.event, raised.sensor) == (FaultAlarm.RAISED, 'link2_angle')
    assert raised.size == pytest.approx(0.3, abs=0.1)
    said = {s.hardware_id: s.message for s in errors() if '/uio:' in s.name}
    assert said.keys() == {'link2_angle'}, said
    with AnyReader([tmp_path / 'bag1']) as reader:
        (connection,) = (c for c in reader.connections if c.topic == '/lpv/fault_alarm')
    kind = connection.msgtype, connection.msgdef.format.name
    assert kind == ('lpv_msgs/msg/FaultAlarm', 'MSG')
    record = load_run(tmp_path / 'bag1')
    assert len(record.alarms) == connection.msgcount
    first = record.alarms[0]
    assert (first.event, first.sensor, first.size) == (raised.event, raised.sensor, raised.size)
    size = record.get('fault_estimate', 'estimate')[:, 1]
    assert np.nanmax(size) == pytest.approx(0.3, abs=0.1)


def assert_described(client, name):
    """A node says of all its parameters what they are, and the range of its numbers."""
    names = client.call(ListParameters, f'{name}/list_parameters').result.names
    own = [n for n in names if not n.startswith(('use_sim_time', 'start_type', 'qos_'))]
    described = client.call(DescribeParameters, f'{name}/describe_parameters', names=own)
    assert len(own) >= 5
    assert [d.name for d in described.descriptors if not d.description] == []
    ranges = {ParameterType.PARAMETER_DOUBLE: 'floating_point_range',
              ParameterType.PARAMETER_INTEGER: 'integer_range'}  # fmt: skip
    for d in described.descriptors:
        if d.type in ranges:
            (limits,) = getattr(d, ranges[d.type])
            assert limits.from_value < limits.to_value, d.name


def test_given_lockstep_when_nobody_answers_then_the_simulator_waits(tmp_path):
    with rig_on(tmp_path, PAPER, lockstep=True) as rig:
        client, measured = rig.client, rig.heard['joint_states']
        clocks = client.listen(Clock, '/clock', stream(True))
        truths = client.listen(GroundTruth, 'ground_truth', stream(True))
        out = client.node.create_publisher(TorqueCommand, 'torque_command', stream(True))
        rig.start('simulator')
        assert client.wait(lambda: len(measured) == 1 and len(truths) == 1)
        rig.spin(0.5)
        assert len(measured) == len(clocks) == 1
        for step in range(1, 4):
            command = TorqueCommand(torque=[0.0, 0.0])
            command.header.stamp = measured[-1].header.stamp
            out.publish(command)
            out.publish(command)  # an answer given twice makes one step
            assert client.wait(lambda n=step: len(measured) == n + 1)
            rig.spin(0.1)
            assert len(measured) == len(clocks) == step + 1
        ros.end(rig.running)
    assert np.diff([stamp_of(m) for m in measured]).tolist() == [2_000_000] * 3


SCENARIO = f'-p {ARM} -p scenario_file:='


@pytest.mark.parametrize(
    ('kind', 'words', 'told'),
    [
        (UioNode, '', 'arm_file: must be set'),
        (UioNode, '-p arm_file:=/nowhere.yaml', 'nowhere.yaml'),
        (UioNode, f'-p arm_file:={BRINGUP / "arms" / "real_arm.yaml"}', 'for another arm'),
        (UioNode, f'-p {ARM} -p torque_source:=guess', 'torque_source'),
        (UioNode, '-p broken', '--ros-args: '),
        (UioNode, '--nix', '--ros-args: '),
        (
            UioNode,
            '--params-file /nowhere/gains.yaml',
            'there is no file /nowhere/gains.yaml; gains of an arm are written by: lpv design',
        ),
        (UioNode, f'-p {ARM} {WRONG}', 'the certificate does not hold: observer, link 1'),
        (TrackerNode, f'{SCENARIO}two_faults {WRONG}', 'does not hold: observer, link 1'),
        (TrackerNode, f'{SCENARIO}/nowhere.yaml', 'nowhere.yaml'),
        (SimulatorNode, f'-p {ARM}', 'scenario_file: must be set'),
        (RecorderNode, '-p output:=/proc/nothing/bag', 'cannot be written'),
        (ViewNode, f'-p {ARM} -p port:=70000', 'port'),
        (ViewNode, '', 'arm_file: must be set'),
        (ViewNode, f'{SCENARIO}/no/x.yaml', 'neither a file nor shipped'),
        (ViewNode, f'-p {ARM} -p address:=192.0.2.1 -p port:=0', 'cannot listen on 192.0.2.1'),
    ],
)
@pytest.mark.usefixtures('signals_as_before')
def test_given_a_node_that_cannot_start_when_run_then_it_says_why_and_ends_with_code_1(
    tmp_path, capfd, monkeypatch, paper_gains, kind, words, told
):
    monkeypatch.chdir(tmp_path)
    wrong = replace(paper_gains.observer, kappa=3.0 * paper_gains.observer.kappa)
    save_gains(replace(paper_gains, observer=wrong), 'wrong.yaml')
    given = ['--ros-args', *words.split()]
    if kind in (UioNode, TrackerNode) and '--params-file' not in words:
        given += ['--params-file', str(GAINS)]
    assert run_node(kind, given) == 1
    said = capfd.readouterr().err
    assert told in said and 'Traceback' not in said, said
