"""Replays by blocks: whatever the bag is like, the answers are those of single messages."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag import reading
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run import decoder
from lpv_bag.run.record import BagError, load_run
from lpv_core.control.tracking import TrackingController
from lpv_core.monitoring.message_fields import alarm_fields
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.faults import Fault, FaultInjector
from lpv_core.support.errors import SampleError
from lpv_core.support.timestamps import NANOSECONDS

TYPESTORE = make_typestore()
JOINT_STATE = 'sensor_msgs/msg/JointState'
COMMAND = 'lpv_msgs/msg/TorqueCommand'
MESSAGES = BagMessages(TYPESTORE, 'paper')
ANSWERS = ('/lpv/state_estimate', '/lpv/fault_estimate', '/lpv/fault_alarm')


@pytest.fixture(scope='module')
def samples(paper_arm, paper_gains, two_faults):
    """Stamp, position, velocity, effort and next torque of 1.2 s with a fault in the end."""
    fault = Fault('link1_angle', 'bias', onset=0.8, size=0.3)
    scenario = replace(two_faults, duration=1.2, faults=(fault,))
    plant, controller = (
        ArmSimulator(paper_arm, scenario),
        TrackingController(paper_arm, paper_gains),
    )
    path, rows = scenario.path(paper_arm), []
    for k in range(600):
        sense, truth = plant.sense()
        torque = controller.update(
            path.sample(plant.time),
            truth.position,
            truth.velocity,
            truth.position,
            paper_arm.sample_time,
        ).torque
        rows.append(
            (
                NANOSECONDS + 2_000_000 * k,
                np.array(sense.position),
                np.array(sense.velocity),
                np.array(sense.effort),
                np.array(torque),
            )
        )
        plant.step(torque)
    return rows


@pytest.fixture
def monitor(paper_arm, paper_gains):
    return SerialSensorMonitor('/lpv/uio', paper_arm, gains=paper_gains)


def measurement(sample, names=('joint1', 'joint2'), order=(0, 1)):
    stamp, *vectors = sample[:4]
    return MESSAGES.joint_state(
        stamp, [names[i] for i in order], *([v[i] for i in order] for v in vectors)
    )


def cdr(message, msgtype=JOINT_STATE):
    data = bytes(TYPESTORE.serialize_cdr(message, msgtype))
    return data + bytes(-len(data) % 4)


def big_endian(message, msgtype=JOINT_STATE):
    return bytes(TYPESTORE.serialize_cdr(message, msgtype, little_endian=False))


def write(path, entries, types, plugin=StoragePlugin.MCAP):
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=TYPESTORE)
            for topic, msgtype in types.items()
        }
        for topic, time, data in entries:
            writer.write(connections[topic], time, data)
    return path


def raw(bag, topics=None):
    with AnyReader([bag]) as reader:
        return [
            (c.topic, time, bytes(data))
            for c, time, data in reader.messages()
            if topics is None or c.topic in topics
        ]


def troubled(samples, seed=3):
    """Lost, doubled, swapped and late samples, other joints, other orders, spoiled values."""
    rng = np.random.default_rng(seed)
    messages, time = [], NANOSECONDS
    for sample in samples:
        kind = rng.integers(24)
        if kind == 0:
            continue
        message = measurement(sample)
        if kind == 1:
            message = measurement(sample, order=(1, 0))
        elif kind == 2:
            message = measurement(sample, names=('left', 'right'))
        elif kind == 3:
            message.position = np.array([math.nan, 0.0])
        elif kind == 4:
            message.effort = np.array([])
        elif kind == 5:
            message.velocity = np.array([0.1])
        elif kind == 6:
            message.header.frame_id = 'elsewhere'
        messages.append(big_endian(message) if kind == 7 else cdr(message))
        if kind == 8:
            messages.append(messages[-1])
        if kind == 9 and len(messages) > 5:
            messages[-1], messages[-4] = messages[-4], messages[-1]
    for data in messages:
        time += int(rng.integers(1, 9_000_000)) if rng.random() < 0.1 else 2_000_000
        yield '/lpv/joint_states', time, data


@pytest.fixture(scope='module')
def troubled_bag(samples, tmp_path_factory):
    return write(
        tmp_path_factory.mktemp('troubled') / 'bag',
        troubled(samples),
        {'/lpv/joint_states': JOINT_STATE},
    )


def _named(fields):
    return {'names': fields['name'], **{k: fields[k] for k in ('position', 'velocity')}}


def expected_answers(bag, monitor, out):
    """The answers message by message, written by the plain writer."""
    messages = BagMessages(TYPESTORE, monitor.arm.name)
    parts = (
        ('state', '/lpv/state_estimate', 'lpv_msgs/msg/StateEstimate'),
        ('fault', '/lpv/fault_estimate', 'lpv_msgs/msg/FaultEstimate'),
    )
    with AnyReader([bag]) as reader, BagWriter(out) as writer:
        for _, topic, msgtype in parts:
            writer.add_topic(topic, msgtype)
        writer.add_topic('/lpv/joint_states_corrected', JOINT_STATE)
        writer.add_topic('/lpv/fault_alarm', 'lpv_msgs/msg/FaultAlarm')
        writer.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        for c, time, data in reader.messages():
            message = reader.deserialize(data, c.msgtype)
            stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
            try:
                answer = monitor.take(stamp, message)
            except SampleError:
                continue
            if answer is None:
                continue
            for name, topic, msgtype in parts:
                fields = getattr(answer, name)
                if fields is not None:
                    writer.write(topic, time, messages.make(msgtype, stamp, fields))
            if answer.corrected is not None:
                corrected = messages.joint_state(stamp, effort=[], **_named(answer.corrected))
                writer.write('/lpv/joint_states_corrected', time, corrected)
            for event in answer.events:
                writer.write(
                    '/lpv/fault_alarm',
                    time,
                    messages.make('lpv_msgs/msg/FaultAlarm', stamp, alarm_fields(event)),
                )
            if answer.status is not None:
                writer.write('/diagnostics', time, messages.diagnostics(stamp, answer.status))
    return raw(out)


@pytest.mark.parametrize('size', [1, 20_000, 2 << 20])
@pytest.mark.parametrize('fast', [True, False])
def test_given_a_troubled_recording_when_replayed_then_every_byte_is_that_of_single_messages(
    troubled_bag, paper_arm, paper_gains, monitor, tmp_path, monkeypatch, fast, size
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 32 * fast)
    expected = expected_answers(
        troubled_bag,
        SerialSensorMonitor('/lpv/uio', paper_arm, gains=paper_gains),
        tmp_path / 'expected',
    )
    result = Replay(monitor, estimates_only=True).run(troubled_bag, tmp_path / 'out')
    assert raw(tmp_path / 'out') == expected
    assert sum(result.rejected.values()) == monitor.rejected > 20
    assert any(topic == '/lpv/fault_alarm' for topic, _, _ in expected)
    counters = monitor.counters
    assert min(counters.duplicates, counters.out_of_order, counters.not_finite) > 0
    assert counters.without_effort > 0


def test_given_more_shapes_than_are_remembered_when_replayed_then_answers_are_the_same(
    troubled_bag, paper_arm, paper_gains, monitor, tmp_path, monkeypatch
):
    Replay(SerialSensorMonitor('', paper_arm, gains=paper_gains)).run(
        troubled_bag, tmp_path / 'many'
    )
    monkeypatch.setattr(decoder, 'MOST_LAYOUTS', 1)
    Replay(monitor).run(troubled_bag, tmp_path / 'one')
    assert raw(tmp_path / 'one') == raw(tmp_path / 'many')


def test_given_a_sqlite3_bag_when_replayed_then_answers_are_those_of_mcap(
    samples, troubled_bag, paper_arm, paper_gains, monitor, tmp_path
):
    bag = write(
        tmp_path / 'bag',
        troubled(samples),
        {'/lpv/joint_states': JOINT_STATE},
        StoragePlugin.SQLITE3,
    )
    Replay(monitor).run(bag, tmp_path / 'a')
    Replay(SerialSensorMonitor('', paper_arm, gains=paper_gains)).run(troubled_bag, tmp_path / 'b')
    assert raw(tmp_path / 'a') == raw(tmp_path / 'b')


def test_given_faults_to_add_when_replayed_by_blocks_then_it_is_as_by_single_messages(
    troubled_bag, paper_arm, paper_gains, tmp_path, monkeypatch
):
    faults = [
        Fault('link1_angle', 'noise', 0.1, 0.2, size=0.1),
        Fault('link2_angle', 'stuck', 0.5, 0.2),
        Fault('link2_angle', 'stuck', 0.9, 0.1),
        Fault('link2_angle', 'dropout', 1.1),
        Fault('link1_angle', 'rate_bias', 0.55, 0.1, size=0.2),
    ]
    found = []
    for name, size, fast in (('a', 2 << 20, True), ('b', 1, False)):
        monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
        monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 32 * fast)
        injector = FaultInjector(paper_arm.sensor_names, faults, np.random.default_rng(7))
        Replay(SerialSensorMonitor('', paper_arm, gains=paper_gains), injector=injector).run(
            troubled_bag, tmp_path / name
        )
        found.append(raw(tmp_path / name))
    assert found[0] == found[1]
    before = [d for *_, d in raw(troubled_bag)]
    after = [d for topic, _, d in found[0] if topic == '/lpv/joint_states']
    assert len(after) == len(before)
    assert 200 < sum(a != b for a, b in zip(before, after)) < 400


def with_rates(arm, rates):
    """An arm whose rates come from another source."""
    sensors = (replace(joint.sensors, rates=rates) for joint in arm.joints)
    joints = (replace(joint, sensors=one) for joint, one in zip(arm.joints, sensors))
    return replace(arm, joints=tuple(joints))


@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_drift_when_added_then_rates_differ_by_its_slope_where_they_are_derived(
    samples, paper_arm, paper_gains, tmp_path, rates
):
    entries = [('/lpv/joint_states', s[0], cdr(measurement(s))) for s in samples]
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE})
    fault = Fault('link2_angle', 'drift', 0.5, 0.25, rate=0.4)
    injector = FaultInjector(paper_arm.sensor_names, [fault], np.random.default_rng(0))
    monitor = SerialSensorMonitor('', with_rates(paper_arm, rates), gains=paper_gains)
    Replay(monitor, injector=injector).run(bag, tmp_path / 'out')
    before, after = (
        load_run(place, joint_names=paper_arm.joint_names).streams['joint_states']
        for place in (bag, tmp_path / 'out')
    )
    shift = np.cumsum(after['position'] - before['position'], axis=1)[:, 1]
    rate = np.cumsum(after['velocity'] - before['velocity'], axis=1)[:, 1]
    derived = np.diff(shift, prepend=0.0) / paper_arm.sample_time
    assert shift[374] == pytest.approx(0.1, abs=1e-3)
    np.testing.assert_allclose(rate, derived if rates == 'derived' else 0.0, atol=1e-9)


def test_given_a_fault_of_a_rate_when_added_then_rates_differ_by_it_and_nothing_else_does(
    samples, paper_arm, monitor, tmp_path
):
    entries = [('/lpv/joint_states', s[0], cdr(measurement(s))) for s in samples]
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE})
    fault = Fault('link2_angle', 'rate_bias', 0.5, 0.25, size=0.2)
    injector = FaultInjector(paper_arm.sensor_names, [fault], np.random.default_rng(0))
    Replay(monitor, injector=injector).run(bag, tmp_path / 'out')
    streams = [
        load_run(place, joint_names=paper_arm.joint_names).streams['joint_states']
        for place in (bag, tmp_path / 'out')
    ]
    np.testing.assert_allclose(streams[1]['position'], streams[0]['position'], atol=1e-12)
    assert np.array_equal(streams[1]['effort'], streams[0]['effort'])
    rate = np.cumsum(streams[1]['velocity'] - streams[0]['velocity'], axis=1)
    expected = np.zeros((600, 2))
    expected[250:375, 1] = 0.2
    np.testing.assert_allclose(rate, expected, atol=1e-12)


def test_given_estimates_only_when_replayed_then_the_answers_are_the_same_and_alone(
    troubled_bag, paper_arm, paper_gains, tmp_path
):
    for name, only in (('all', False), ('only', True)):
        Replay(
            SerialSensorMonitor('', paper_arm, gains=paper_gains),
            estimates_only=only,
            preset='zstd_fast',
        ).run(troubled_bag, tmp_path / name)
    with_copies, alone = raw(tmp_path / 'all'), raw(tmp_path / 'only')
    assert [e for e in with_copies if e[0] != '/lpv/joint_states'] == alone
    assert [e for e in with_copies if e[0] == '/lpv/joint_states'] == raw(troubled_bag)


def test_given_an_interval_when_replayed_then_nothing_outside_is_seen(samples, monitor, tmp_path):
    entries = [('/lpv/joint_states', s[0], cdr(measurement(s))) for s in samples]
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE})
    result = Replay(monitor, start=0.4, end=0.6).run(bag, tmp_path / 'out')
    assert result.measurements == 100
    stamps = load_run(tmp_path / 'out').stamps
    for name in ('joint_states', 'state_estimate'):
        assert stamps[name][0] == 1_400_000_000
        assert stamps[name][-1] == 1_598_000_000
    with pytest.raises(BagError, match='bag: holds no message on /lpv/joint_states in'):
        Replay(monitor, start=100.0).run(bag, tmp_path / 'none')
    assert not (tmp_path / 'none').exists()


# ------------------------------------------------------------------ where torques come from


def command(stamp, torque):
    return MESSAGES.make(COMMAND, stamp, {'torque': torque, 'safe_stop': False})


def joint_efforts(stamp, torque):
    return MESSAGES.joint_state(
        stamp, ['gripper', 'joint2', 'joint1'], [], [], [9.0, torque[1], torque[0]]
    )


def multi_array(stamp, torque):
    types = TYPESTORE.types
    return types['std_msgs/msg/Float64MultiArray'](
        types['std_msgs/msg/MultiArrayLayout']([], 0), np.array(torque)
    )


def trajectory(stamp, torque):
    types, none = TYPESTORE.types, np.array([])
    point = types['trajectory_msgs/msg/JointTrajectoryPoint'](
        none,
        none,
        none,
        np.array([torque[1], torque[0]]),
        types['builtin_interfaces/msg/Duration'](0, 0),
    )
    return types['trajectory_msgs/msg/JointTrajectory'](
        MESSAGES.header(stamp), ['joint2', 'joint1'], [point]
    )


def point(stamp, torque):
    return trajectory(stamp, torque[::-1]).points[0]


SOURCES = {
    COMMAND: command,
    JOINT_STATE: joint_efforts,
    'std_msgs/msg/Float64MultiArray': multi_array,
    'trajectory_msgs/msg/JointTrajectory': trajectory,
    'trajectory_msgs/msg/JointTrajectoryPoint': point,
}


@pytest.mark.parametrize('msgtype', SOURCES)
@pytest.mark.parametrize('fast', [True, False])
def test_given_torques_of_any_type_when_replayed_then_the_one_before_each_sample_is_used(
    samples, paper_arm, paper_gains, monitor, tmp_path, monkeypatch, msgtype, fast
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 20_000)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 32 * fast)
    entries, twin, latest, expected = (
        [],
        SerialSensorMonitor('', paper_arm, gains=paper_gains),
        None,
        [],
    )
    for k, sample in enumerate(samples):
        expected.append(twin.take(sample[0], measurement(sample), latest or [math.nan] * 2))
        entries.append(('/lpv/joint_states', sample[0], cdr(measurement(sample))))
        if k % 5 != 4:  # now and then a torque is lost, and the last one goes on
            message = SOURCES[msgtype](sample[0], sample[4])
            data = big_endian(message, msgtype) if k == 7 else cdr(message, msgtype)
            entries.append(('/torques', sample[0] + 1, data))
            latest = list(sample[4])
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE, '/torques': msgtype})
    Replay(monitor, topic='/lpv/joint_states', effort_topic='/torques').run(bag, tmp_path / 'out')
    record = load_run(tmp_path / 'out', namespace='/lpv')
    fault = [a.fault['estimate'] for a in expected if a.fault is not None]
    assert len(fault) > 590
    assert np.array_equal(record.get('fault_estimate', 'estimate'), fault)


def test_given_torques_that_cannot_be_used_when_replayed_then_they_are_counted_by_reason(
    samples, monitor, tmp_path
):
    msgtype = 'std_msgs/msg/Float64MultiArray'
    entries = []
    for k, s in enumerate(samples[:60]):
        entries.append(('/lpv/joint_states', s[0], cdr(measurement(s))))
        entries.append(
            ('/torques', s[0], cdr(multi_array(s[0], s[4] if k % 3 else [1.0]), msgtype))
        )
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE, '/torques': msgtype})
    result = Replay(monitor, effort_topic='/torques').run(bag, tmp_path / 'out')
    assert result.rejected == {f'{msgtype} has 1 torques for 2 joints': 20}
    assert len(raw(tmp_path / 'out', ['/lpv/state_estimate'])) == 60


def test_given_a_damaged_message_when_replayed_then_the_error_names_the_bag_and_nothing_is_left(
    samples, monitor, tmp_path
):
    entries = [('/lpv/joint_states', s[0], cdr(measurement(s))) for s in samples[:50]]
    content = bytearray(entries[30][2])
    struct.pack_into('<I', content, 12, 10**6)
    entries[30] = (*entries[30][:2], bytes(content))
    bag = write(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE})
    with pytest.raises(BagError, match='bag: cannot be read'):
        Replay(monitor).run(bag, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
