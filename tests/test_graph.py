"""The real graph: nodes as processes, services, alarms, recordings."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import ros
from places import BRINGUP

pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from lifecycle_msgs.msg import State, Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState, GetState  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from rcl_interfaces.msg import ParameterType  # noqa: E402
from rcl_interfaces.srv import DescribeParameters, ListParameters  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402

from lpv_bag.run.record import load_run  # noqa: E402
from lpv_core.uio.certificate.gains import save_gains  # noqa: E402
from lpv_msgs.msg import FaultAlarm, FaultEstimate, GroundTruth, StateEstimate, TorqueCommand  # noqa: E402
from lpv_msgs.srv import ClearFaults, InjectFault  # noqa: E402
from lpv_node.qos import latched, stream  # noqa: E402

pytestmark = pytest.mark.ros

ARM = f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
CALM = """
name: calm
duration: 600.0
path:
  waypoints:
    - {t: 0.5, x: -0.8451, y: 1.5893}
    - {t: 20.0, x: 0.8451, y: 1.5893}
"""


@pytest.fixture(scope='module')
def gains_file(paper_gains, tmp_path_factory):
    path = tmp_path_factory.mktemp('gains') / 'gains.yaml'
    save_gains(paper_gains, path)
    return path


@pytest.fixture
def calm(tmp_path):
    path = tmp_path / 'calm.yaml'
    path.write_text(CALM)
    return f'scenario_file:={path}'


def start(running, names, gains_file, scenario, *parameters):
    for name in names:
        own = {
            'recorder': [],
            'simulator': [ARM, scenario],
            'uio': [ARM],
            'tracker': [ARM, scenario],
        }[name]
        files = [gains_file] if name in ('uio', 'tracker') else []
        running.start(name, ros.command(name, *own, *parameters, files=files))


@pytest.mark.realtime
def test_given_a_running_graph_when_a_fault_is_injected_then_the_alarm_is_on_topic_and_in_bag(
    tmp_path, gains_file, calm
):
    domain, bag = ros.next_domain(), tmp_path / 'bag'
    with ros.graph(tmp_path / 'log', domain) as running:
        running.start('recorder', ros.command('recorder', f'output:={bag}'))
        start(running, ('uio', 'tracker', 'simulator'), gains_file, calm, 'await_recorders:=1')
        with ros.client(domain) as client:
            alarms = client.listen(FaultAlarm, 'fault_alarm', latched())
            states = client.listen(StateEstimate, 'state_estimate', qos_profile_sensor_data)
            reports = client.listen(DiagnosticArray, '/diagnostics', 10)
            assert client.wait(lambda: len(states) > 100), 'no estimates'
            assert alarms == []
            answer = client.call(
                InjectFault, 'arm_sim/inject_fault', sensor='link2_angle', kind='bias', size=0.3
            )
            assert answer.success, answer.message
            assert client.wait(lambda: alarms), 'no alarm'
            assert client.wait(
                lambda: any(s.level == DiagnosticStatus.ERROR for r in reports for s in r.status)
            )
            cleared = client.call(ClearFaults, 'arm_sim/clear_faults', sensor='')
            assert (cleared.success, cleared.cleared) == (True, 1)
            assert client.wait(lambda: alarms[-1].event == FaultAlarm.CLEARED), 'not cleared'
        codes = running.stop()
    assert set(codes.values()) == {0}, codes
    raised = alarms[0]
    assert (raised.event, raised.sensor) == (FaultAlarm.RAISED, 'link2_angle')
    assert raised.size == pytest.approx(0.3, abs=0.1)
    errors = [s for r in reports for s in r.status if s.level == DiagnosticStatus.ERROR]
    assert {s.hardware_id for s in errors if '/uio:' in s.name} == {'link2_angle'}
    assert_in_bag(bag, raised)


def assert_in_bag(bag, raised):
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == '/lpv/fault_alarm']
        events = [
            reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections)
        ]
    assert [e.event for e in events][0] == FaultAlarm.RAISED
    assert (events[0].sensor, events[0].size) == (raised.sensor, raised.size)
    with open(next(bag.glob('*.mcap')), 'rb') as file:
        reader = make_reader(file)
        found = [
            (schema.name, schema.encoding, message.data)
            for schema, _, message in reader.iter_messages(topics=['/lpv/fault_alarm'])
        ]
    assert len(found) == len(events)
    assert found[0][:2] == ('lpv_msgs/msg/FaultAlarm', 'ros2msg')
    assert b'link2_angle' in found[0][2]
    record = load_run(bag)
    size = record.get('fault_estimate', 'estimate')[:, 1]
    assert np.nanmax(size) == pytest.approx(0.3, abs=0.1)


def test_given_faults_that_make_no_sense_when_injected_then_the_reason_is_told(
    tmp_path, gains_file, calm
):
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running:
        start(running, ('simulator',), gains_file, calm)
        with ros.client(domain) as client:
            for fields, named in (
                ({'sensor': 'elbow', 'kind': 'bias', 'size': 1.0}, 'sensor'),
                ({'sensor': 'link1_angle', 'kind': 'odd'}, 'kind'),
                ({'sensor': 'link1_angle', 'kind': 'bias'}, 'size'),
                ({'sensor': 'link1_angle', 'kind': 'bias', 'size': math.nan}, 'size'),
            ):
                answer = client.call(InjectFault, 'arm_sim/inject_fault', **fields)
                assert not answer.success
                assert f'fault.{named}' in answer.message
            answer = client.call(ClearFaults, 'arm_sim/clear_faults', sensor='elbow')
            assert not answer.success
        assert running.stop() == {'simulator': 0}


def test_given_a_graph_when_it_runs_then_nobody_reads_the_ground_truth(tmp_path, gains_file, calm):
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running:
        start(running, ('uio', 'tracker', 'simulator'), gains_file, calm)
        with ros.client(domain) as client:
            commands = client.listen(TorqueCommand, 'torque_command', qos_profile_sensor_data)
            assert client.wait(lambda: len(commands) > 50)
            node = client.node
            assert client.wait(lambda: node.count_publishers('ground_truth') == 1)
            assert node.count_subscribers('ground_truth') == 0
            types = dict(node.get_topic_names_and_types())
            assert types['/lpv/ground_truth'] == ['lpv_msgs/msg/GroundTruth']
            for info in node.get_publishers_info_by_topic('/lpv/joint_states'):
                assert info.topic_type == 'sensor_msgs/msg/JointState'
                assert info.qos_profile.reliability == qos_profile_sensor_data.reliability
        assert set(running.stop().values()) == {0}


def joint_state(stamp, position=(1.5708, 0.0), names=('joint1', 'joint2'), velocity=(0.0, 0.0)):
    message = JointState(
        name=list(names), position=list(position), velocity=list(velocity), effort=[0.0, 0.0]
    )
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
    return message


def test_given_bad_messages_when_they_come_in_then_the_observer_lives_and_no_output_is_nan(
    tmp_path, gains_file, calm
):
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running:
        start(running, ('uio',), gains_file, calm)
        with ros.client(domain) as client:
            states = client.listen(StateEstimate, 'state_estimate', stream(False))
            faults = client.listen(FaultEstimate, 'fault_estimate', stream(False))
            out = client.node.create_publisher(JointState, 'joint_states', stream(True))
            assert client.wait(lambda: out.get_subscription_count() == 1)
            ms = 2_000_000
            bad = [
                joint_state(0, (math.nan, 0.0)),
                joint_state(ms),
                joint_state(2 * ms),
                joint_state(2 * ms),
                joint_state(ms),
                joint_state(3 * ms, names=('elbow', 'joint2')),
                joint_state(4 * ms, position=(0.0,)),
                joint_state(5 * ms, (math.inf, 0.0)),
                joint_state(6 * ms, velocity=(math.nan, 0.0)),
                JointState(),
                joint_state(7 * ms, velocity=(1e9, 0.0)),
                joint_state(10**9 * 100),
                joint_state(ms),
            ]
            # The first one again until an answer is heard: all have found each other then.
            assert client.wait(lambda: out.publish(bad[0]) or len(states) > 0)
            for message in bad:
                out.publish(message)
                client.wait(lambda: False, 0.05)
            before = len(states)
            out.publish(joint_state(8 * ms))
            assert client.wait(lambda: len(states) > before), 'the observer is dead'
        assert running.stop() == {'uio': 0}
    modes = [s.mode for s in states]
    assert modes[0] == StateEstimate.NO_ESTIMATE
    assert StateEstimate.STALE in modes
    values = [
        v
        for s in states
        for v in (
            *s.position,
            *s.velocity,
            *s.compensated_position,
            *s.measured_position,
            *s.measured_velocity,
        )
    ]
    values += [v for f in faults for v in (*f.estimate, *f.bound, *f.threshold)]
    assert np.isfinite(values).all()
    log = (tmp_path / 'log' / 'uio.log').read_text()
    assert "joint 'joint1' occurs 0 times" in log


@pytest.mark.parametrize(
    ('name', 'parameters', 'with_gains', 'told'),
    [
        ('uio', (), True, 'arm_file: must be set'),
        ('uio', ('arm_file:=/nowhere.yaml',), True, 'nowhere.yaml'),
        (
            'uio',
            (f'arm_file:={BRINGUP / "arms" / "real_arm.yaml"}',),
            True,
            'designed for another arm',
        ),
        ('uio', (ARM, 'torque_source:=guess'), True, 'torque_source'),
        ('tracker', (ARM, 'scenario_file:=/nowhere.yaml'), True, 'nowhere.yaml'),
        ('simulator', (ARM,), False, 'scenario_file: must be set'),
        ('recorder', ('output:=/proc/nothing/bag',), False, 'cannot be written'),
    ],
)
def test_given_a_node_that_cannot_start_when_run_then_it_says_why_and_ends_with_code_1(
    tmp_path, gains_file, name, parameters, with_gains, told
):
    with ros.graph(tmp_path) as running:
        line = ros.command(name, *parameters, files=[gains_file] if with_gains else [])
        node = running.start(name, line)
        assert node.process.wait(60) == 1
        running.stop()
    log = (tmp_path / f'{name}.log').read_text()
    assert re.search(told, log), log
    assert 'Traceback' not in log, log


@pytest.mark.parametrize('name', ['uio', 'tracker'])
def test_given_gains_whose_certificate_does_not_hold_when_started_then_the_node_refuses_them(
    tmp_path, paper_gains, calm, name
):
    observer = replace(paper_gains.observer, kappa=3.0 * paper_gains.observer.kappa)
    save_gains(replace(paper_gains, observer=observer), tmp_path / 'gains.yaml')
    with ros.graph(tmp_path) as running:
        start(running, (name,), tmp_path / 'gains.yaml', calm)
        assert running.nodes[0].process.wait(60) == 1
        running.stop()
    assert (
        'the certificate does not hold: observer, link 1' in (tmp_path / f'{name}.log').read_text()
    )


def test_given_a_node_without_autostart_when_managed_then_it_walks_through_its_states(
    tmp_path, gains_file, calm
):
    domain = ros.next_domain()
    with ros.graph(tmp_path, domain) as running:
        start(running, ('uio',), gains_file, calm, 'autostart:=false')
        with ros.client(domain) as client:

            def state():
                return client.call(GetState, 'uio/get_state').current_state.id

            def change(transition):
                request = Transition(id=transition)
                return client.call(ChangeState, 'uio/change_state', transition=request).success

            assert state() == State.PRIMARY_STATE_UNCONFIGURED
            for transition, after in (
                (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
                (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
                (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
                (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
                (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
                (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
                (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
            ):
                assert change(transition)
                assert state() == after
        assert running.stop() == {'uio': 0}


@pytest.mark.parametrize('name', ['uio', 'tracker', 'simulator', 'recorder'])
def test_given_a_node_when_asked_then_all_its_parameters_are_described(
    tmp_path, gains_file, calm, name
):
    domain, node = ros.next_domain(), {'simulator': 'arm_sim'}.get(name, name)
    with ros.graph(tmp_path, domain) as running:
        start(running, (name,), gains_file, calm, 'autostart:=false')
        with ros.client(domain) as client:
            names = client.call(ListParameters, f'{node}/list_parameters').result.names
            own = [n for n in names if not n.startswith(('use_sim_time', 'start_type', 'qos_'))]
            described = client.call(DescribeParameters, f'{node}/describe_parameters', names=own)
        running.stop()
    assert len(own) >= 5
    assert [d.name for d in described.descriptors if not d.description] == []
    numbers = {
        ParameterType.PARAMETER_DOUBLE: 'floating_point_range',
        ParameterType.PARAMETER_INTEGER: 'integer_range',
    }
    for d in described.descriptors:
        if d.type in numbers:
            (limits,) = getattr(d, numbers[d.type])
            assert limits.from_value < limits.to_value, d.name


def test_given_lockstep_when_nobody_answers_then_the_simulator_waits(tmp_path, gains_file, calm):
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running:
        start(running, ('simulator',), gains_file, calm, 'lockstep:=true')
        with ros.client(domain) as client:
            clocks = client.listen(Clock, '/clock', stream(True))
            truths = client.listen(GroundTruth, 'ground_truth', stream(True))
            measured = client.listen(JointState, 'joint_states', stream(True))
            out = client.node.create_publisher(TorqueCommand, 'torque_command', stream(True))
            assert client.wait(lambda: len(measured) == 1 and len(truths) == 1)
            client.wait(lambda: False, 0.5)
            assert len(measured) == len(clocks) == 1
            for step in range(1, 4):
                command = TorqueCommand(torque=[0.0, 0.0])
                command.header.stamp = measured[-1].header.stamp
                out.publish(command)
                out.publish(command)  # an answer given twice makes one step
                assert client.wait(lambda n=step: len(measured) == n + 1)
                client.wait(lambda: False, 0.1)
                assert len(measured) == len(clocks) == step + 1
        assert running.stop() == {'simulator': 0}
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in measured]
    assert np.diff(stamps).tolist() == [2_000_000] * 3
