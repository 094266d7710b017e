import time
from contextlib import contextmanager
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from bag_messages import JOINT_STATE
from bags import contents, write_bag
from diagnostic_msgs.msg import DiagnosticArray
from hostile import RECOVERY, Output, Refused, forge, node_of, run_cases, set_parameters
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from serial_bags import TOPIC, crane_file, crane_run, record_crane
from std_srvs.srv import Trigger

from lpv import Alarm, AlarmEvent, Fault, Monitor, load_arm, load_gains, load_scenario
from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.reading import open_bag
from lpv.core.monitoring import answers, serial_monitor
from lpv.core.monitoring.alarm_text import UNUSABLE
from lpv.core.monitoring.message_fields import OK, STALE, WARN
from lpv.core.serial_arm.diagnosis.alarms import Mode, SensorState
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp, to_nanoseconds
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate, TorqueCommand
from lpv_uio import node as uio_node
from lpv_uio.messages import OutputMessages
from lpv_uio.node import UioNode
from lpv_uio.open_alarms import OpenAlarms

pytestmark = pytest.mark.ros
TOPICS = {
    'state': ('/lpv/state_estimate', StateEstimate),
    'fault': ('/lpv/fault_estimate', FaultEstimate),
    'corrected': ('/lpv/joint_states_corrected', JointState),
    'alarm': ('/lpv/fault_alarm', FaultAlarm),
    'diagnostics': ('/diagnostics', DiagnosticArray),
}


def with_outputs(node):
    outputs = {name: Output(kind) for name, (_, kind) in TOPICS.items()}
    for name, output in outputs.items():
        setattr(node, f'_{name}_out', output)
    return outputs


def troubled(bag, out):
    """The measurements of a bag as of a bad transport: some lost, doubled or overtaken."""
    data = [data for *_, data in contents(bag)[0]]
    rng, count = np.random.default_rng(4), len(data)
    order = np.argsort(np.arange(count) + 2.5 * (rng.random(count) < 0.03))
    order = np.repeat(order, rng.choice(3, count, p=[0.03, 0.95, 0.02]))
    entries = [(TOPIC, time, data[k]) for time, k in enumerate(order.tolist(), 10**9)]
    return write_bag(out, entries, {TOPIC: JOINT_STATE})


def test_given_a_bad_transport_when_observed_then_the_node_publishes_what_a_replay_does(tmp_path):
    run = crane_run(faults=[Fault('encoder2', 'bias', 0.6, size=0.05)])
    file, whole = crane_file(tmp_path), record_crane(tmp_path / 'whole', run)
    bag = troubled(whole, tmp_path / 'bag')
    with node_of(UioNode, arm_file=file) as node:
        outputs = with_outputs(node)
        for *_, data in contents(bag)[0]:
            node._on_measurement(deserialize_message(data, JointState))
        # Those of another arm are refused.
        zeros, names = [0.0, 0.0], ['joint1', 'joint2']
        node._on_measurement(JointState(name=names, position=zeros, velocity=zeros, effort=zeros))
        assert node._monitor.rejected == 1
        assert len(node._torque) == 3 and np.isnan(node._torque).all()
    assert len(outputs['alarm'].sent) == 1 and len(outputs['corrected'].sent) > 500
    monitor = serial_monitor.SerialSensorMonitor('/uio', load_arm(file))
    Replay(monitor, estimates_only=True).run(bag, tmp_path / 'out')
    assert min(monitor.counters.duplicates, monitor.counters.out_of_order) > 0
    with open_bag(tmp_path / 'out') as reader:
        for name, output in outputs.items():
            [connection] = [c for c in reader.connections if c.topic == TOPICS[name][0]]
            expected = [data for _, _, data in reader.messages([connection])]
            types, kind = reader.typestore, connection.msgtype
            # Gaps between the fields of rclpy's messages hold anything.
            found = [reader.deserialize(serialize_message(one), kind) for one in output.sent]
            encoded = [bytes(types.serialize_cdr(one, kind)) for one in found]
            assert [one + bytes(-len(one) % 4) for one in encoded] == expected, name


STEP = 2_000_000


class Arm:
    """Feeds an observer with the measurements of a braked arm, whatever else comes."""

    def __init__(self, node):
        self.node, self.stamp = node, 10**9
        self.outputs = with_outputs(node)
        self.state = self.outputs['state']
        self._plant = ArmSimulator(node._arm, load_scenario('two_faults'), 2)

    def stamped(self, message):
        set_stamp(message.header.stamp, self.stamp)
        return message

    def good(self):
        self.stamp += STEP
        self._plant.hold()
        sensed = self._plant.sense()
        values = {k: sensed[f'measured_{k}'].tolist() for k in ('position', 'velocity')}
        values['effort'] = sensed['effort'].tolist()
        return self.stamped(JointState(name=list(self.node._arm.joint_names), **values))

    def send(self, message):
        self.node._on_measurement(message)
        found = self.state.take()
        others = [output.take() for output in self.outputs.values()]
        if not found or self.state.last.mode in (int(Mode.STALE), int(Mode.NO_ESTIMATE)):
            raise Refused('not used')
        return found, others

    def refused(self):
        return sum(self.node._refusals.counts.values())

    def recover(self):
        """Time of good data until each sample is estimated again [ns]."""
        begin = used = self.stamp
        while self.stamp - begin < 2 * RECOVERY and self.stamp - used < 10 * STEP:
            try:
                self.send(self.good())
            except Refused:
                used = self.stamp
        return used - begin


@pytest.fixture
def arm():
    with node_of(UioNode, bringup_file('gains', 'paper'), arm_file='paper') as node:
        arm = Arm(node)
        arm.recover()  # what compiles takes its time
        yield arm


@pytest.mark.fuzz
def test_given_hostile_input_when_estimated_then_outputs_are_finite_and_it_recovers(arm):
    def forged(rng):
        assert arm.recover() <= RECOVERY
        return arm.send(forge(rng, arm.good()))

    def configured(rng):
        set_parameters(arm.node, rng)
        return arm.send(arm.good())

    assert run_cases(120, forged).refused and arm.recover() <= RECOVERY
    assert run_cases(100, configured, accepts=False).refused
    arm.node._on_reset(Trigger.Request(), Trigger.Response())
    assert arm.recover() <= RECOVERY
    assert np.isfinite(arm.node.get_parameter('diagnosis.clear_dwell').value)


@pytest.mark.fuzz
def test_given_forged_commands_when_torques_come_from_there_then_they_are_refused_or_finite(arm):
    arm.node._from_command = True

    def case(rng):
        arm.node._on_measurement(arm.good())
        arm.state.take()
        before = arm.refused()
        arm.node._on_command(forge(rng, arm.stamped(TorqueCommand(torque=[1.0, -1.0]))))
        refused = arm.refused() > before
        result = arm.send(arm.good())
        if refused:
            raise Refused('counted')
        return result

    assert run_cases(150, case).refused and arm.recover() <= RECOVERY


def test_given_a_second_publisher_when_its_readings_come_then_they_are_refused(arm, monkeypatch):
    arm.recover()
    monkeypatch.setattr('lpv_node.input_check._WAIT', np.inf)  # a busy machine is slow
    monkeypatch.setattr(arm.node, '_measurement_in', SimpleNamespace(get_publisher_count=lambda: 2))
    for _ in range(30):
        message = arm.good()
        foreign = deepcopy(message)
        foreign.position[0] += 0.5
        pytest.raises(Refused, arm.send, foreign)
        arm.send(message)
    assert arm.node._refusals.counts == {'measurement of a second publisher of joint_states': 30}
    assert arm.outputs['alarm'].sent == [], 'no alarm'


def test_given_a_gripper_on_the_topic_when_observed_then_it_is_no_error(arm, monkeypatch):
    arm.recover()
    said = []
    logger = SimpleNamespace(error=lambda text, **_: said.append(text), info=print, warning=print)
    monkeypatch.setattr(arm.node, 'get_logger', lambda: logger)
    first = list(arm.good().name)[0]
    for names, count in ((['finger'], 0), ([first, 'finger'], 1)):
        arm.node._on_measurement(JointState(name=names, position=[0.0] * len(names)))
        assert len(said) == count == arm.refused()
    assert said[0].startswith("/lpv/joint_states: joint 'joint2' occurs 0 times")
    monkeypatch.setattr(arm.node, '_measurement_in', SimpleNamespace(get_publisher_count=lambda: 2))
    for _ in range(50):  # a fault is none of the second publisher
        jumped = arm.good()
        jumped.position[1] += 0.1
        arm.node._on_measurement(jumped)
    assert [event.sensor for event in arm.outputs['alarm'].sent] == ['link2_angle']
    told = []
    monkeypatch.setattr(arm.node._status, 'report', lambda *found: told.append(found[1:3]))
    drivers = [SimpleNamespace(node_namespace='/', node_name=name) for name in ('a', 'b', 'finger')]
    monkeypatch.setattr(arm.node, 'get_publishers_info_by_topic', lambda _: drivers)
    arm.node._report(arm.stamp)
    refused = 'messages are refused: measurement without all joints of the arm'
    assert told.pop() == (WARN, f'3 publishers of joint_states: /a, /b, /finger; {refused}')
    monkeypatch.setattr(arm.node._refusals, '_last', -np.inf)  # long ago
    for count, heard in ((2, True), (1, True), (1, False)):  # the gripper has left, or the driver
        if not heard:
            monkeypatch.setattr(arm.node._sender, '_heard', -np.inf)
        there = [None] * count
        monkeypatch.setattr(arm.node, 'get_publishers_info_by_topic', lambda _, one=there: one)
        arm.node._report(arm.stamp)
    words = ('one publisher', 'one publisher', 'no publisher')
    texts = (f'{text}, and 1 of other joints' for text in words)
    assert told == list(zip((OK, OK, WARN), texts))


def test_given_a_driver_that_names_no_joints_at_first_when_it_does_then_they_are_observed():
    with node_of(UioNode, arm_file='paper') as node:
        arm = Arm(node)
        for _ in range(2):  # before any good measurement
            node._on_measurement(JointState())
        assert node._refusals.counts == {'measurement that does not fit the arm': 2}
        assert arm.recover() <= RECOVERY and arm.state.last.mode < int(Mode.STALE)


def test_given_other_joints_first_then_they_are_no_error_unless_the_arm_stays_away():
    with node_of(UioNode, arm_file='paper') as node:
        gripper = JointState(name=['finger'], position=[0.0])
        for reports, counts in ((0, {}), (1, {'measurement that does not fit the arm': 1})):
            node._silence_reports = reports
            node._on_measurement(gripper)
            assert node._refusals.counts == counts


@pytest.mark.parametrize('count', [40, 240])  # a driver's burst; during a decision of 0.48 s
def test_given_many_measurements_at_once_when_observed_then_each_is_answered(arm, count):
    arm.node.begin()
    publisher = arm.node.create_publisher(JointState, 'joint_states', 50)
    limit = time.monotonic() + 60.0
    while publisher.get_subscription_count() == 0:
        assert time.monotonic() < limit, 'no subscription'
        time.sleep(0.01)
    arm.outputs['state'].take()
    for _ in range(count):
        publisher.publish(arm.good())
    while len(arm.outputs['state'].sent) < count and time.monotonic() < limit:
        rclpy.spin_once(arm.node, timeout_sec=0.1)
    assert len(arm.outputs['state'].sent) == count


def test_given_an_arm_when_configured_then_faults_are_compiled_and_default_qos_hears(monkeypatch):
    warmed, kind = [], serial_monitor.SerialSensorMonitor
    monkeypatch.setattr(kind, 'warm_up_faults', lambda self: warmed.append(self))
    with node_of(UioNode, arm_file='paper') as node:
        assert warmed == [node._monitor], 'the first fault has nothing to compile'
        offered, asked = node._corrected_out.qos_profile, QoSProfile(depth=10)
        assert qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR


@pytest.mark.parametrize('compiled', [(), ('first', 'second')])
def test_given_kept_code_when_configured_then_no_compiling_is_told_of(monkeypatch, compiled):
    said = set()

    @contextmanager
    def on_compile(tell):
        for name in compiled:
            tell(name)
        yield

    monkeypatch.setattr(uio_node, 'on_compile', on_compile)
    logger = SimpleNamespace(info=lambda text, **options: said.add(text), warning=print)
    monkeypatch.setattr(UioNode, 'get_logger', lambda self: logger)
    with node_of(UioNode, arm_file='paper'):
        assert any('compiling' in text for text in said) == bool(compiled)


def alarm(event=AlarmEvent.RAISED, sensor='link2_angle', kind='bias'):
    return Alarm(event, 1, sensor, 0, 0, 0.3, 0.01, kind, 0.99)


def test_given_commands_when_the_arm_is_stopped_or_they_are_old_then_no_torque_is_known(arm):
    arm.node._from_command = True
    for safe_stop, known in ((False, True), (True, False)):
        arm.node._on_measurement(arm.good())
        command = TorqueCommand(torque=[1.0, -1.0], safe_stop=safe_stop)
        arm.node._on_command(arm.stamped(command))
        assert np.isfinite(arm.node._known_torque()).all() == known
    arm.node._on_command(arm.stamped(TorqueCommand(torque=[1.0, -1.0])))
    assert list(arm.node._known_torque()) == [1.0, -1.0]
    for _ in range(arm.node._recent.maxlen):
        arm.node._on_measurement(arm.good())
    assert np.isnan(arm.node._known_torque()).all(), 'of a tracker that is no more'


def test_given_a_driver_whose_clock_stands_then_the_diagnosis_is_stale(arm, monkeypatch):
    arm.recover()
    last = arm.good()
    for _ in range(3):
        arm.node._on_measurement(last)
    arm.node._check_silence()
    assert not arm.node._stale
    arm.node._received -= 10**9
    arm.node._on_measurement(last)
    arm.node._check_silence()
    assert arm.node._stale
    repeated = [arm.outputs[name].sent[-1].header.stamp for name in ('fault', 'diagnostics')]
    assert all(arm.stamp < to_nanoseconds(stamp) < arm.stamp + 10**10 for stamp in repeated)
    said = []
    monkeypatch.setattr(arm.node.get_logger(), 'warning', said.append)
    arm.node._silent_since = 0
    arm.node._check_silence()
    assert said and 'measurements with the stamp of the one before' in said[-1]


OLD, BACK, SLOW = (-3 * 10**9, 10 * STEP), (-10 * STEP, 10 * STEP), (2 * 10**9, 2 * 10**9)


@pytest.mark.parametrize(('step', 'interval'), [OLD, BACK, SLOW])
def test_given_stamps_that_fit_no_stream_then_it_is_said_why(monkeypatch, tmp_path, step, interval):
    """Stamps that run backwards, and those of a driver that is too slow; a replay says the same."""
    entries = []
    with node_of(UioNode, arm_file='paper') as node:
        said, now = [], 0
        logger = SimpleNamespace(warning=said.append, info=print, error=print)
        monkeypatch.setattr(node, 'get_logger', lambda: logger)
        monkeypatch.setattr(node, 'elapsed', lambda: now)
        take, arm = node._on_measurement, Arm(node)

        def hear(message):
            entries.append((TOPIC, now, serialize_message(message)))
            take(message)

        monkeypatch.setattr(node, '_on_measurement', hear)
        arm.stamp = 3000 * 10**9
        for _ in range(600):
            arm.stamp += step - STEP  # `good` adds one
            node._on_measurement(arm.good())
            now += interval
            if now % 10**8 == 0:
                node._check_silence()
        assert node._monitor.counters.refused_stamps > 100 and node._stale
        found = [array.status[0] for array in arm.outputs['diagnostics'].sent]
        level, text = found[-1].level, found[-1].message
        assert level == bytes([STALE]) and text.startswith(f'{UNUSABLE}: ')
        assert 'measurements whose stamp fits no stream' in text
        stale = [text for text in said if text.startswith('diagnosis is stale: ')]
        assert len(stale) == 1 and UNUSABLE in stale[0]
        # A driver whose stamps are those of a stream is observed again.
        assert arm.recover() <= RECOVERY and not node._stale
        bag = write_bag(tmp_path / 'bag', entries, {TOPIC: JOINT_STATE})
        monitor = serial_monitor.SerialSensorMonitor('/lpv/uio', node._arm)
        Replay(monitor, estimates_only=True).run(bag, tmp_path / 'out')
        messages = [m for topic, _, m in contents(tmp_path / 'out')[0] if topic == '/diagnostics']
        replayed = [deserialize_message(one, DiagnosticArray).status[0] for one in messages]
        told, again = ([(s.level, s.message.split(':')[0]) for s in x] for x in (found, replayed))
        assert told == again[: len(told)] and len(told) > 1


def test_given_gaps_when_observed_then_the_python_api_answers_the_same():
    with node_of(UioNode, bringup_file('gains', 'paper'), arm_file='paper') as node:
        arm, monitor = Arm(node), Monitor(node._arm, load_gains('paper'))
        updates = []
        for k in range(1200):
            arm.stamp += {300: 600_000_000, 600: 1_100_000_000, 900: 3_000_000_000}.get(k, 0)
            message = arm.good()
            node._on_measurement(message)
            fields = message.position, message.velocity, message.effort
            updates.append(monitor.update(arm.stamp, *fields))
        known = [update for update in updates if update is not None]
        assert [update.states for update in known].count(2 * (SensorState.STALE,)) == 4
        sent = arm.outputs['fault'].sent
        assert [to_nanoseconds(one.header.stamp) for one in sent] == [u.stamp for u in known]
        for told, update in zip(sent, known):
            assert [*told.estimate, *told.bound] == [*update.fault, *update.bound]
            assert [*told.state] == [int(one) for one in update.states]


def test_given_a_clock_that_stands_or_is_set_back_when_all_ends_then_it_is_stale(monkeypatch):
    with node_of(UioNode, arm_file='paper', use_sim_time='true') as node:
        said = []
        monkeypatch.setattr(node.get_logger(), 'warning', said.append)

        def is_stale(seconds):
            now = SimpleNamespace(nanoseconds=seconds * 10**9)
            monkeypatch.setattr(node, '_steady', SimpleNamespace(now=lambda: now))
            node._check_silence()
            return node._stale

        Arm(node).recover()
        assert [is_stale(seconds) for seconds in (1000, 0, 1)] == [False, False, True]
        said.clear()
        assert all(is_stale(seconds) for seconds in (0, 100, 0, 6))
        assert ['no new measurement' in text for text in said] == [True, True]


@pytest.mark.parametrize('is_heard_before', [True, False])
def test_given_a_long_silence_when_observed_then_the_log_tells_ever_more_seldom(
    monkeypatch, is_heard_before
):
    now, told, reports = 10**12, [], []
    driver = SimpleNamespace(node_namespace='/', node_name='driver')
    with node_of(UioNode, arm_file='paper') as node:
        logger = SimpleNamespace(
            warning=lambda text: told.append((now, text)), info=print, error=print
        )
        monkeypatch.setattr(node, 'get_logger', lambda: logger)
        monkeypatch.setattr(node, 'elapsed', lambda: now)
        monkeypatch.setattr(node, 'get_publishers_info_by_topic', lambda topic: [driver])
        monkeypatch.setattr(node._status, 'report', lambda *status: reports.append(status[1:3]))
        arm = Arm(node)
        if is_heard_before:
            arm.recover()
        told.clear()
        for _ in range(1000):
            node._check_silence()
            now += 10**8
        silent = [(time - 10**12) // 10**9 for time, text in told if 'no new' in text]
        assert [round(b / a) for a, b in zip(silent, silent[1:])] == [2] * 4, silent
        stale = [one for one in arm.outputs['diagnostics'].sent if one.status[0].level[0] == STALE]
        assert len(stale) == (20 if is_heard_before else 0)
        assert reports[0] == (OK, 'one publisher')
        assert reports[-1] == (WARN, 'one publisher; no new measurement that fits the arm')
        if is_heard_before:  # heard again, a silence is told of at once
            arm.recover()
            told.clear()
            for _ in range(100):
                node._check_silence()
                now += 10**8
            assert ['stale' in text for _, text in told] == [True, False]


def test_given_an_observer_that_died_with_an_alarm_when_restarted_then_it_says_so(arm, tmp_path):
    path = tmp_path / 'new' / 'alarms.json'
    died = OpenAlarms(path)
    for sensor in ('link1_angle', 'link2_angle'):
        died.note(alarm(sensor=sensor))
    died.note(alarm(AlarmEvent.CLEARED, 'link1_angle'))
    arm.node._alarms = OpenAlarms(path)
    arm.recover()
    assert not arm.state.last.trustworthy
    assert 'link2_angle: error +0.300 rad' in arm.node._untrusted_text()
    arm.node._log(alarm())  # found again
    arm.recover()
    assert arm.state.last.trustworthy and list(OpenAlarms(path).before) == ['link2_angle']
    arm.node.stopping()
    assert OpenAlarms(path).before == {}


@pytest.mark.parametrize('kind', ['dropout', 'rate_bias'])
def test_given_an_alarm_when_another_of_its_sensor_ends_then_it_stays_open(tmp_path, kind):
    path = tmp_path / 'alarms.json'
    OpenAlarms(path).note(alarm())
    restarted = OpenAlarms(path)
    for event in (AlarmEvent.RAISED, AlarmEvent.CLEARED):
        restarted.note(alarm(event, kind=kind))
        assert 'bias' in restarted.before['link2_angle']
    assert OpenAlarms(path).before == restarted.before


@pytest.mark.parametrize('content', ['', '[1]', '{', '[' * 100000, '\0', '{"a": 1}'])
def test_given_a_file_of_alarms_that_is_none_when_read_then_it_does_no_harm(tmp_path, content):
    path = tmp_path / 'alarms.json'
    path.write_text(content)
    assert set(OpenAlarms(path).before) <= {'a'}
    OpenAlarms(path).note(alarm())
    assert 'link2_angle' in OpenAlarms(path).before


def test_given_a_disk_that_takes_no_alarms_when_reset_then_the_observer_goes_on(arm, tmp_path):
    (tmp_path / 'file').touch()
    arm.node._alarms = OpenAlarms(tmp_path / 'file' / 'alarms.json')
    arm.node._log(alarm())
    assert arm.node._on_reset(None, SimpleNamespace()).success and not arm.node._alarms.before


STAMP = 3_000_000_007
ALARM = {'sensor': 'link2_angle', 'sensor_index': 1, 'event': 0, 'onset': 1_000_000_000,
         'detected': 2_500_000_000, 'size': 0.3, 'bound': 0.01, 'kind': 'bias',
         'confidence': 0.9}  # fmt: skip


def messages_of(joints):
    names = [f'j{i}' for i in range(joints)]
    arm = SimpleNamespace(name='some_arm', joint_names=names, sensor_names=names)
    return OutputMessages(arm, answers.answer_type(joints))


def test_given_numbers_that_are_nan_when_put_into_messages_then_they_are_not_trusted():
    messages, record = messages_of(3), np.zeros(1, answers.answer_type(3))
    state, fault = record['state'][0], record['fault'][0]
    state['position'], state['trustworthy'], fault['bound'] = 1.0, True, [0.1, 0.2, np.inf]
    assert messages.fill(record[0]) and messages.record == record
    fault['bound'][1] = fault['threshold'][1] = np.nan
    assert not messages.fill(record[0])
    sent, told = messages.record['fault'][0], messages.record['state'][0]
    assert sent['bound'].tolist() == [0.1, 0.2, np.inf] and sent['threshold'].tolist() == [0.0] * 3
    assert sent['state'].tolist() == [0, FaultEstimate.STALE, 0]
    assert told['mode'] == 0 and not told['trustworthy']
    state['position'][0] = np.inf
    assert not messages.fill(record[0])
    sent = deserialize_message(messages.state.at(STAMP), StateEstimate)
    assert (list(sent.position), sent.mode) == ([1.0] * 3, StateEstimate.STALE)
    messages = messages_of(2)
    unknown = {'kind': 'drift', 'size': np.nan, 'bound': np.nan}
    first, second = (
        deserialize_message(messages.alarm(STAMP, {**ALARM, **change}), FaultAlarm)
        for change in ({}, unknown)
    )
    assert (first.kind, first.size, first.bound) == ('bias', 0.3, 0.01)
    assert (second.kind, second.size, second.bound) == ('drift', 0.0, np.inf)


def test_given_a_running_node_when_tuned_then_its_log_says_so_and_not_what_is_refused(capfd):
    with node_of(UioNode, arm_file='paper') as node:
        refused = SetParametersResult(successful=False)
        node._on_set_parameters_callbacks.append(lambda _: refused)  # the last to be asked
        node.set_parameters([Parameter('diagnosis.sigmas', value=5.0)])
        assert node._monitor._monitor.settings.sigmas == 4.0
        node._on_set_parameters_callbacks.pop()
        for value in (5.0, 500.0):
            node.set_parameters([Parameter('diagnosis.sigmas', value=value)])
    said = capfd.readouterr().err
    assert said.count('diagnosis.sigmas is') == 1 and 'diagnosis.sigmas is 5.0 now' in said
