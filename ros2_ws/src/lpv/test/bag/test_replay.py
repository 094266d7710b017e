"""Replays of recorded bags: same answers as online, everything else untouched, damaged bags."""

import dataclasses
import math
import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from places import BRINGUP
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg
from serial_bags import crane_file, crane_run, record_crane

from lpv.bag.errors import BagError
from lpv.bag.replay.injected_faults import judge, true_size
from lpv.bag.replay.replay import Replay, ReplayResult
from lpv.bag.rosbag import reading
from lpv.bag.rosbag.interfaces import make_typestore
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.writing import BagWriter, qos_profile
from lpv.bag.run import decoder
from lpv.bag.run.record import load_run
from lpv.bag.run.streams import RecordedAlarm
from lpv.cli.main import main
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, Mode
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.faults import Fault, FaultInjector
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import NANOSECONDS

pytestmark = pytest.mark.slow

PAPER_ARM = str(BRINGUP / 'arms' / 'paper.yaml')
PAPER_GAINS = str(BRINGUP / 'gains' / 'paper.yaml')
TYPESTORE = make_typestore()
MESSAGES = BagMessages(TYPESTORE, 'paper')
STEP = 2_000_000
"""Sample time [ns]."""
JOINT_STATE, COMMAND = 'sensor_msgs/msg/JointState', 'lpv_msgs/msg/TorqueCommand'
STRING, DIAGNOSTICS = 'std_msgs/msg/String', 'diagnostic_msgs/msg/DiagnosticArray'
MEASURED = '/lpv/joint_states'
ANSWERS = {
    'state': ('/lpv/state_estimate', 'lpv_msgs/msg/StateEstimate'),
    'fault': ('/lpv/fault_estimate', 'lpv_msgs/msg/FaultEstimate'),
}
TYPES = {MEASURED: JOINT_STATE, '/lpv/torque_command': COMMAND, '/chatter': STRING,
         '/diagnostics': DIAGNOSTICS}  # fmt: skip
KINDS = ('mcap', 'db3', 'bag', 'txt')
BIAS = Fault('link1_angle', 'bias', onset=1.0, size=0.3)


def simulate(arm, gains, scenario):
    """Stamp, measurement and the command that answers it, of a simulated loop."""
    run = run_closed_loop(arm, scenario, gains)
    for time, *vectors, torque in zip(
        run.time, run.measured, run.measured_velocity, run.effort, run.command
    ):
        stamp = round(time * NANOSECONDS)
        yield stamp, MESSAGES.joint_state(stamp, arm.joint_names, *vectors), torque


@pytest.fixture(scope='module')
def loop(paper_arm, paper_gains, two_faults):
    """Measurements of 2 s with a fault of sensor 1 in the second half."""
    scenario = replace(two_faults, duration=2.0, faults=(BIAS,))
    return list(simulate(paper_arm, paper_gains, scenario))


@pytest.fixture(scope='module')
def healthy(paper_arm, paper_gains, two_faults):
    """Measurements of 1.5 s without faults."""
    return list(simulate(paper_arm, paper_gains, replace(two_faults, duration=1.5, faults=())))


def string(text):
    return TYPESTORE.types[STRING](text)


def status(stamp, name):
    entry = {'level': 0, 'name': name, 'message': 'fine', 'hardware_id': '', 'values': {'a': 'b'}}
    return BagMessages(TYPESTORE, '').diagnostics(stamp, [entry])


def measured(loop, topic=MEASURED, shift=0):
    """Entries of the measurements alone, with other stamps."""
    for stamp, m, _ in loop:
        vectors = m.position, m.velocity, m.effort
        yield topic, stamp + shift, MESSAGES.joint_state(stamp + shift, m.name, *vectors)


def entries_of(loop):
    """A recording with commands, chatter and the diagnostics of somebody else."""
    for k, (stamp, measurement, torque) in enumerate(loop):
        yield MEASURED, stamp, measurement
        command = {'torque': torque, 'safe_stop': False}
        yield '/lpv/torque_command', stamp, MESSAGES.make(COMMAND, stamp, command)
        if k % 100 == 0:
            yield '/chatter', stamp + 5, string(f'sample {k}')
            yield '/diagnostics', stamp + 7, status(stamp, f'/motor: axis {k}')


def write_bag(path, entries, types=None):
    """Write topic, time and message (or raw bytes) of each entry; types by topic."""
    with BagWriter(path, chunk_time=250_000_000) as writer:
        for topic, msgtype in (types or {MEASURED: JOINT_STATE}).items():
            writer.add_topic(topic, msgtype, [qos_profile(True, False, 10)])
        for topic, time, content in entries:
            write = writer.write_raw if isinstance(content, bytes) else writer.write
            write(topic, time, content)
    return path


def raw(bag, *topics):
    """Topic, log time and bytes of a bag's messages, of some topics or all."""
    with AnyReader([bag]) as reader:
        return [
            (c.topic, time, bytes(data))
            for c, time, data in reader.messages()
            if not topics or c.topic in topics
        ]


def read(bag, topic):
    with AnyReader([bag]) as reader:
        messages = reader.messages([c for c in reader.connections if c.topic == topic])
        return [reader.deserialize(data, c.msgtype) for c, _, data in messages]


@pytest.fixture(scope='module')
def bag(loop, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('recorded') / 'bag', entries_of(loop), TYPES)


@pytest.fixture(scope='module')
def new_monitor(paper_arm, paper_gains):
    return lambda: SerialSensorMonitor('/anything', paper_arm, gains=paper_gains)


@pytest.fixture
def monitor(new_monitor):
    return new_monitor()


@pytest.fixture
def replay(new_monitor, tmp_path):
    """Replays a bag with a new monitor; its result and output."""

    def run(source, faults=(), monitor=None, out='out', **options):
        monitor = monitor or new_monitor()
        names, rng = monitor.arm.sensor_names, np.random.default_rng(7)
        injector = FaultInjector(names, faults, rng) if faults else None
        result = Replay(monitor, injector=injector, **options).run(source, tmp_path / out)
        return result, tmp_path / out

    return run


@pytest.fixture(scope='module')
def replayed(bag, new_monitor, tmp_path_factory):
    """Result and output of a replay of the bag."""
    out, events = tmp_path_factory.mktemp('replayed') / 'bag', []
    result = Replay(new_monitor(), on_event=lambda event, _: events.append(event)).run(bag, out)
    assert events == result.events
    return result, out


# ------------------------------------------------------------------ what is copied


def test_given_topics_of_others_when_replayed_then_they_are_copied_byte_for_byte(bag, replayed):
    _, out = replayed
    for topic in ('/chatter', MEASURED, '/lpv/torque_command'):
        assert raw(out, topic) == raw(bag, topic)
    assert len(raw(out, '/chatter')) == 11
    with AnyReader([bag]) as before, AnyReader([out]) as after:
        for topic in before.topics:
            (one,), (two,) = (reader.topics[topic].connections for reader in (before, after))
            assert one[1:5] == two[1:5] and one.ext == two.ext  # up to definition and hash
        durability = [
            after.topics[f'/lpv/{name}'].connections[0].ext.offered_qos_profiles[0].durability.name
            for name in ('fault_alarm', 'fault_estimate')
        ]
    assert durability == ['TRANSIENT_LOCAL', 'VOLATILE']
    theirs = [entry for entry in raw(out, '/diagnostics') if b'/motor: ' in entry[2]]
    assert theirs == raw(bag, '/diagnostics')
    ours = [m for m in read(out, '/diagnostics') if not m.status[0].name.startswith('/motor: ')]
    assert len(ours) >= 2
    parts = ['/lpv/uio: observer', '/lpv/uio: link1_angle', '/lpv/uio: link2_angle']
    assert all([s.name for s in entry.status] == parts for entry in ours)


def test_given_a_type_that_nobody_knows_here_when_replayed_then_it_is_copied_with_its_definition(
    loop, replay, tmp_path
):
    odd = 'odd_msgs/msg/Note'
    with BagWriter(tmp_path / 'bag') as writer:
        writer.typestore.register(get_types_from_msg('string text\nint32 number', odd))
        writer.add_topic('/note', odd)
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write('/note', 3, writer.typestore.types[odd]('hello', 7))
        for stamp, sample, _ in loop[:20]:
            writer.write('/joint_states', stamp, sample)
    _, out = replay(tmp_path / 'bag')
    (note,) = read(out, '/note')
    assert (note.text, note.number) == ('hello', 7)
    assert load_run(out).counts == {
        **dict.fromkeys(('/joint_states', '/state_estimate', '/fault_estimate'), 20),
        **{'/joint_states_corrected': 20, '/fault_alarm': 0, '/diagnostics': 1, '/note': 1},
    }
    assert read(out, '/diagnostics')[0].status[0].name == '/uio: observer'


def test_given_recorded_answers_when_replayed_then_ours_are_replaced_and_those_of_others_kept(
    loop, replayed, replay, tmp_path
):
    result, out = replayed
    again, twice = replay(out, out='twice')
    assert raw(twice) == raw(out) and again.events == result.events
    nines = dict.fromkeys(('position', 'velocity', 'compensated_position'), [9.0, 9.0])
    nines |= dict.fromkeys(('measured_position', 'measured_velocity'), [9.0, 9.0])
    topic, msgtype = ANSWERS['state']
    entries = list(entries_of(loop))
    for stamp, _, _ in loop[::10]:
        lie = MESSAGES.make(msgtype, stamp, {**nines, 'mode': 0, 'trustworthy': True})
        entries.append((topic, stamp, lie))
    theirs = ['/other/uio: observer', '/lpv/uio2: observer']
    for stamp, name in enumerate(['/lpv/uio: observer', *theirs], 500):
        entries.append(('/diagnostics', stamp, status(stamp, name)))
    entries.sort(key=lambda entry: entry[1])
    _, new = replay(write_bag(tmp_path / 'lies', entries, {**TYPES, topic: msgtype}))
    topics = (*(topic for topic, _ in ANSWERS.values()), '/lpv/fault_alarm', '/chatter')
    assert raw(new, *topics) == raw(out, *topics)
    more = [e for e in raw(new, '/diagnostics') if any(n.encode() in e[2] for n in theirs)]
    assert len(more) == 2
    assert sorted(raw(new, '/diagnostics')) == sorted(raw(out, '/diagnostics') + more)


# ------------------------------------------------------------------ answers, whatever is read


def cdr(message, msgtype=JOINT_STATE, **order):
    data = bytes(TYPESTORE.serialize_cdr(message, msgtype, **order))
    return data + bytes(0 if order else -len(data) % 4)


def troubled(loop, seed=3):
    """Lost, doubled, swapped and late samples, other joints, other orders, spoiled values."""
    rng = np.random.default_rng(seed)
    messages, time = [], NANOSECONDS
    for _, _, message in measured(loop[:700], shift=NANOSECONDS):
        kind = rng.integers(24)
        if kind == 0:
            continue
        if kind == 1:
            message.name = message.name[::-1]
            for name in ('position', 'velocity', 'effort'):
                setattr(message, name, getattr(message, name)[::-1].copy())
        elif kind == 2:
            message.name = ['left', 'right']
        elif kind == 3:
            message.position = np.array([rng.choice([math.nan, math.inf, 1e300]), 0.0])
        elif kind == 4:
            message.effort = np.array([])
        elif kind == 5:
            message.velocity = np.array([0.1])
        elif kind == 6:
            message.header.frame_id = 'elsewhere'
        messages.append(cdr(message, **({'little_endian': False} if kind == 7 else {})))
        if kind == 8:
            messages.append(messages[-1])
        if kind == 9 and len(messages) > 5:
            messages[-1], messages[-4] = messages[-4], messages[-1]
    for data in messages:
        time += int(rng.integers(1, 9_000_000)) if rng.random() < 0.1 else STEP
        yield MEASURED, time, data


def by_rosbags(path, entries, plugin=StoragePlugin.MCAP):
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection(MEASURED, JOINT_STATE, typestore=TYPESTORE)
        for _, time, data in entries:
            writer.write(connection, time, data)
    return path


@pytest.fixture(scope='module')
def troubled_bag(loop, tmp_path_factory):
    return by_rosbags(tmp_path_factory.mktemp('troubled') / 'bag', troubled(loop))


@pytest.fixture(scope='module')
def expected(troubled_bag, new_monitor, tmp_path_factory):
    """The answers message by message, which are the node's (`test_uio_serial_arm`); the monitor."""
    out, monitor = tmp_path_factory.mktemp('expected') / 'bag', new_monitor()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, 'BLOCK_SIZE', 1)
        patch.setattr(decoder, '_MOST_ATTEMPTS', 0)
        Replay(monitor, estimates_only=True).run(troubled_bag, out)
    return raw(out), monitor


@pytest.mark.parametrize(
    ('size', 'attempts', 'layouts'), [(20_000, 32, 8), (2 << 20, 32, 8), (20_000, 32, 1)]
)
def test_given_a_troubled_recording_when_replayed_then_every_byte_is_that_of_single_messages(
    troubled_bag, expected, monitor, replay, monkeypatch, size, attempts, layouts
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    monkeypatch.setattr(decoder, 'MOST_LAYOUTS', layouts)
    answers, single = expected
    result, out = replay(troubled_bag, monitor=monitor, estimates_only=True)
    assert raw(out) == answers
    assert sum(result.rejected.values()) == monitor.rejected == single.rejected > 20
    assert any("'joint1'" in text and 'left' in text for text in result.rejected)
    assert any(topic == '/lpv/fault_alarm' for topic, _, _ in answers)
    counters = monitor.counters
    assert counters == single.counters
    few = counters.duplicates, counters.out_of_order, counters.not_finite, counters.without_effort
    assert min(few) > 0
    for name, (topic, _) in ANSWERS.items():
        for entry in read(out, topic):
            vectors = ('estimate', 'bound') if name == 'fault' else ('position', 'velocity')
            assert np.isfinite([getattr(entry, vector) for vector in vectors]).all()


def test_given_sqlite_or_copies_when_replayed_then_the_answers_are_the_same(
    loop, troubled_bag, expected, replay, tmp_path
):
    bag = by_rosbags(tmp_path / 'bag', troubled(loop), StoragePlugin.SQLITE3)
    _, out = replay(bag, preset='zstd_fast')
    assert [entry for entry in raw(out) if entry[0] != MEASURED] == expected[0]
    assert raw(out, MEASURED) == raw(troubled_bag)


def humble(bag, folder):
    """Without type hashes."""
    shutil.copytree(bag, folder / 'bag')
    metadata = folder / 'bag' / 'metadata.yaml'
    content = yaml.safe_load(metadata.read_text())
    for topic in content['rosbag2_bagfile_information']['topics_with_message_count']:
        del topic['topic_metadata']['type_description_hash']
    metadata.write_text(yaml.safe_dump(content))
    return folder / 'bag'


def alone(bag, folder):
    (storage,) = bag.glob('*.mcap')
    return Path(shutil.copy(storage, folder / 'alone.mcap'))


@pytest.mark.parametrize('make', [humble, alone])
def test_given_a_bag_without_hashes_or_a_single_file_when_replayed_then_the_answers_are_the_same(
    bag, replayed, replay, tmp_path, make
):
    assert raw(replay(make(bag, tmp_path))[1]) == raw(replayed[1])


def test_given_an_interval_when_replayed_then_nothing_outside_is_seen(bag, replay):
    result, out = replay(bag, start=0.4, end=0.6)
    assert result.measurements == 100
    for name in ('joint_states', 'state_estimate'):
        stamps = load_run(out).stamps[name]
        assert (stamps[0], stamps[-1]) == (400_000_000, 598_000_000)


# ------------------------------------------------------------------ where torques come from


def joint_efforts(stamp, torque):
    names, efforts = ['gripper', 'joint2', 'joint1'], [9.0, torque[1], torque[0]]
    return MESSAGES.joint_state(stamp, names, [], [], efforts)


def multi_array(stamp, torque):
    layout = TYPESTORE.types['std_msgs/msg/MultiArrayLayout']([], 0)
    return TYPESTORE.types['std_msgs/msg/Float64MultiArray'](layout, np.array(torque))


def point(stamp, torque):
    kind, zero = (TYPESTORE.types[name] for name in (
        'trajectory_msgs/msg/JointTrajectoryPoint', 'builtin_interfaces/msg/Duration'))  # fmt: skip
    return kind(*[np.array([])] * 3, np.array(torque), zero(0, 0))


def trajectory(stamp, torque):
    kind = TYPESTORE.types['trajectory_msgs/msg/JointTrajectory']
    return kind(MESSAGES.header(stamp), ['joint2', 'joint1'], [point(stamp, torque[::-1])])


SOURCES = {
    COMMAND: lambda stamp, torque: MESSAGES.make(
        COMMAND, stamp, {'torque': torque, 'safe_stop': False}
    ),
    JOINT_STATE: joint_efforts,
    'std_msgs/msg/Float64MultiArray': multi_array,
    'trajectory_msgs/msg/JointTrajectory': trajectory,
    'trajectory_msgs/msg/JointTrajectoryPoint': point,
}


@pytest.mark.parametrize(('attempts', 'msgtype'), [*((32, kind) for kind in SOURCES), (0, COMMAND)])
def test_given_torques_of_any_type_when_replayed_then_the_one_before_each_sample_is_used(
    loop, new_monitor, replay, tmp_path, monkeypatch, msgtype, attempts
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 20_000)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    twin, entries, expected, latest = new_monitor(), [], [], [math.nan] * 2
    topic = '/lpv/torque_command' if msgtype == COMMAND else '/torques'
    for k, (stamp, measurement, torque) in enumerate(loop[:600]):
        expected.append(twin.take(stamp, measurement, latest))
        entries.append((MEASURED, stamp, measurement))
        if k % 5 != 4:  # now and then a torque is lost, and the last one goes on
            message = SOURCES[msgtype](stamp, list(torque))
            data = cdr(message, msgtype, **({'little_endian': False} if k == 7 else {}))
            entries.append((topic, stamp + 1, data))
            latest = list(torque)
    bag = write_bag(tmp_path / 'bag', entries, {MEASURED: JOINT_STATE, topic: msgtype})
    chosen = {'torque_from_command': True} if msgtype == COMMAND else {'effort_topic': topic}
    _, out = replay(bag, topic=MEASURED, **chosen)
    fault = [a.fault['estimate'] for a in expected if a.fault is not None]
    assert len(fault) > 590
    found = [m.estimate for m in read(out, '/lpv/fault_estimate')]
    assert np.array_equal(found, fault)
    assert [m.mode for m in read(out, '/lpv/state_estimate')] == [a.state['mode'] for a in expected]
    assert expected[0].state['mode'] == Mode.HOLDING


def test_given_torques_that_cannot_be_used_when_replayed_then_they_are_counted_by_reason(
    loop, replay, tmp_path
):
    msgtype, entries = 'std_msgs/msg/Float64MultiArray', []
    for k, (stamp, measurement, torque) in enumerate(loop[:60]):
        entries.append((MEASURED, stamp, measurement))
        entries.append(('/torques', stamp, multi_array(stamp, torque if k % 3 else [1.0])))
    bag = write_bag(tmp_path / 'bag', entries, {MEASURED: JOINT_STATE, '/torques': msgtype})
    result, out = replay(bag, effort_topic='/torques')
    assert result.rejected == {f'{msgtype} has 1 torques for 2 joints': 20}
    assert len(raw(out, '/lpv/state_estimate')) == 60


# ------------------------------------------------------------------ faults that are added


def with_rates(arm, rates):
    """An arm whose rates come from another source."""
    joints = (replace(j, sensors=replace(j.sensors, rates=rates)) for j in arm.joints)
    return replace(arm, joints=tuple(joints))


@pytest.mark.parametrize(
    ('fault', 'rates'),
    [
        (Fault('link1_angle', 'bias', 1.0, size=0.3), 'independent'),
        (Fault('link2_angle', 'bias', 1.0, size=0.3), 'independent'),
        (Fault('link2_angle', 'drift', 0.5, 0.25, rate=0.4), 'derived'),
        (Fault('link2_angle', 'drift', 0.5, 0.25, rate=0.4), 'independent'),
        (Fault('link2_angle', 'rate_bias', 0.5, 0.25, size=0.2), 'independent'),
        (Fault('link2_angle', 'dropout', 0.5, 0.5), 'independent'),
    ],
    ids=lambda value: getattr(value, 'kind', value),
)
def test_given_a_fault_to_add_when_replayed_then_it_acts_as_on_the_arm_and_is_found(
    healthy, paper_arm, paper_gains, replay, tmp_path, fault, rates
):
    arm, epoch = with_rates(paper_arm, rates), 1_700_000_000 * NANOSECONDS
    source = write_bag(tmp_path / 'bag', measured(healthy, shift=epoch))
    monitor = SerialSensorMonitor('', arm, gains=paper_gains)
    result, out = replay(source, [fault], monitor)
    before, after = (load_run(place).streams['joint_states'] for place in (source, out))
    assert np.array_equal(before['effort'], after['effort'])
    sensor, time = arm.sensor_names.index(fault.sensor), np.arange(len(healthy)) * 0.002
    end = fault.onset + fault.duration if fault.duration else math.inf
    acts = (time >= fault.onset) & (time < end - 1e-9)
    kind = fault.kind
    grown = {'bias': 0.3, 'drift': 0.4 * (time - fault.onset), 'dropout': math.nan}.get(kind, 0.0)
    shift, rate = np.zeros((2, len(time), 2))
    shift[acts, sensor] = np.broadcast_to(grown, time.shape)[acts]
    if kind == 'rate_bias':
        rate[acts, sensor] = 0.2
    elif rates == 'derived':
        rate[:, sensor] = np.diff(shift[:, sensor], prepend=0.0) / arm.sample_time
    for name, expected in (('position', shift), ('velocity', rate)):
        # Angles of the links are sums of those of the joints.
        found = np.cumsum(after[name] - before[name], axis=1)
        np.testing.assert_allclose(found, expected, atol=2e-9)
    estimate = load_run(out).aligned('fault_estimate', 'estimate')
    assert np.isfinite(estimate[time > 0.1]).all()
    if kind == 'bias':
        (alarm,) = result.events
        assert (alarm.event, alarm.sensor, alarm.kind) == (AlarmEvent.RAISED, fault.sensor, 'bias')
        assert 0 <= alarm.onset - epoch - 1_000_000_000 <= STEP
        assert np.abs(estimate - shift)[time > 1.1].max() < 0.1


def test_given_faults_to_add_when_replayed_by_blocks_then_it_is_as_by_single_messages(
    troubled_bag, replay, monkeypatch
):
    faults = [
        Fault('link1_angle', 'noise', 0.1, 0.2, size=0.1),
        Fault('link2_angle', 'stuck', 0.5, 0.2),
        Fault('link2_angle', 'stuck', 0.9, 0.1),
        Fault('link2_angle', 'dropout', 1.1, 0.1),
        Fault('link1_angle', 'rate_bias', 0.55, 0.1, size=0.2),
    ]
    found = []
    for name, size, attempts in (('a', 2 << 20, 32), ('b', 1, 0)):
        monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
        monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
        found.append(raw(replay(troubled_bag, faults, out=name)[1]))
    assert found[0] == found[1]
    before = [data for *_, data in raw(troubled_bag)]
    after = [data for topic, _, data in found[0] if topic == MEASURED]
    assert len(after) == len(before)
    assert 200 < sum(a != b for a, b in zip(before, after)) < 400


START = 5_000_000_000


def event(time, sensor='a', kind=AlarmEvent.RAISED, size=0.28, name='bias'):
    stamp, place = START + round(time * 1e9), ('a', 'b').index(sensor)
    return RecordedAlarm(kind, place, sensor, stamp, stamp, size, 0.05, name, 1.0, stamp)


ONE, OTHER, SHORT = (Fault(sensor, 'bias', 1.0, duration, 0.3)
                     for sensor, duration in (('a', 0.0), ('b', 0.0), ('a', 1.0)))  # fmt: skip
LATER = event(2.0, kind=AlarmEvent.UPDATED, size=0.31, name='drift')


@pytest.mark.parametrize(
    ('faults', 'events', 'verdicts', 'error'),
    [
        ([ONE], [event(1.25), LATER], ['found'], 0.01),
        ([ONE], [], ['not found'], None),
        ([ONE], [event(1.5, 'b')], ['wrong sensor: b'], None),
        ([ONE], [event(1.2), event(1.5, 'b')], ['found, and wrongly b'], -0.02),
        ([ONE, OTHER], [event(1.2), event(1.5, 'b')], ['found', 'found'], -0.02),
        ([SHORT], [event(0.5)], ['not found'], None),
        ([SHORT], [event(3.5)], ['not found'], None),
        ([SHORT], [event(1.2), event(2.5, 'a', AlarmEvent.CLEARED, 0.0)], ['found'], -0.02),
    ],
)
def test_given_alarms_when_injected_faults_are_judged_then_each_has_its_verdict(
    faults, events, verdicts, error
):
    found = judge(faults, ReplayResult(first_stamp=START, events=events))
    assert [one.verdict for one in found] == verdicts
    assert found[0].error == (None if error is None else pytest.approx(error))
    if error == 0.01:
        assert (found[0].kind, found[0].delay) == ('drift', pytest.approx(0.25))
    drift = Fault('a', 'drift', 1.0, rate=-0.1)
    for one, size in (
        (drift, -0.2),
        (replace(drift, size=0.15), 0.15),
        (replace(drift, duration=1.0), -0.1),
        (replace(drift, kind='stuck'), None),
    ):
        assert true_size(one, 3.0) == (None if size is None else pytest.approx(size))


# ------------------------------------------------------------------ bags that cannot be replayed


def test_given_two_arms_when_replayed_then_both_topics_are_named_and_one_may_be_chosen(
    loop, replay, tmp_path
):
    topics = ('/a/joint_states', '/b/joint_states')
    entries = [(topic, stamp, m) for stamp, m, _ in loop[:20] for topic in topics]
    source = write_bag(tmp_path / 'bag', entries, dict.fromkeys(topics, JOINT_STATE))
    for options, told in (
        ({}, '/a/joint_states, /b/joint_states'),
        ({'topic': '/c/joint_states'}, "'/c/joint_states'.* it has /a/joint_states"),
        ({'topic': topics[1], 'torque_from_command': True}, "no topic '/b/torque_command'"),
        ({'topic': topics[1], 'start': 100.0}, 'bag: holds no message on /b/joint_states in'),
    ):
        with pytest.raises(BagError, match=told):
            replay(source, **options)
        assert not (tmp_path / 'out').exists()
    assert replay(source, topic='/b/joint_states')[0].measurements == 20
    counts = load_run(tmp_path / 'out', namespace='/b').counts
    assert counts['/b/state_estimate'] == counts['/a/joint_states'] == 20
    assert '/a/state_estimate' not in counts


def test_given_topics_of_any_name_when_one_is_called_joint_states_then_it_is_preferred(
    loop, replay, tmp_path
):
    types = {MEASURED: JOINT_STATE, '/lpv/joint_targets': JOINT_STATE}
    source = write_bag(tmp_path / 'bag', measured(loop[:20]), types)
    assert replay(source)[0].measurements == 20
    nothing = write_bag(tmp_path / 'b', [('/chatter', 1, string('hello'))], {'/chatter': STRING})
    with pytest.raises(BagError, match=r'JointState; it has /chatter \(std_msgs/msg/String\)'):
        replay(nothing, out='none')


@pytest.mark.parametrize(
    'name', ['missing', 'missing.mcap', 'empty', 'no_storage', *(f'text.{kind}' for kind in KINDS)]
)
def test_given_a_bag_that_cannot_be_read_when_replayed_then_the_error_names_it(
    bag, replay, tmp_path, name
):
    place = tmp_path / name
    if name.startswith('text'):
        place.write_text('this is no bag\n')
    elif not name.startswith('missing'):
        place.mkdir()
    if name == 'no_storage':
        shutil.copy(bag / 'metadata.yaml', place)
    with pytest.raises(BagError, match=name) as caught:
        replay(place)
    assert str(caught.value).startswith(str(place))
    assert not (tmp_path / 'out').exists()


def test_given_a_damaged_message_when_replayed_then_the_error_names_the_bag_and_nothing_is_left(
    loop, replay, tmp_path
):
    entries = [(MEASURED, stamp, cdr(m)) for stamp, m, _ in loop[:50]]
    content = bytearray(entries[30][2])
    struct.pack_into('<I', content, 12, 10**6)
    entries[30] = (*entries[30][:2], bytes(content))
    bag = write_bag(tmp_path / 'bag', entries)
    with pytest.raises(BagError, match='bag: cannot be read'):
        replay(bag)
    assert not (tmp_path / 'out').exists()
    (tmp_path / 'out').mkdir()
    with pytest.raises(ConfigError, match='exists'):
        replay(bag)
    assert list((tmp_path / 'out').iterdir()) == []


# ------------------------------------------------------------------ command line


@pytest.fixture
def command(tmp_path):
    """Arguments of a replay that needs nothing installed."""
    usual = {'arm': PAPER_ARM, 'gains': PAPER_GAINS, 'out': tmp_path / 'result'}

    def arguments(bag, **changes):
        options = {**usual, **changes}.items()
        return ['replay', str(bag), *(str(p) for name, v in options for p in (f'--{name}', v))]

    return arguments


def test_given_the_command_when_run_twice_then_bag_and_report_are_those_of_the_second_run(
    bag, replayed, command, tmp_path, capsys
):
    assert main(command(bag)) == 0
    said = capsys.readouterr().out
    assert '1001 measurements' in said
    raised = next(e for e in replayed[0].events if e.event == AlarmEvent.RAISED)
    (line,) = [line for line in said.splitlines() if ' ALARM, link1_angle' in line]
    at = float(re.search(r'(\d+\.\d{3}) s\b', line)[1])
    assert at == pytest.approx((raised.stamp - replayed[0].first_stamp) / NANOSECONDS, abs=6e-4)
    assert raw(tmp_path / 'result') == raw(replayed[1])
    (tmp_path / 'report').mkdir()
    (tmp_path / 'report' / 'path.png').write_bytes(b'old')
    assert main(command(bag, report=tmp_path / 'report')) == 0
    assert (tmp_path / 'report' / 'path.png').read_bytes().startswith(b'\x89PNG')
    assert (tmp_path / 'report' / 'report.html').is_file()
    assert raw(tmp_path / 'result') == raw(replayed[1])


def test_given_a_file_of_faults_when_the_command_is_run_then_they_are_added(
    healthy, command, tmp_path, capsys
):
    source = write_bag(tmp_path / 'bag', entries_of(healthy), TYPES)
    faults = tmp_path / 'faults.yaml'
    faults.write_text('faults:\n  - {sensor: link2_angle, kind: bias, onset: 1.0, size: -0.3}\n')
    assert main(command(source, inject=faults)) == 0
    said = capsys.readouterr().out
    assert 'ALARM, link2_angle: error -0.' in said and 'size error' in said
    assert '1 of 1 injected faults found on the right sensor' in said
    assert re.search(r'link2_angle, bias from 1.000 s on: found after 0.\d+ s as \w+, -0.\d+', said)


def test_given_other_joint_names_when_the_command_is_run_then_it_says_so_and_fails(
    healthy, command, tmp_path, refused
):
    renamed = [
        (topic, time, dataclasses.replace(content, name=['left', 'right']))
        for topic, time, content in measured(healthy)
    ]
    source = command(write_bag(tmp_path / 'bag', renamed))
    for told in ('none of its', 'measurements can be used', 'left'):
        assert refused(told, *source)
    assert not (tmp_path / 'result').exists()


@pytest.mark.parametrize(
    ('changes', 'named'),
    [
        ({'bag': 'nothing'}, 'nothing'),
        ({'arm': 'unknown_arm'}, ''),
        ({'arm': 'nothing.yaml'}, ''),
        ({'gains': 'nothing.yaml'}, 'nothing.yaml'),
        ({'gains': PAPER_ARM}, 'paper.yaml'),
        ({'arm': BRINGUP / 'arms' / 'real_arm.yaml'}, 'arm'),
        ({'topic': '/nowhere'}, '/nowhere'),
        ({'inject': 'nothing.yaml'}, 'nothing.yaml'),
        ({'faults': 'faults.yaml'}, 'nose'),
        ({'effort-topic': '/nowhere'}, '/lpv/torque_command'),
        ({'effort-topic': '/chatter'}, 'std_msgs/msg/String'),
        ({'from': -1}, 'start'),
        ({'from': 2, 'to': 1}, 'end'),
        ({'from': 'nan'}, 'start'),
        ({'to': 'inf'}, 'end'),
        ({'parameters': 'nothing.yaml'}, 'nothing.yaml'),
        ({'parameters': PAPER_ARM}, 'paper.yaml'),
        ({'parameters': 'tuned.yaml'}, 'clear_dwell'),
        ({'out': 'somewhere'}, 'somewhere exists already'),
        ({'out': 'tuned.yaml'}, 'exists already'),
    ],
    ids=str,
)
def test_given_bad_input_when_the_command_is_run_then_one_line_says_so_and_the_code_is_2(
    bag, command, tmp_path, monkeypatch, refused, changes, named
):
    monkeypatch.chdir(tmp_path)
    fault = '{sensor: nose, kind: bias, onset: 1.0, size: 1.0}'
    (tmp_path / 'faults.yaml').write_text(f'faults: [{fault}]\n')
    (tmp_path / 'tuned.yaml').write_text('/**: {ros__parameters: {diagnosis: {clear_dwell: soon}}}')
    (tmp_path / 'somewhere').mkdir()
    (tmp_path / 'somewhere' / 'precious.txt').write_text('mine')
    changes = dict(changes)
    assert refused(named, *command(changes.pop('bag', bag), **changes))
    assert not (tmp_path / 'result').exists()
    assert (tmp_path / 'somewhere' / 'precious.txt').read_text() == 'mine'


def test_given_its_own_output_when_the_command_shall_replay_it_then_it_refuses(
    replayed, command, tmp_path, refused
):
    own = tmp_path / 'result' / 'bag'
    shutil.copytree(replayed[1], own)
    for out, told in (
        (own.parent, 'would overwrite'),
        (own, 'would overwrite'),
        (own / 'x', 'is inside'),
    ):
        assert refused(told, *command(own, out=out))
    assert raw(own) == raw(replayed[1])


def test_given_a_bag_with_its_gains_when_the_command_is_run_then_neither_arm_nor_gains_are_needed(
    bag, replayed, tmp_path, capsys, refused
):
    shutil.copytree(bag, tmp_path / 'bag')
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path / 'result')]
    assert refused('--arm: is needed where neither gains nor the bag name an arm', *arguments)
    shutil.copy(PAPER_GAINS, tmp_path / 'bag' / 'gains.yaml')
    assert main(arguments) == 0
    assert "arm 'paper' and gains as in the bag" in capsys.readouterr().out
    assert raw(tmp_path / 'result') == raw(replayed[1])
    assert refused("'x' is neither a file nor", *arguments, '--arm', 'real_arm', '--gains', 'x')
    assert main([*arguments, '--gains', 'paper']) == 0


def test_given_gains_for_a_serial_arm_when_replayed_then_they_are_refused(tmp_path, refused):
    bag, arm = record_crane(tmp_path / 'bag', crane_run()), str(crane_file(tmp_path))
    arguments = ['replay', str(bag), '--arm', arm, '--out', str(tmp_path / 'out')]
    assert refused('', *arguments, '--gains', 'paper.yaml')
    told = 'lpv: is missing: gains are designed for its region'
    assert refused(told, *arguments, '--requirement', 'paper')
    assert main(arguments) == 0
    assert not (tmp_path / 'out' / 'gains.yaml').exists()
