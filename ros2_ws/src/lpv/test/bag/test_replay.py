import errno
import math
import os
import re
import shutil
import struct
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bag_messages import CHATTER, JOINT_STATE, STEP, STRING, TYPESTORE, cdr, text
from bags import contents, decoded, storage, write_bag, write_by_rosbags, write_measurements
from fault_injection import with_joints, with_sensors
from places import BRINGUP
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import get_types_from_msg
from serial_bags import crane_file, crane_run, record_crane

from lpv import AlarmEvent, ConfigError, Fault, load_arm
from lpv.bag.errors import BagError
from lpv.bag.replay.replay import Replay, ReplayResult, judge
from lpv.bag.rosbag import reading, writing
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.output_folder import replaced
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.run import decoder
from lpv.bag.run.record import STREAMS, RecordedAlarm, load_run
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.faults import FaultInjector
from lpv.core.support.timestamps import NANOSECONDS

pytestmark = pytest.mark.slow

PAPER_ARM, PAPER_GAINS = (f'{BRINGUP}/{kind}/paper.yaml' for kind in ('arms', 'gains'))
MESSAGES = BagMessages(TYPESTORE, 'paper')
HEALTHY, START = 500, 5_000_000_000
"""Samples of the loop before its fault; a first stamp."""
MEASURED, TORQUE, DIAGNOSTICS = '/lpv/joint_states', '/lpv/torque_command', '/diagnostics'
STATE, FAULT, ALARM = '/lpv/state_estimate', '/lpv/fault_estimate', '/lpv/fault_alarm'
COMMAND = 'lpv_msgs/msg/TorqueCommand'
ARRAY, TRAJECTORY = 'std_msgs/msg/Float64MultiArray', 'trajectory_msgs/msg/JointTrajectory'
POINT = f'{TRAJECTORY}Point'
SOURCES = [(32, kind, 1.0) for kind in (COMMAND, JOINT_STATE, ARRAY, TRAJECTORY, POINT)]
SOURCES.append((0, COMMAND, -16.0))
TYPES = {MEASURED: JOINT_STATE, TORQUE: COMMAND, CHATTER: STRING,
         DIAGNOSTICS: 'diagnostic_msgs/msg/DiagnosticArray'}  # fmt: skip


@pytest.fixture(scope='module')
def loop(paper_arm, paper_gains, two_faults):
    """Stamp, measurement and the command that answers it, of 2 s of a simulated loop; with a fault
    of sensor 1 in the second half."""
    faults = (Fault('link1_angle', 'bias', onset=1.0, size=0.3),)
    run = run_closed_loop(paper_arm, replace(two_faults, duration=2.0, faults=faults), paper_gains)
    stamps, names = (NANOSECONDS * run.time).round().astype(int).tolist(), paper_arm.joint_names
    samples = zip(stamps, run.measured, run.measured_velocity, run.effort, run.command)
    return [(t, MESSAGES.joint_state(t, names, *vectors), u) for t, *vectors, u in samples]


def status(stamp, name):
    entry = {'level': 0, 'name': name, 'message': 'fine', 'hardware_id': '', 'values': {'a': 'b'}}
    return BagMessages(TYPESTORE, '').diagnostics(stamp, [entry])


def measured(loop, shift=0, **changes):
    for stamp, m, _ in loop:
        message = MESSAGES.joint_state(stamp + shift, m.name, m.position, m.velocity, m.effort)
        yield MEASURED, stamp + shift, replace(message, **changes)


def entries_of(loop):
    """A recording with commands, chatter and the diagnostics of somebody else."""
    for k, (stamp, measurement, torque) in enumerate(loop):
        yield MEASURED, stamp, measurement
        yield TORQUE, stamp, message_of(COMMAND, stamp, torque)
        if k % 100 == 0:
            yield CHATTER, stamp + 5, text(f'sample {k}')
            yield DIAGNOSTICS, stamp + 7, status(stamp, f'/motor: axis {k}')


def write(path, entries, types=None):
    """A bag of entries; of measurements alone, unless types are given by topic."""
    return write_bag(path, entries, types or {MEASURED: JOINT_STATE}, chunk_time=250_000_000)


def raw(bag, *topics):
    """Topic, log time and bytes of a bag's messages, of some topics or all."""
    return [entry for entry in contents(bag)[0] if not topics or entry[0] in topics]


@pytest.fixture(scope='module')
def bag(loop, tmp_path_factory):
    return write(tmp_path_factory.mktemp('recorded') / 'bag', entries_of(loop), TYPES)


@pytest.fixture(scope='module')
def new_monitor(paper_arm, paper_gains):
    return lambda: SerialSensorMonitor('/anything', paper_arm, gains=paper_gains)


@pytest.fixture
def replay(new_monitor, tmp_path):
    def run(source, faults=(), monitor=None, out='out', **options):
        monitor = monitor or new_monitor()
        names, rng = monitor.arm.sensor_names, np.random.default_rng(7)
        injector = FaultInjector(names, faults, rng) if faults else None
        result = Replay(monitor, injector=injector, **options).run(source, tmp_path / out)
        return result, tmp_path / out

    return run


@pytest.fixture(scope='module')
def replayed(bag, new_monitor, tmp_path_factory):
    out, events = tmp_path_factory.mktemp('replayed') / 'bag', []
    result = Replay(new_monitor(), on_event=lambda event, _: events.append(event)).run(bag, out)
    assert events == result.events
    return result, out


def test_given_topics_of_others_when_replayed_then_they_are_copied_byte_for_byte(bag, replayed):
    _, out = replayed
    for topic, count in ((CHATTER, 11), (MEASURED, 1001), (TORQUE, 1001)):
        assert raw(out, topic) == raw(bag, topic) and len(raw(bag, topic)) == count
    with AnyReader([bag]) as before, AnyReader([out]) as after:
        for topic in before.topics:
            (one,), (two,) = (reader.topics[topic].connections for reader in (before, after))
            assert one[1:5] == two[1:5] and one.ext == two.ext  # up to definition and hash
        profiles = [after.topics[t].connections[0].ext.offered_qos_profiles for t in (ALARM, FAULT)]
    assert [p[0].durability.name for p in profiles] == ['TRANSIENT_LOCAL', 'VOLATILE']
    assert [e for e in raw(out, DIAGNOSTICS) if b'/motor: ' in e[2]] == raw(bag, DIAGNOSTICS)
    ours = [m for m in decoded(out, DIAGNOSTICS) if not m.status[0].name.startswith('/motor: ')]
    assert len(ours) >= 2
    parts = ['/lpv/uio: observer', '/lpv/uio: link1_angle', '/lpv/uio: link2_angle']
    assert all([s.name for s in entry.status] == parts for entry in ours)


def test_given_an_unknown_type_when_replayed_then_its_definition_is_copied(loop, replay, tmp_path):
    odd = 'odd_msgs/msg/Note'
    with writing.BagWriter(tmp_path / 'bag') as writer:
        writer.typestore.register(get_types_from_msg('string text\nint32 number', odd))
        writer.add_topic('/note', odd)
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write('/note', 3, writer.typestore.types[odd]('hello', 7))
        for stamp, sample, _ in loop[:20]:
            writer.write('/joint_states', stamp, sample)
    _, out = replay(tmp_path / 'bag')
    assert [(note.text, note.number) for note in decoded(out, '/note')] == [('hello', 7)]
    once = {'/joint_states_corrected': 20, '/fault_alarm': 0, '/diagnostics': 1, '/note': 1}
    often = ('/joint_states', '/state_estimate', '/fault_estimate')
    assert load_run(out).counts == {**dict.fromkeys(often, 20), **once}
    assert decoded(out, DIAGNOSTICS)[0].status[0].name == '/uio: observer'


def test_given_answers_when_replayed_then_only_ours_are_replaced(loop, replayed, replay, tmp_path):
    result, out = replayed
    again, twice = replay(out, out='twice')
    assert raw(twice) == raw(out) and again.events == result.events
    vectors = dict.fromkeys(STREAMS['state_estimate'][1], [9.0, 9.0])
    nines = {**vectors, 'mode': 0, 'trustworthy': True}
    msgtype, entries = 'lpv_msgs/msg/StateEstimate', list(entries_of(loop))
    entries += [(STATE, stamp, MESSAGES.make(msgtype, stamp, nines)) for stamp, *_ in loop[::10]]
    theirs = ['/other/uio: observer', '/lpv/uio2: observer']
    for stamp, name in enumerate(['/lpv/uio: observer', *theirs], 500):
        entries.append((DIAGNOSTICS, stamp, status(stamp, name)))
    entries.sort(key=lambda entry: entry[1])
    _, new = replay(write(tmp_path / 'lies', entries, {**TYPES, STATE: msgtype}))
    topics = (STATE, FAULT, ALARM, CHATTER)
    assert raw(new, *topics) == raw(out, *topics)
    more = [e for e in raw(new, DIAGNOSTICS) if any(n.encode() in e[2] for n in theirs)]
    assert len(more) == 2 and sorted(raw(new, DIAGNOSTICS)) == sorted(raw(out, DIAGNOSTICS) + more)


def test_given_a_driver_elsewhere_when_replayed_then_old_answers_go(loop, replay, tmp_path, call):
    def types(bag):
        with open_bag(bag) as reader:
            return {c.topic: c.msgtype for c in reader.connections}

    entries = [('/joint_states', *rest) for _, *rest in measured(loop[:HEALTHY])]
    _, first = replay(write(tmp_path / 'driver', entries, {'/joint_states': JOINT_STATE}))
    known = types(first)
    moved = {t: f'/lpv{t}' if known[t].startswith('lpv_msgs') else t for t in known}
    recorded = [(moved[topic], *rest) for topic, *rest in raw(first)]
    bag = write(tmp_path / 'recorded', recorded, {moved[t]: kind for t, kind in known.items()})
    _, again = replay(bag, out='again')
    assert raw(again, STATE, FAULT, ALARM) == raw(bag, STATE, FAULT, ALARM)
    assert {t for t, kind in types(again).items() if 'lpv_msgs' in kind} == {STATE, FAULT, ALARM}
    assert len(load_run(again, '/joint_states').stamps['state_estimate']) == HEALTHY
    compare = ['compare', bag, again, '--exact', '--arm', PAPER_ARM]
    assert call(*compare, '--topic', '/joint_states').out.endswith('same\n')


def test_given_no_efforts_when_replayed_then_the_node_warning_is_told(loop, tmp_path, replay, call):
    bag = write(tmp_path / 'bag', measured(loop[:HEALTHY], effort=np.zeros(0)))
    ((at, text),) = replay(bag)[0].notes
    assert at == 0.0 and text.startswith('no efforts: ')
    assert f'warning at 0.000 s: {text}' in call(*line(bag, tmp_path / 'result')).out


def troubled(loop):
    """Lost, doubled, swapped and late samples, other joints, other orders, spoiled values; at first
    no joints are named."""
    rng, time = np.random.default_rng(3), NANOSECONDS
    empty = dict.fromkeys(('position', 'velocity', 'effort'), np.zeros(0))
    messages = [cdr(m) for _, _, m in measured(loop[:3], NANOSECONDS - 3 * STEP, name=[], **empty)]
    for _, _, message in measured(loop[:700], shift=NANOSECONDS):
        kind = int(rng.integers(24))
        if kind == 0:
            continue
        vectors = {name: getattr(message, name) for name in ('position', 'velocity', 'effort')}
        odd = {
            1: {'name': message.name[::-1], **{n: v[::-1].copy() for n, v in vectors.items()}},
            2: {'name': ['left', 'right']},
            3: {'position': np.array([rng.choice([math.nan, math.inf, 1e300]), 0.0])},
            4: {'effort': np.array([])},
            5: {'velocity': np.array([0.1])},
            6: {'header': replace(message.header, frame_id='elsewhere')},
        }
        data = cdr(replace(message, **odd.get(kind, {})), little_endian=kind != 7)
        messages += [data] * (2 if kind == 8 else 1)
        if kind == 9 and len(messages) > 5:
            messages[-1], messages[-4] = messages[-4], messages[-1]
    for data in messages:
        time += int(rng.integers(1, 9_000_000)) if rng.random() < 0.1 else STEP
        yield MEASURED, time, data


@pytest.fixture(scope='module')
def troubled_bag(loop, tmp_path_factory):
    place = tmp_path_factory.mktemp('troubled') / 'bag'
    return write_by_rosbags(place, troubled(loop), StoragePlugin.MCAP)


@pytest.fixture(scope='module')
def expected(troubled_bag, new_monitor, tmp_path_factory):
    """The answers message by message, which are the node's (`test_uio_node`); the monitor."""
    out, monitor = tmp_path_factory.mktemp('expected') / 'bag', new_monitor()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading, 'BLOCK_SIZE', 1)
        patch.setattr(decoder, '_MOST_ATTEMPTS', 0)
        Replay(monitor, estimates_only=True).run(troubled_bag, out)
    return raw(out), monitor


@pytest.mark.parametrize('size, layouts', [(20_000, 8), (2 << 20, 8), (20_000, 1)])
def test_given_a_troubled_recording_when_replayed_then_every_byte_is_that_of_single_messages(
    troubled_bag, expected, new_monitor, replay, monkeypatch, size, layouts
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
    monkeypatch.setattr(decoder, 'MOST_LAYOUTS', layouts)
    (answers, single), monitor = expected, new_monitor()
    result, out = replay(troubled_bag, monitor=monitor, estimates_only=True)
    assert raw(out) == answers
    assert sum(result.rejected.values()) == monitor.rejected == single.rejected > 20
    assert any("'joint1'" in text and 'left' in text for text in result.rejected)
    assert ALARM in {topic for topic, _, _ in answers}
    counters = monitor.counters
    assert counters == single.counters
    few = counters.duplicates, counters.out_of_order, counters.not_finite, counters.without_effort
    assert min(few) > 0
    for topic, *vectors in ((FAULT, 'estimate', 'bound'), (STATE, 'position', 'velocity')):
        messages = decoded(out, topic)
        assert np.isfinite([[getattr(m, name) for name in vectors] for m in messages]).all()


def test_given_other_storage_or_an_interval_when_replayed_then_answers_are_the_same_or_in_it(
    loop, bag, replayed, troubled_bag, expected, replay, tmp_path
):
    _, out = replay(write_by_rosbags(tmp_path / 'bag', troubled(loop)), preset='zstd_fast')
    assert [entry for entry in raw(out) if entry[0] != MEASURED] == expected[0]
    assert raw(out, MEASURED) == raw(troubled_bag)
    alone = shutil.copy(storage(bag), tmp_path / 'alone.mcap')
    metadata = shutil.copytree(bag, tmp_path / 'humble') / 'metadata.yaml'
    said, count = re.subn(r'\n *type_description_hash: .*', '', metadata.read_text())
    metadata.write_text(said)
    assert count == len(TYPES)
    for source in (alone, metadata.parent):
        assert raw(replay(source, out=f'of_{source.name}')[1]) == raw(replayed[1])
    result, out = replay(bag, start=0.4, end=0.6, out='part')
    assert result.measurements == 100
    for name in ('joint_states', 'state_estimate'):
        assert load_run(out).stamps[name][[0, -1]].tolist() == [400_000_000, 598_000_000]


def message_of(msgtype, stamp, torque):
    """Torques as a message of any type; where joints are named, in disorder."""
    types, names = TYPESTORE.types, ['gripper', 'joint2', 'joint1']
    if msgtype == COMMAND:
        return MESSAGES.make(COMMAND, stamp, {'torque': torque, 'safe_stop': False})
    if msgtype == JOINT_STATE:
        return MESSAGES.joint_state(stamp, names, [], [], [9.0, *torque[::-1]])
    if msgtype == ARRAY:
        return types[ARRAY](types['std_msgs/msg/MultiArrayLayout']([], 0), np.array(torque))
    if msgtype == POINT:
        zero = types['builtin_interfaces/msg/Duration'](0, 0)
        return types[POINT](*[np.array([])] * 3, np.array(torque), zero)
    points = [message_of(POINT, stamp, torque[::-1])]
    return types[TRAJECTORY](MESSAGES.header(stamp), names[1:], points)


@pytest.mark.parametrize('attempts, msgtype, gain', SOURCES)
def test_given_torques_of_any_type_when_replayed_then_the_one_before_each_sample_is_used(
    loop, paper_arm, paper_gains, replay, tmp_path, monkeypatch, msgtype, attempts, gain
):
    """Commands are in newton metres, torques on other topics in the unit of efforts."""
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 20_000)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    arms = paper_arm, *[with_joints(paper_arm, torque_gain=gain)] * 2
    twin, other, monitor = (SerialSensorMonitor('', arm, gains=paper_gains) for arm in arms)
    entries, expected, latest = [], [], [math.nan] * 2
    topic = TORQUE if msgtype == COMMAND else '/torques'
    for k, (stamp, measurement, torque) in enumerate(loop[:600]):
        expected.append(twin.take(stamp, measurement, latest))
        assert other.take(stamp, measurement, latest).record == expected[-1].record
        entries.append((MEASURED, stamp, measurement))
        if k % 5 != 4:  # now and then one is lost or of no use, and the last one goes on
            latest = list(torque)
            data = cdr(message_of(msgtype, stamp, latest), msgtype, little_endian=k != 7)
            entries.append((topic, stamp + 1, data))
        elif msgtype == ARRAY:
            entries.append((topic, stamp + 1, cdr(message_of(ARRAY, stamp, [1.0]), ARRAY)))
    bag = write(tmp_path / 'bag', entries, {MEASURED: JOINT_STATE, topic: msgtype})
    chosen = {'torque_from_command': True} if msgtype == COMMAND else {'effort_topic': topic}
    result, out = replay(bag, monitor=monitor, topic=MEASURED, **chosen)
    useless = {f'{ARRAY} has 1 torques for 2 joints': 120} if msgtype == ARRAY else {}
    assert result.rejected == useless
    fault = [a.record['fault']['estimate'] for a in expected if a.record['has_fault']]
    assert len(fault) > 590 and np.array_equal([m.estimate for m in decoded(out, FAULT)], fault)
    assert [m.mode for m in decoded(out, STATE)] == [a.record['state']['mode'] for a in expected]
    assert expected[0].record['state']['mode'] == Mode.HOLDING


DRIFT = Fault('link2_angle', 'drift', 0.2, 0.2, rate=0.4)
RATE_BIAS = Fault('link2_angle', 'rate_bias', 0.2, 0.2, size=0.2)
BIASES = [Fault(sensor, 'bias', 0.2, size=0.3) for sensor in ('link1_angle', 'link2_angle')]
DROPOUT = Fault('link2_angle', 'dropout', 0.2, 0.2)
ADDED = [(DRIFT, 'derived'), *((f, 'independent') for f in (*BIASES, DRIFT, RATE_BIAS, DROPOUT))]


@pytest.mark.parametrize('fault, rates', ADDED, ids=lambda value: getattr(value, 'kind', value))
def test_given_a_fault_to_add_when_replayed_then_it_acts_as_on_the_arm_and_is_found(
    loop, paper_arm, paper_gains, replay, tmp_path, fault, rates
):
    arm, epoch = with_sensors(paper_arm, rates=rates), 1_700_000_000 * NANOSECONDS
    source = write(tmp_path / 'bag', measured(loop[:HEALTHY], shift=epoch))
    result, out = replay(source, [fault], SerialSensorMonitor('', arm, gains=paper_gains))
    before, after = (load_run(place).streams['joint_states'] for place in (source, out))
    assert np.array_equal(before['effort'], after['effort'])
    sensor, time = arm.sensor_names.index(fault.sensor), np.arange(HEALTHY) * 0.002
    acts, kind = (time >= 0.2) & ((time < 0.4 - 1e-9) | (fault.duration == 0.0)), fault.kind
    grown = {'bias': 0.3, 'drift': 0.4 * (time - 0.2), 'dropout': math.nan}.get(kind, 0.0)
    shift, rate = np.zeros((2, len(time), 2))
    shift[:, sensor] = np.where(acts, grown, 0.0)
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
        assert 0 <= alarm.onset - epoch - 200_000_000 <= STEP
        assert np.abs(estimate - shift)[time > 0.3].max() < 0.1


def test_given_a_fault_soon_after_another_when_added_then_derived_rates_show_it_as_large(
    loop, paper_arm, replay, tmp_path
):
    arm = with_sensors(paper_arm, rates='derived')
    faults = [
        Fault('link1_angle', 'bias', *times, size=0.3) for times in ((0.2, 0.099), (0.35, 0.0))
    ]
    source = write(tmp_path / 'bag', measured(loop[:HEALTHY]))
    _, out = replay(source, faults, SerialSensorMonitor('', arm))
    before, after = (load_run(place).streams['joint_states']['velocity'] for place in (source, out))
    time = np.arange(HEALTHY) * 0.002
    shift = 0.3 * ((time >= 0.2) & ((time < 0.299) | (time >= 0.35)))
    expected = np.diff(shift, prepend=0.0) / arm.sample_time
    np.testing.assert_allclose((after - before)[:, 0], expected, atol=2e-9)


def test_given_faults_when_replayed_by_blocks_then_as_one_by_one(troubled_bag, replay, monkeypatch):
    found, numbers = [], {'noise': (0.1, 0.2, 0.1), 'rate_bias': (0.55, 0.1, 0.2)}
    faults = [Fault('link1_angle', kind, *those) for kind, those in numbers.items()]
    for kind, *times in (('stuck', 0.5, 0.2), ('stuck', 0.9, 0.1), ('dropout', 1.1, 0.1)):
        faults.append(Fault('link2_angle', kind, *times))
    for name, size, attempts in (('a', 2 << 20, 32), ('b', 1, 0)):
        monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
        monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
        found.append(raw(replay(troubled_bag, faults, out=name)[1]))
    assert found[0] == found[1]
    after = [entry for entry in found[0] if entry[0] == MEASURED]
    changed = [a[2] != b[2] for a, b in zip(raw(troubled_bag), after, strict=True)]
    assert 200 < sum(changed) < 400


def event(time, sensor='a', kind=AlarmEvent.RAISED, size=0.28, name='bias', began=None):
    stamp, place = START + round(time * 1e9), ('a', 'b').index(sensor)
    onset = stamp if began is None else START + round(began * 1e9)
    return RecordedAlarm(kind, place, sensor, onset, stamp, size, 0.05, name, 1.0, stamp)


ONE, OTHER, SHORT = (Fault(sensor, 'bias', 1.0, duration, 0.3)
                     for sensor, duration in (('a', 0.0), ('b', 0.0), ('a', 1.0)))  # fmt: skip
LATER = event(2.0, kind=AlarmEvent.UPDATED, size=0.31, name='drift')
CLEARED = event(2.5, kind=AlarmEvent.CLEARED, size=0.0)
BOTH = [event(1.2), event(1.5, 'b')]
BACK = event(2.01, size=-0.3)  # the reading is right again
RATE = Fault('a', 'rate_bias', 1.0, size=0.3)
LONG = [event(2.3, size=-0.2, name='drift', began=1.0)]
GROWN = (0.0, 0.0, -0.07), (0.0, 0.1, -0.1), (0.0, -0.1, -0.1), (1.0, 0.0, -0.1)


@pytest.mark.parametrize('faults, events, verdicts, known', [
    ([ONE], [event(1.25), LATER], ['found'], ('drift', 0.25, 0.01)),
    ([ONE], [], ['not found'], ('', None, None)),
    ([ONE], [event(1.5, 'b')], ['wrong sensor: b'], ('', None, None)),
    ([ONE], BOTH, ['found'], ('bias', 0.2, -0.02)),
    ([ONE, OTHER], BOTH, ['found', 'found'], ('bias', 0.2, -0.02)),
    ([SHORT], [event(0.5)], ['not found'], ('', None, None)),
    ([SHORT], [event(3.5)], ['not found'], ('', None, None)),
    ([SHORT], [BACK], ['not found'], ('', None, None)),
    ([SHORT], [event(2.3, began=1.0)], ['found'], ('bias', 1.3, -0.02)),
    ([SHORT], [event(1.2), BACK], ['found'], ('bias', 0.2, -0.02)),
    ([RATE], [event(1.5, name='rate_bias')], ['found'], ('rate_bias', 0.5, -0.02)),
    ([ONE], [event(1.5, name='rate_bias')], ['found'], ('rate_bias', 0.5, None)),
    ([SHORT], [event(1.2), CLEARED], ['found'], ('bias', 0.2, -0.02)),
    ([replace(ONE, kind='stuck')], LONG, ['found'], ('drift', 1.3, None)),
    *(([replace(ONE, kind='drift', rate=-0.1, duration=duration, size=size)], LONG, ['found'],
       ('drift', 1.3, error)) for duration, size, error in GROWN),
])  # fmt: skip
def test_given_alarms_when_judged_then_each_fault_has_its_verdict(faults, events, verdicts, known):
    found = judge(faults, ReplayResult(first_stamp=START, events=events))
    assert [one.verdict for one in found] == verdicts
    alone = faults == [ONE] and any(one.sensor == 'b' for one in events)
    assert found[0].wrong_sensors == (('b',) if alone else ())
    kind = found[0].last.kind if found[0].last else ''
    assert (kind, found[0].delay, found[0].error) == pytest.approx(known)


def test_given_topics_when_replayed_then_the_right_one_or_nothing_is_left(loop, replay, tmp_path):
    topics = ('/a/joint_states', '/b/joint_states')
    entries = [(topic, stamp, m) for stamp, m, _ in loop[:20] for topic in topics]
    two_arms = write(tmp_path / 'bag', entries, dict.fromkeys(topics, JOINT_STATE))
    nothing = write(tmp_path / 'b', [(CHATTER, 1, text('hello'))], {CHATTER: STRING})
    entries = [(topic, time, cdr(m)) for topic, time, m in measured(loop[:50])]
    content = bytearray(entries[30][2])
    struct.pack_into('<I', content, 12, 10**6)
    entries[30] = (*entries[30][:2], bytes(content))
    damaged = write(tmp_path / 'damaged', entries)
    others = write(tmp_path / 'others', measured(loop[:50], name=['left', 'right']))
    (topic, _, first), *_ = measured(loop[:1])
    stopped = write(tmp_path / 'stopped', [(topic, k, first) for k in range(1, 9)])
    in_ms = write(tmp_path / 'in_ms', [
        (topic, time, MESSAGES.joint_state(1000 * time, m.name, m.position, m.velocity, m.effort))
        for topic, time, m in measured(loop[:50])
    ])  # fmt: skip
    for source, options, told in (
        (nothing, {}, r'JointState; it has /chatter \(std_msgs/msg/String\)'),
        (two_arms, {}, 'carry the joints .*: /a/joint_states, /b/joint_states'),
        (two_arms, {'topic': '/c/joint_states'}, "'/c/joint_states'.* it has /a/joint_states"),
        (two_arms, {'topic': topics[1], 'torque_from_command': True}, "no topic '/b/torque_c"),
        (two_arms, {'topic': topics[1], 'start': 100.0}, 'bag: holds no message on /b/joint_s'),
        (damaged, {}, 'damaged: cannot be read'),
        (others, {}, 'others: none of its 50 measurements can be used .*of other joints: .*left'),
        (stopped, {}, 'stopped: no measurement on .* is newer than the first one'),
        (in_ms, {}, 'in_ms: no measurement can be used: 49 measurements whose stamp fits no'),
    ):
        pytest.raises(BagError, replay, source, **options).match(told)
        assert not (tmp_path / 'out').exists()
    pytest.raises(BagError, load_run, damaged).match('damaged: cannot be read')
    assert replay(two_arms, topic='/b/joint_states')[0].measurements == 20
    counts = load_run(tmp_path / 'out', '/b/joint_states').counts
    assert counts['/b/state_estimate'] == counts['/a/joint_states'] == 20
    assert '/a/state_estimate' not in counts
    targets = {MEASURED: JOINT_STATE, '/lpv/joint_targets': JOINT_STATE}
    one_arm = write(tmp_path / 'one', measured(loop[:20]), targets)
    assert replay(one_arm, out='one_out')[0].topic == MEASURED
    (tmp_path / 'empty').mkdir()
    pytest.raises(ConfigError, replay, damaged, out='empty').match('exists')
    assert list((tmp_path / 'empty').iterdir()) == []


def line(bag, out, **changes):
    """Arguments of a replay that needs nothing installed."""
    options = {'arm': PAPER_ARM, 'gains': PAPER_GAINS, 'out': out, **changes}.items()
    return ['replay', bag, *(part for name, value in options for part in (f'--{name}', value))]


def test_given_a_command_when_run_again_then_the_last_holds(bag, replayed, tmp_path, call, refused):
    said, (result, answers) = call(*line(bag, tmp_path / 'result')).out, replayed
    assert '1001 measurements' in said
    raised = next(e for e in result.events if e.event == AlarmEvent.RAISED)
    (at,) = re.findall(r'(\d+\.\d{3}) s: .*ALARM, link1_angle', said)
    after = (raised.stamp - result.first_stamp) / NANOSECONDS
    assert float(at) == pytest.approx(after, abs=6e-4)
    assert raw(tmp_path / 'result') == raw(answers)
    # Neither arm nor gains are needed for a bag with its gains.
    bag, report = shutil.copytree(bag, tmp_path / 'bag'), tmp_path / 'report'
    again = ['replay', bag, '--out', tmp_path / 'result']
    assert refused('--arm: is needed: neither gains nor answers', *again)
    shutil.copy(PAPER_GAINS, bag / 'gains.yaml')
    report.mkdir()
    (report / 'path.png').write_bytes(b'old')
    assert "arm 'paper' and gains as in the bag" in call(*again, '--report', report).out
    assert (report / 'path.png').read_bytes().startswith(b'\x89PNG')
    assert (report / 'report.html').is_file() and raw(tmp_path / 'result') == raw(answers)
    assert refused("'x' is neither a file nor", *again, '--arm', 'real_arm', '--gains', 'x')
    forged = tmp_path / 'forged.yaml'
    forged.write_text(Path(PAPER_GAINS).read_text().replace('kappa: [', 'kappa: [1'))
    assert refused('numbers are those of the design', *again, '--gains', forged)
    both = tmp_path / 'both'
    assert refused('--report: must be another', *line(bag, both, report=both)) and not both.exists()
    for told, *wrong in (('--to', '--from', 5, '--to', 2), ("'/nowhere'", '--topic', '/nowhere')):
        # The last result stays.
        assert refused(told, *again, *wrong) and raw(tmp_path / 'result') == raw(answers)
    assert refused('--loop: is for a bag that is played', *again, '--loop')
    for option, value in (('--out', 'x'), ('--preset', 'none'), ('--torque-source', 'command')):
        told = f'{option}: has no effect on --publish'
        assert refused(told, 'replay', bag, '--publish', option, value)
    assert refused('no such bag', 'replay', tmp_path / 'typo', *line(bag, tmp_path / 'result')[2:])
    assert sorted(p.name for p in tmp_path.iterdir() if p.name[0] == '.') == []
    call(*again, '--gains', 'paper')


def test_given_a_file_of_faults_when_run_then_they_are_added(loop, tmp_path, call):
    part, truth = loop[:HEALTHY], ('/lpv/ground_truth', 'lpv_msgs/msg/GroundTruth')
    fields = dict.fromkeys(('position', 'velocity', 'torque', 'fault'), [0.0, 0.0])
    known = [(truth[0], stamp, MESSAGES.make(truth[1], stamp, {**fields, 'disturbance': 0.0}))
             for stamp, *_ in part]  # fmt: skip
    entries = sorted([*entries_of(part), *known], key=lambda entry: entry[1])
    source = write(tmp_path / 'bag', entries, {**TYPES, truth[0]: truth[1]})
    faults = tmp_path / 'faults.yaml'
    faults.write_text('faults:\n  - {sensor: link2_angle, kind: bias, onset: 0.5, size: -0.3}\n')
    said = call(*line(source, tmp_path / 'result', inject=faults)).out
    assert 'ALARM, link2_angle: error -0.' in said and 'size error' in said
    span = (part[-1][0] - part[0][0]) / NANOSECONDS
    assert f'{len(part)} measurements of {span:.4g} s, ' in said
    assert '1 of 1 injected faults found on the right sensor' in said
    assert re.search(r'link2_angle, bias from 0.500 s on: found after 0.\d+ s as \w+, -0.\d+', said)
    # Of a part of the bag onsets count from its beginning.
    call(*line(source, tmp_path / 'part', inject=faults, **{'from': 0.2}))
    before, after = (raw(bag, '/lpv/joint_states') for bag in (source, tmp_path / 'part'))
    changed = next(stamp for _, stamp, data in after if data not in [d for *_, d in before])
    assert changed - before[0][1] == pytest.approx(0.7 * NANOSECONDS, abs=1e7)
    late = '  - {sensor: link1_angle, kind: bias, onset: 5.0, size: 0.3}\n'
    faults.write_text(f'{faults.read_text()}{late}')
    said = call(*line(source, tmp_path / 'late', inject=faults)).out
    assert '1 of 1 injected faults found' in said
    assert 'link1_angle, bias from 5.000 s on: not injected, the recording ends before' in said
    scenario = tmp_path / 'scenario.yaml'
    path = 'path: {waypoints: [{t: 0, joints: [0, 0]}, {t: 9, joints: [1, 1]}]}'
    scenario.write_text(f'name: a\nduration: 9.0\n{path}\n{faults.read_text()}')
    again = call(*line(source, tmp_path / 'again', inject=scenario)).out
    assert '1 of 1 injected faults found on the right sensor' in again
    assert raw(source, truth[0]) and not raw(tmp_path / 'result', truth[0])  # no longer true


def test_given_bad_input_when_run_then_it_is_said(bag, tmp_path, monkeypatch, call, refused):
    monkeypatch.chdir(tmp_path)
    fault, precious = '{sensor: nose, kind: bias, onset: 1, size: 1}', Path('somewhere/precious')
    Path('faults.yaml').write_text(f'faults: [{fault}]\n')
    Path('misspelt.yaml').write_text('/**: {ros__parameters: {diagnosis: {sigma: 5.0}}}')
    Path('tuned.yaml').write_text('/**: {ros__parameters: {diagnosis: {clear_dwell: soon}}}')
    wrong = {'hours_between_false_alarms': 0, 'probability_of_wrong_name': 5.0, 'latch': 7}
    for name, value in wrong.items():
        text = f'/**: {{ros__parameters: {{diagnosis: {{{name}: {value}}}}}}}'
        Path(f'{name}.yaml').write_text(text)
    for name, value in (others := {'max_gap': 0, 'initial_samples': 2.7}).items():
        Path(f'{name}.yaml').write_text(f'/**: {{ros__parameters: {{{name}: {value}}}}}')
    Path('many.yaml').write_text(f'/**: {{ros__parameters: {{initial_samples: {10**6}}}}}')
    Path('old.bag').write_text('#ROSBAG V2.0\n')
    still, names = np.zeros((20, 2)), load_arm('paper').joint_names
    write_measurements('without_rates', names, 1.0 + 0.002 * np.arange(20), still + 1, None, still)
    precious.parent.mkdir()
    precious.write_text('mine')
    for named, *mistakes in (
        ('nothing', {'bag': 'nothing'}),
        ('is not a bag: a rosbag2 folder', {'bag': 'tuned.yaml'}),
        ('rosbags-convert --src old.bag --dst old', {'bag': 'old.bag'}),
        ('no measurement can be used: 20 measurements with NaN', {'bag': 'without_rates'}),
        ('neither a file nor shipped', {'arm': 'unknown_arm'}, {'arm': 'nothing.yaml'}),
        ('nothing.yaml', *({name: 'nothing.yaml'} for name in ('gains', 'inject', 'parameters'))),
        ('paper.yaml', {'gains': PAPER_ARM}, {'parameters': PAPER_ARM}),
        ('arm', {'arm': BRINGUP / 'arms' / 'real_arm.yaml'}),
        ('/nowhere', {'topic': '/nowhere'}),
        ('nose', {'inject': 'faults.yaml'}),
        ('/lpv/torque_command', {'effort-topic': '/nowhere'}),
        ('std_msgs/msg/String', {'effort-topic': '/chatter'}),
        ('give --publish', {'rate': 2}, {'topics': '/x'}, {'clock-rate': 0}, {'wait': 0}),
        ('--from', {'from': -1}, {'from': 'nan'}),
        ('--to', {'from': 2, 'to': 1}, {'to': 'inf'}),
        ('clear_dwell', {'parameters': 'tuned.yaml'}),
        ('diagnosis.sigma: is not a known parameter', {'parameters': 'misspelt.yaml'}),
        *((f'{name}: must', {'parameters': f'{name}.yaml'}) for name in (*wrong, *others)),
        ('initial_samples: must lie within', {'parameters': 'many.yaml'}),
        ('somewhere exists already', {'out': 'somewhere'}),
        ('exists already', {'out': 'tuned.yaml'}),
        ('would overwrite', {'bag': 'somewhere/bag', 'out': 'somewhere'}),
        ('would overwrite', {'bag': 'somewhere', 'out': 'somewhere'}),
        ('is inside', {'bag': 'somewhere', 'out': 'somewhere/x'}),
    ):
        lines = [line(**{'bag': bag, 'out': 'result', **changes}) for changes in mistakes]
        assert all(refused(named, *words) for words in lines)
        assert not Path('result').exists() and precious.read_text() == 'mine'
    # Nor are gains for an arm without a region.
    bag, arm = record_crane(tmp_path / 'bag', crane_run()), crane_file(tmp_path)
    arguments = ['replay', bag, '--arm', arm, '--out', tmp_path / 'out']
    told = 'lpv: is missing: gains are designed for its region'
    for option, name in (('--gains', 'paper.yaml'), ('--requirement', 'paper')):
        assert refused(told, *arguments, option, name)
    call(*arguments)
    assert not (tmp_path / 'out' / 'gains.yaml').exists()
    told = "--arm: is needed: the bag is of arm 'crane', which is not a shipped one"
    assert refused(told, 'replay', tmp_path / 'out', '--out', tmp_path / 'again')


def test_given_a_folder_that_must_stay_when_replaced_then_it_is_told(tmp_path, monkeypatch):
    out = tmp_path / 'out'

    def write_to(file):
        with replaced(out) as new:
            new.mkdir()
            (new / file).touch()

    def busy(call, path, *others, **options):  # as of a folder where a volume is mounted
        if Path(path) == out:
            raise OSError(errno.EBUSY, 'busy', str(path))
        return call(path, *others, **options)

    for file in ('first', 'second'):
        write_to(file)
    for name in ('rename', 'rmdir'):
        monkeypatch.setattr(os, name, partial(busy, getattr(os, name)))
    pytest.raises(ConfigError, write_to, 'third').match('out.*bag: cannot be replaced: .*busy')
    assert [path.name for path in tmp_path.iterdir()] == ['out']
    assert [path.name for path in out.iterdir()] == ['second']
