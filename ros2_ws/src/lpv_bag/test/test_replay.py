"""Replays of recorded bags: same answers as online, everything else untouched, damaged bags."""

import dataclasses
import math
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from places import BRINGUP, ROOT
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg

from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter, qos_profile
from lpv_bag.run.csv_import import import_csv, load_column_map
from lpv_bag.run.record import BagError, load_run
from lpv_cli.main import main
from lpv_core.control.tracking import TrackingController
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent, Mode
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.faults import Fault, FaultInjector
from lpv_core.support.errors import ConfigError
from lpv_core.support.timestamps import NANOSECONDS
from lpv_core.uio.certificate.gains import save_gains

pytestmark = pytest.mark.slow

PAPER_ARM = str(BRINGUP / 'arms' / 'paper.yaml')
RECORDINGS = Path(
    os.environ.get('LPV_REAL_ARM_DATA') or ROOT.parent / 'shared' / 'data' / 'real_arm'
)

TYPESTORE = make_typestore()

STEP = 2_000_000
"""Sample time [ns]."""
JOINT_STATE = 'sensor_msgs/msg/JointState'
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
COMMAND = 'lpv_msgs/msg/TorqueCommand'
VECTORS = {
    'state_estimate': (
        'position',
        'velocity',
        'compensated_position',
        'measured_position',
        'measured_velocity',
    ),
    'fault_estimate': ('estimate', 'bound', 'threshold'),
}


def simulate(arm, gains, scenario):
    """Stamp, measurement and the command that answers it, of a loop closed by a monitor."""
    plant, controller = ArmSimulator(arm, scenario), TrackingController(arm, gains)
    monitor = SerialSensorMonitor('/lpv/uio', arm, gains=gains)
    path, previous = scenario.path(arm), None
    messages = BagMessages(TYPESTORE, arm.name)
    for _ in range(int(round(scenario.duration / arm.sample_time)) + 1):
        stamp = round(plant.time * NANOSECONDS)
        sense = plant.sense()[0]
        message = messages.joint_state(
            stamp, arm.joint_names, sense.position, sense.velocity, sense.effort
        )
        state = monitor.take(stamp, message).state
        position = np.array(state['compensated_position'])
        interval = 0.0 if previous is None else (stamp - previous) / NANOSECONDS
        torque = controller.update(
            path.sample(stamp / NANOSECONDS),
            position,
            np.array(state['velocity']),
            position,
            interval,
        ).torque
        previous = stamp
        yield stamp, message, torque
        plant.step(torque)


def message(name, *values):
    return TYPESTORE.types[name](*values)


def status(stamp, name):
    entry = {'level': 0, 'name': name, 'message': 'fine', 'hardware_id': '', 'values': {'a': 'b'}}
    return BagMessages(TYPESTORE, '').diagnostics(stamp, [entry])


def write_bag(path, entries, types):
    """Write topic, time and message (or raw bytes) of each entry; types by topic."""
    with BagWriter(path, chunk_time=250_000_000) as writer:
        for topic, msgtype in types.items():
            writer.add_topic(topic, msgtype, [qos_profile(True, False, 10)])
        for topic, time, content in entries:
            write = writer.write_raw if isinstance(content, bytes) else writer.write
            write(topic, time, content)
    return path


def raw(bag, topic=None):
    """Topic, log time and bytes of a bag's messages."""
    with AnyReader([bag]) as reader:
        return [
            (c.topic, time, bytes(data))
            for c, time, data in reader.messages()
            if topic in (None, c.topic)
        ]


def read(bag, topic):
    """Messages of one topic."""
    with AnyReader([bag]) as reader:
        return [
            reader.deserialize(data, c.msgtype)
            for c, _, data in reader.messages()
            if c.topic == topic
        ]


def stamp_of(entry):
    return entry.header.stamp.sec * NANOSECONDS + entry.header.stamp.nanosec


@pytest.fixture(scope='module')
def loop(paper_arm, paper_gains, two_faults):
    """Measurements of 2 s with a fault of sensor 1 in the second half."""
    fault = Fault('link1_angle', 'bias', onset=1.0, size=0.3)
    return list(
        simulate(paper_arm, paper_gains, replace(two_faults, duration=2.0, faults=(fault,)))
    )


@pytest.fixture(scope='module')
def healthy(paper_arm, paper_gains, two_faults):
    """Measurements of 1.5 s without faults."""
    return list(simulate(paper_arm, paper_gains, replace(two_faults, duration=1.5, faults=())))


TYPES = {
    '/lpv/joint_states': JOINT_STATE,
    '/lpv/torque_command': COMMAND,
    '/chatter': 'std_msgs/msg/String',
    '/diagnostics': DIAGNOSTICS,
}


def entries_of(loop):
    """A recording with commands, chatter and the diagnostics of somebody else."""
    header = BagMessages(TYPESTORE, 'paper').header
    for k, (stamp, measurement, torque) in enumerate(loop):
        yield '/lpv/joint_states', stamp, measurement
        yield '/lpv/torque_command', stamp, message(COMMAND, header(stamp), torque, False)
        if k % 100 == 0:
            yield '/chatter', stamp + 5, message('std_msgs/msg/String', f'sample {k}')
            yield '/diagnostics', stamp + 7, status(stamp, f'/motor: axis {k}')


@pytest.fixture(scope='module')
def bag(loop, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('recorded') / 'bag', entries_of(loop), TYPES)


@pytest.fixture
def monitor(paper_arm, paper_gains):
    return SerialSensorMonitor('/anything', paper_arm, gains=paper_gains)


@pytest.fixture(scope='module')
def replayed(bag, paper_arm, paper_gains, tmp_path_factory):
    """Result and output of a replay of the bag."""
    out = tmp_path_factory.mktemp('replayed') / 'bag'
    events = []
    result = Replay(
        SerialSensorMonitor('/anything', paper_arm, gains=paper_gains),
        on_event=lambda event, _: events.append(event),
    ).run(bag, out)
    assert events == result.events
    return result, out


# ------------------------------------------------------------------ what is copied


def test_given_topics_of_others_when_replayed_then_they_are_copied_byte_for_byte(bag, replayed):
    _, out = replayed
    for topic in ('/chatter', '/lpv/joint_states', '/lpv/torque_command'):
        assert raw(out, topic) == raw(bag, topic)
    assert len(raw(out, '/chatter')) == 11
    with AnyReader([bag]) as before, AnyReader([out]) as after:
        for topic in before.topics:
            (one,) = before.topics[topic].connections
            (two,) = after.topics[topic].connections
            assert (one.msgtype, one.msgdef, one.digest) == (two.msgtype, two.msgdef, two.digest)
            assert one.ext == two.ext


def test_given_diagnostics_of_another_node_when_replayed_then_they_stay_beside_ours(bag, replayed):
    _, out = replayed
    theirs = [entry for entry in raw(out, '/diagnostics') if b'/motor: ' in entry[2]]
    assert theirs == raw(bag, '/diagnostics')
    ours = [m for m in read(out, '/diagnostics') if not m.status[0].name.startswith('/motor: ')]
    assert len(ours) >= 2
    for entry in ours:
        assert [s.name for s in entry.status] == [
            '/lpv/uio: observer',
            '/lpv/uio: link1_angle',
            '/lpv/uio: link2_angle',
        ]


def test_given_a_type_that_nobody_knows_here_when_replayed_then_it_is_copied_with_its_definition(
    loop, monitor, tmp_path
):
    odd = 'odd_msgs/msg/Note'
    with BagWriter(tmp_path / 'bag') as writer:
        writer.typestore.register(get_types_from_msg('string text\nint32 number', odd))
        writer.add_topic('/note', odd)
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.write('/note', 3, writer.typestore.types[odd]('hello', 7))
        for stamp, sample, _ in loop[:5]:
            writer.write('/joint_states', stamp, sample)
    Replay(monitor).run(tmp_path / 'bag', tmp_path / 'out')
    (note,) = read(tmp_path / 'out', '/note')
    assert (note.text, note.number) == ('hello', 7)


# ------------------------------------------------------------------ answers


def test_given_a_recording_when_replayed_then_answers_are_those_of_the_monitor_itself(
    loop, replayed, paper_arm, paper_gains
):
    result, out = replayed
    assert result.measurements == len(loop) == 1001
    assert not result.rejected
    monitor = SerialSensorMonitor('/lpv/uio', paper_arm, gains=paper_gains)
    answers = [monitor.take(stamp, sample) for stamp, sample, _ in loop]
    for topic, part in (('state_estimate', 'state'), ('fault_estimate', 'fault')):
        found = read(out, f'/lpv/{topic}')
        assert [stamp_of(m) for m in found] == [a.stamp for a in answers]
        assert {m.header.frame_id for m in found} == {'paper'}
        for entry, answer in zip(found, answers):
            for name, value in getattr(answer, part).items():
                assert np.array_equal(getattr(entry, name), value), name
    alarms = [(a.stamp, fields) for a in answers for fields in a.alarms]
    found = read(out, '/lpv/fault_alarm')
    assert len(found) == len(alarms) >= 1
    for entry, (stamp, fields) in zip(found, alarms):
        assert stamp_of(entry) == stamp
        for name in ('event', 'sensor', 'sensor_index', 'size', 'bound', 'kind', 'confidence'):
            assert getattr(entry, name) == fields[name]
        for name in ('onset', 'detected'):
            time = getattr(entry, name)
            assert time.sec * NANOSECONDS + time.nanosec == fields[name]


def test_given_a_replays_output_when_replayed_then_it_is_the_same_again(
    replayed, monitor, tmp_path
):
    _, once = replayed
    Replay(monitor).run(once, tmp_path / 'twice')
    assert raw(tmp_path / 'twice') == raw(once)
    one, two = (load_run(path).counts for path in (once, tmp_path / 'twice'))
    assert one == two
    assert one['/lpv/state_estimate'] == 1001


def test_given_recorded_answers_when_replayed_then_they_are_replaced_and_not_doubled(
    loop, replayed, monitor, tmp_path
):
    result, out = replayed
    wrong = BagMessages(TYPESTORE, 'old')
    lies = {
        'position': [9.0, 9.0],
        'velocity': [9.0, 9.0],
        'compensated_position': [9.0, 9.0],
        'measured_position': [9.0, 9.0],
        'measured_velocity': [9.0, 9.0],
        'mode': 0,
        'trustworthy': True,
    }
    entries = list(entries_of(loop))
    for stamp, _, _ in loop[::10]:
        entries.append(
            ('/lpv/state_estimate', stamp, wrong.make('lpv_msgs/msg/StateEstimate', stamp, lies))
        )
    entries.append(('/diagnostics', 500, status(500, '/lpv/uio: observer')))
    entries.sort(key=lambda entry: entry[1])
    types = {**TYPES, '/lpv/state_estimate': 'lpv_msgs/msg/StateEstimate'}
    source = write_bag(tmp_path / 'lies', entries, types)
    Replay(monitor).run(source, tmp_path / 'out')
    for topic in ('/lpv/state_estimate', '/lpv/fault_estimate', '/lpv/fault_alarm', '/chatter'):
        assert raw(tmp_path / 'out', topic) == raw(out, topic)
    assert sorted(raw(tmp_path / 'out', '/diagnostics')) == sorted(raw(out, '/diagnostics'))


def test_given_the_answers_of_another_arms_monitor_when_replayed_then_they_are_kept(
    loop, monitor, tmp_path
):
    entries = [
        *entries_of(loop[:20]),
        ('/diagnostics', 0, status(0, '/other/uio: observer')),
        ('/diagnostics', 1, status(1, '/lpv/uio2: observer')),
    ]
    source = write_bag(tmp_path / 'bag', entries, TYPES)
    Replay(monitor).run(source, tmp_path / 'out')
    names = {m.status[0].name for m in read(tmp_path / 'out', '/diagnostics')}
    assert names == {
        '/other/uio: observer',
        '/lpv/uio2: observer',
        '/lpv/uio: observer',
        '/motor: axis 0',
    }


def test_given_latched_alarms_when_replayed_then_their_topic_is_offered_latched(replayed):
    with AnyReader([replayed[1]]) as reader:
        durability = {
            c.topic: c.ext.offered_qos_profiles[0].durability.name
            for c in reader.connections
            if c.topic.startswith('/lpv/')
        }
    assert durability['/lpv/fault_alarm'] == 'TRANSIENT_LOCAL'
    assert durability['/lpv/fault_estimate'] == 'VOLATILE'


def test_given_no_namespace_when_replayed_then_answers_are_at_the_top(loop, monitor, tmp_path):
    entries = [('/joint_states', stamp, sample) for stamp, sample, _ in loop[:20]]
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    Replay(monitor).run(source, tmp_path / 'out')
    assert load_run(tmp_path / 'out').counts == {
        '/joint_states': 20,
        '/state_estimate': 20,
        '/fault_estimate': 20,
        '/joint_states_corrected': 20,
        '/fault_alarm': 0,
        '/diagnostics': 1,
    }
    assert read(tmp_path / 'out', '/diagnostics')[0].status[0].name == '/uio: observer'


def test_given_a_bag_of_humble_when_replayed_then_missing_type_hashes_do_no_harm(
    bag, replayed, monitor, tmp_path
):
    shutil.copytree(bag, tmp_path / 'bag')
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    content = yaml.safe_load(metadata.read_text())
    for topic in content['rosbag2_bagfile_information']['topics_with_message_count']:
        del topic['topic_metadata']['type_description_hash']
    metadata.write_text(yaml.safe_dump(content))
    Replay(monitor).run(tmp_path / 'bag', tmp_path / 'out')
    assert raw(tmp_path / 'out') == raw(replayed[1])


def test_given_a_single_file_when_replayed_then_the_answers_are_those_of_its_folder(
    bag, replayed, monitor, tmp_path
):
    (storage,) = bag.glob('*.mcap')
    alone = shutil.copy(storage, tmp_path / 'alone.mcap')
    Replay(monitor).run(alone, tmp_path / 'out')
    assert raw(tmp_path / 'out') == raw(replayed[1])


def test_given_torques_from_commands_when_replayed_then_the_one_before_each_sample_is_used(
    loop, bag, paper_arm, paper_gains, monitor, tmp_path
):
    Replay(monitor, torque_from_command=True).run(bag, tmp_path / 'out')
    twin, previous = SerialSensorMonitor('/lpv/uio', paper_arm, gains=paper_gains), [math.nan] * 2
    expected = []
    for stamp, sample, torque in loop:
        expected.append(twin.take(stamp, sample, previous))
        previous = torque
    found = read(tmp_path / 'out', '/lpv/state_estimate')
    assert [m.mode for m in found] == [a.state['mode'] for a in expected]
    assert found[0].mode == Mode.HOLDING
    for entry, answer in zip(found, expected):
        assert np.array_equal(entry.position, answer.state['position'])


def test_given_no_commands_when_torques_shall_come_from_them_then_the_error_says_what_is_missing(
    loop, monitor, tmp_path
):
    entries = [('/joint_states', stamp, sample) for stamp, sample, _ in loop[:20]]
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    with pytest.raises(BagError, match="no topic '/torque_command'"):
        Replay(monitor, torque_from_command=True).run(source, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


# ------------------------------------------------------------------ faults that are added


@pytest.mark.parametrize('sensor', [0, 1])
def test_given_an_injected_bias_when_replayed_then_it_is_estimated_and_alarmed(
    healthy, paper_arm, monitor, tmp_path, sensor
):
    name = paper_arm.sensor_names[sensor]
    source = write_bag(tmp_path / 'bag', entries_of(healthy), TYPES)
    injector = FaultInjector(
        paper_arm.sensor_names, [Fault(name, 'bias', 1.0, size=0.3)], np.random.default_rng(0)
    )
    result = Replay(monitor, injector=injector).run(source, tmp_path / 'out')
    (alarm,) = result.events
    assert (alarm.event, alarm.sensor, alarm.kind) == (AlarmEvent.RAISED, name, 'bias')
    assert 0 <= alarm.onset - 1_000_000_000 <= STEP
    before, after = load_run(source), load_run(tmp_path / 'out')
    late = after.time > 1.1
    expected = 0.3 * np.eye(2)[sensor]
    np.testing.assert_allclose(
        after.get('fault_estimate', 'estimate')[late], np.tile(expected, (late.sum(), 1)), atol=0.1
    )
    shift = np.cumsum(after.get('joint_states', 'position'), axis=1) - np.cumsum(
        before.get('joint_states', 'position'), axis=1
    )
    np.testing.assert_allclose(
        shift[after.time >= 1.0], np.tile(expected, (int((after.time >= 1.0).sum()), 1)), atol=1e-12
    )
    np.testing.assert_allclose(shift[after.time < 1.0], 0.0, atol=1e-12)
    for field in ('velocity', 'effort'):
        assert np.array_equal(before.get('joint_states', field), after.get('joint_states', field))


def test_given_epoch_stamps_when_faults_are_added_then_onsets_count_from_the_first_sample(
    healthy, paper_arm, monitor, tmp_path
):
    start = 1_700_000_000 * NANOSECONDS
    messages = BagMessages(TYPESTORE, 'paper')
    entries = [
        (
            '/joint_states',
            start + stamp,
            messages.joint_state(start + stamp, s.name, s.position, s.velocity, s.effort),
        )
        for stamp, s, _ in healthy
    ]
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    injector = FaultInjector(
        paper_arm.sensor_names,
        [Fault('link1_angle', 'bias', 1.0, size=0.3)],
        np.random.default_rng(0),
    )
    result = Replay(monitor, injector=injector).run(source, tmp_path / 'out')
    (alarm,) = result.events
    assert 0 <= alarm.onset - start - 1_000_000_000 <= STEP


def test_given_an_injected_dropout_when_replayed_then_no_answer_holds_a_number_that_is_none(
    healthy, paper_arm, monitor, tmp_path
):
    source = write_bag(tmp_path / 'bag', entries_of(healthy), TYPES)
    injector = FaultInjector(
        paper_arm.sensor_names,
        [Fault('link2_angle', 'dropout', 0.5, 0.5)],
        np.random.default_rng(0),
    )
    Replay(monitor, injector=injector).run(source, tmp_path / 'out')
    record = load_run(tmp_path / 'out')
    silent = np.isnan(record.get('joint_states', 'position')[:, 1])
    assert silent.sum() == 250
    assert len(record.stamps['state_estimate']) == len(healthy)
    assert_finite(tmp_path / 'out', '/lpv')


# ------------------------------------------------------------------ measurements of any kind


def assert_finite(bag, prefix):
    """No answer may hold NaN or infinity."""
    for topic, fields in VECTORS.items():
        for entry in read(bag, f'{prefix}/{topic}'):
            for name in fields:
                assert np.isfinite(getattr(entry, name)).all(), (topic, name)
    for entry in read(bag, f'{prefix}/fault_alarm'):
        assert np.isfinite([entry.size, entry.bound, entry.confidence]).all()


def spoiled(loop, share=0.1, seed=5):
    """Some values of some samples are NaN, infinite, absurd or missing."""
    rng = np.random.default_rng(seed)
    messages = BagMessages(TYPESTORE, 'paper')
    for stamp, sample, _ in loop:
        vectors = [np.array(v) for v in (sample.position, sample.velocity, sample.effort)]
        names = list(sample.name)
        if rng.random() < share:
            kind = rng.integers(6)
            vectors[kind % 3][rng.integers(2)] = rng.choice([math.nan, math.inf, -math.inf, 1e300])
            if kind == 3:
                vectors[2] = []
            elif kind == 4:
                vectors[rng.integers(3)] = [0.1]
            elif kind == 5:
                names[rng.integers(2)] = 'gripper'
        yield '/joint_states', stamp, messages.joint_state(stamp, names, *vectors)


def test_given_values_that_are_no_numbers_when_replayed_then_answers_are_numbers(
    loop, monitor, tmp_path
):
    source = write_bag(tmp_path / 'bag', spoiled(loop), {'/joint_states': JOINT_STATE})
    result = Replay(monitor).run(source, tmp_path / 'out')
    assert result.measurements == len(loop)
    assert sum(result.rejected.values()) == monitor.rejected > 0
    assert monitor.counters.not_finite > 10
    assert raw(tmp_path / 'out', '/joint_states') == raw(source, '/joint_states')
    assert len(read(tmp_path / 'out', '/state_estimate')) == len(loop) - monitor.rejected
    assert_finite(tmp_path / 'out', '')


def test_given_only_values_that_are_no_numbers_when_replayed_then_it_is_said_that_nothing_is_known(
    loop, monitor, tmp_path
):
    messages = BagMessages(TYPESTORE, 'paper')
    entries = [
        (
            '/joint_states',
            stamp,
            messages.joint_state(stamp, sample.name, [math.nan] * 2, [math.nan] * 2, []),
        )
        for stamp, sample, _ in loop[:50]
    ]
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    Replay(monitor).run(source, tmp_path / 'out')
    assert [m.mode for m in read(tmp_path / 'out', '/state_estimate')] == [Mode.NO_ESTIMATE] * 50
    assert read(tmp_path / 'out', '/fault_estimate') == []
    assert_finite(tmp_path / 'out', '')


def test_given_joints_that_are_not_the_arms_when_replayed_then_they_are_counted_by_reason(
    loop, paper_arm, monitor, tmp_path
):
    messages = BagMessages(TYPESTORE, 'paper')
    entries = []
    for k, (stamp, s, _) in enumerate(loop[:30]):
        names = ['joint1', 'joint2'] if k % 3 else ['left', 'right']
        entries.append(
            (
                '/joint_states',
                stamp,
                messages.joint_state(stamp, names, s.position, s.velocity, s.effort),
            )
        )
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    injector = FaultInjector(
        paper_arm.sensor_names,
        [Fault('link1_angle', 'bias', 0.0, size=0.3)],
        np.random.default_rng(0),
    )
    result = Replay(monitor, injector=injector).run(source, tmp_path / 'out')
    assert result.measurements == 30
    ((reason, count),) = result.rejected.items()
    assert count == monitor.rejected == 10
    assert "'joint1'" in reason
    assert 'left' in reason
    assert len(read(tmp_path / 'out', '/state_estimate')) == 20


def test_given_joints_in_another_order_with_more_of_them_when_replayed_then_answers_are_the_same(
    loop, replayed, monitor, tmp_path
):
    messages = BagMessages(TYPESTORE, 'paper')
    entries = []
    for stamp, s, _ in loop:
        vectors = [[v[1], 7.0, v[0]] for v in (s.position, s.velocity, s.effort)]
        entries.append(
            (
                '/lpv/joint_states',
                stamp,
                messages.joint_state(stamp, ['joint2', 'gripper', 'joint1'], *vectors),
            )
        )
    source = write_bag(tmp_path / 'bag', entries, {'/lpv/joint_states': JOINT_STATE})
    result = Replay(monitor).run(source, tmp_path / 'out')
    assert result.events == replayed[0].events
    for topic in ('/lpv/state_estimate', '/lpv/fault_estimate', '/lpv/fault_alarm'):
        assert raw(tmp_path / 'out', topic) == raw(replayed[1], topic)


def test_given_time_that_restarts_when_replayed_then_the_alarm_ends_and_is_raised_again(
    loop, monitor, tmp_path
):
    entries = [
        ('/joint_states', stamp + shift, sample)
        for shift in (0, 10 * NANOSECONDS)
        for stamp, sample, _ in loop
    ]
    source = write_bag(tmp_path / 'bag', entries, {'/joint_states': JOINT_STATE})
    result = Replay(monitor).run(source, tmp_path / 'out')
    assert monitor.counters.restarts == 1
    first, cleared, second = result.events
    assert (first.event, cleared.event) == (AlarmEvent.RAISED, AlarmEvent.CLEARED)
    assert cleared.stamp < second.stamp
    assert (second.event, second.sensor, second.kind) == (first.event, first.sensor, first.kind)
    assert (second.onset, second.stamp) == (first.onset, first.stamp)
    assert second.size == pytest.approx(first.size, abs=first.bound)


# ------------------------------------------------------------------ bags that cannot be replayed


def test_given_two_arms_when_replayed_then_both_topics_are_named_and_one_may_be_chosen(
    loop, monitor, tmp_path
):
    entries = [
        (topic, stamp, sample)
        for stamp, sample, _ in loop[:20]
        for topic in ('/a/joint_states', '/b/joint_states')
    ]
    source = write_bag(
        tmp_path / 'bag', entries, {'/a/joint_states': JOINT_STATE, '/b/joint_states': JOINT_STATE}
    )
    with pytest.raises(BagError, match='/a/joint_states, /b/joint_states'):
        Replay(monitor).run(source, tmp_path / 'out')
    with pytest.raises(BagError, match="'/c/joint_states'.* it has /a/joint_states"):
        Replay(monitor, topic='/c/joint_states').run(source, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()
    result = Replay(monitor, topic='/b/joint_states').run(source, tmp_path / 'out')
    assert result.measurements == 20
    counts = load_run(tmp_path / 'out', namespace='/b').counts
    assert counts['/b/state_estimate'] == counts['/a/joint_states'] == 20
    assert '/a/state_estimate' not in counts


def test_given_topics_of_any_name_when_one_is_called_joint_states_then_it_is_preferred(
    loop, monitor, tmp_path
):
    entries = [('/lpv/joint_states', stamp, sample) for stamp, sample, _ in loop[:20]]
    source = write_bag(
        tmp_path / 'bag',
        entries,
        {'/lpv/joint_states': JOINT_STATE, '/lpv/joint_targets': JOINT_STATE},
    )
    assert Replay(monitor).run(source, tmp_path / 'out').measurements == 20


def test_given_no_measurements_when_replayed_then_the_topics_that_are_there_are_named(
    monitor, tmp_path
):
    source = write_bag(
        tmp_path / 'bag',
        [('/chatter', 1, message('std_msgs/msg/String', 'hello'))],
        {'/chatter': 'std_msgs/msg/String'},
    )
    with pytest.raises(BagError, match=r'JointState; it has /chatter \(std_msgs/msg/String\)'):
        Replay(monitor).run(source, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def empty_folder(place, _):
    place.mkdir()


def metadata_only(place, bag):
    place.mkdir()
    shutil.copy(bag / 'metadata.yaml', place)


def garbage_metadata(place, bag):
    shutil.copytree(bag, place)
    (place / 'metadata.yaml').write_text('{{{')


def wrong_metadata(place, bag):
    shutil.copytree(bag, place)
    (place / 'metadata.yaml').write_text('rosbag2_bagfile_information: [1, 2]\n')


def garbage_storage(place, bag):
    shutil.copytree(bag, place)
    (storage,) = place.glob('*.mcap')
    storage.write_bytes(bytes(range(256)) * 40)


def empty_storage(place, bag):
    shutil.copytree(bag, place)
    (storage,) = place.glob('*.mcap')
    storage.write_bytes(b'')


def text_file(place, _):
    place.write_text('this is no bag\n')


def truncated(share, folder):
    def make(place, bag):
        (storage,) = bag.glob('*.mcap')
        data = storage.read_bytes()
        if folder:
            shutil.copytree(bag, place)
            place = place / storage.name
        place.write_bytes(data[: int(share * len(data))])

    return make


DAMAGED = {
    'missing': ('bag', lambda place, bag: None),
    'missing file': ('a.mcap', lambda *_: None),
    'empty folder': ('bag', empty_folder),
    'no storage': ('bag', metadata_only),
    'garbage storage': ('bag', garbage_storage),
    'empty storage': ('bag', empty_storage),
    'garbage mcap': ('bag.mcap', text_file),
    'garbage db3': ('bag.db3', text_file),
    'ros 1': ('bag.bag', text_file),
    'text': ('bag.txt', text_file),
    'cut at 0.001': ('bag', truncated(0.001, True)),
    **{f'file cut at {share}': ('bag.mcap', truncated(share, False)) for share in (0.0, 0.001)},
}
DAMAGED_IN_PART = {
    'garbage metadata': ('bag', garbage_metadata),
    'wrong metadata': ('bag', wrong_metadata),
    **{f'cut at {share}': ('bag', truncated(share, True)) for share in (0.3, 0.7, 0.999)},
    **{f'file cut at {share}': ('bag.mcap', truncated(share, False)) for share in (0.3, 0.999)},
}


@pytest.mark.parametrize('case', DAMAGED_IN_PART)
def test_given_a_bag_that_is_damaged_in_part_when_replayed_then_the_rest_is_and_it_is_said(
    bag, monitor, tmp_path, caplog, case
):
    name, make = DAMAGED_IN_PART[case]
    make(tmp_path / name, bag)
    result = Replay(monitor).run(tmp_path / name, tmp_path / 'out')
    assert 100 < result.measurements <= 1001
    assert (result.measurements == 1001) == (
        case not in ('cut at 0.3', 'cut at 0.7', 'file cut at 0.3')
    )
    assert any(str(tmp_path / name) in record.getMessage() for record in caplog.records)


@pytest.mark.parametrize('case', DAMAGED)
def test_given_a_bag_that_cannot_be_read_when_replayed_then_the_error_names_it(
    bag, monitor, tmp_path, case
):
    name, make = DAMAGED[case]
    make(tmp_path / name, bag)
    with pytest.raises(BagError, match=name) as caught:
        Replay(monitor).run(tmp_path / name, tmp_path / 'out')
    assert str(caught.value).startswith(str(tmp_path / name))
    assert not (tmp_path / 'out').exists()


def test_given_single_bytes_that_are_wrong_when_replayed_then_what_is_missing_is_said(
    loop, paper_arm, paper_gains, tmp_path, caplog
):
    source = write_bag(tmp_path / 'bag', entries_of(loop[:5]), TYPES)
    (storage,) = source.glob('*.mcap')
    data, rng, failed = storage.read_bytes(), np.random.default_rng(8), 0
    for trial, at in enumerate(rng.integers(len(data), size=30)):
        storage.write_bytes(data[:at] + bytes([data[at] ^ (1 << rng.integers(8))]) + data[at + 1 :])
        caplog.clear()
        try:
            result = Replay(SerialSensorMonitor('/uio', paper_arm, gains=paper_gains)).run(
                source, tmp_path / f'out{trial}'
            )
            assert result.measurements == 5 or caplog.records
        except BagError:
            failed += 1
    assert 2 < failed < 28


def test_given_an_existing_output_when_replayed_then_it_is_an_error_and_stays(
    bag, monitor, tmp_path
):
    (tmp_path / 'out').mkdir()
    with pytest.raises(ConfigError, match='exists'):
        Replay(monitor).run(bag, tmp_path / 'out')
    assert list((tmp_path / 'out').iterdir()) == []


# ------------------------------------------------------------------ recordings of a real arm


@pytest.fixture(scope='module', params=['run_143601', 'run_144115'])
def recording(request, tmp_path_factory):
    """A recording as a bag."""
    source = RECORDINGS / f'{request.param}.csv'
    if not source.is_file():
        pytest.skip(f'{source} is absent: recordings are not part of the repository')
    out = tmp_path_factory.mktemp(request.param) / 'bag'
    columns = load_column_map(BRINGUP / 'columns' / 'real_arm.yaml')
    count, warnings = import_csv(source, columns, out)
    with source.open() as lines:
        assert count == sum(1 for _ in lines) - 1 > 4900
    assert warnings == []
    return out


def test_given_a_healthy_recording_when_replayed_then_no_fault_is_seen_and_nothing_is_alarmed(
    recording, real_arm, real_gains, tmp_path
):
    result = Replay(SerialSensorMonitor('/uio', real_arm, gains=real_gains)).run(
        recording, tmp_path / 'out'
    )
    assert result.events == []
    assert not result.rejected
    record = load_run(tmp_path / 'out', joint_names=real_arm.joint_names)
    estimate = record.aligned('fault_estimate', 'estimate')
    assert np.abs(estimate[record.time > 1.0]).max() < 0.1
    assert not record.get('fault_estimate', 'alarm').any()


@pytest.mark.parametrize('encoder', [0, 1])
def test_given_a_step_on_an_encoder_when_replayed_then_it_is_known_after_a_tenth_of_a_second(
    recording, real_arm, real_gains, tmp_path, encoder
):
    fault = Fault(real_arm.sensor_names[encoder], 'bias', onset=3.0, size=0.3)
    injector = FaultInjector(real_arm.sensor_names, [fault], np.random.default_rng(0))
    Replay(SerialSensorMonitor('/uio', real_arm, gains=real_gains), injector=injector).run(
        recording, tmp_path / 'out'
    )
    record = load_run(tmp_path / 'out', joint_names=real_arm.joint_names)
    late = record.time >= 3.1
    error = record.aligned('fault_estimate', 'estimate')[late] - 0.3 * np.eye(2)[encoder]
    assert late.sum() > 3000
    assert np.abs(error).max() < 0.1


# ------------------------------------------------------------------ command line


@pytest.fixture
def command(paper_gains, tmp_path):
    """Arguments of a replay that needs nothing installed."""
    save_gains(paper_gains, tmp_path / 'gains.yaml')

    def arguments(bag, **changes):
        options = {
            'arm': PAPER_ARM,
            'gains': tmp_path / 'gains.yaml',
            'out': tmp_path / 'result',
            **changes,
        }
        return [
            'replay',
            str(bag),
            *(str(part) for name, value in options.items() for part in (f'--{name}', value)),
        ]

    return arguments


def test_given_the_command_when_run_twice_then_bag_and_report_are_those_of_the_second_run(
    bag, replayed, command, tmp_path, capsys
):
    assert main(command(bag, report=tmp_path / 'report')) == 0
    said = capsys.readouterr().out
    assert '1001 measurements' in said
    assert 'ALARM, link1_angle' in said
    assert raw(tmp_path / 'result') == raw(replayed[1])
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
    assert 'ALARM, link2_angle: error -0.' in said
    assert '1 of 1 injected faults found on the right sensor' in said
    assert re.search(r'link2_angle, bias from 1.000 s on: found after 0.\d+ s as \w+, -0.\d+', said)
    assert 'size error' in said


def test_given_other_joint_names_when_the_command_is_run_then_it_says_so_and_fails(
    healthy, command, tmp_path, capsys
):
    renamed = []
    for topic, time, content in entries_of(healthy):
        if topic == '/lpv/joint_states':
            content = dataclasses.replace(content, name=['left', 'right'])
        renamed.append((topic, time, content))
    source = write_bag(tmp_path / 'bag', renamed, TYPES)
    assert main(command(source)) == 2
    said = capsys.readouterr().err
    assert 'none of its' in said and 'measurements can be used' in said and 'left' in said
    assert not (tmp_path / 'result').exists()


def test_given_alarms_when_the_command_is_run_then_times_count_from_the_first_measurement(
    bag, replayed, command, capsys
):
    raised = next(e for e in replayed[0].events if e.event == AlarmEvent.RAISED)
    assert main(command(bag)) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if ' ALARM, ' in line]
    at = float(re.search(r'(\d+\.\d{3}) s\b', line)[1])
    assert at == pytest.approx((raised.stamp - replayed[0].first_stamp) / NANOSECONDS, abs=6e-4)


FAULTS_OF_NOBODY = 'faults:\n  - {sensor: nose, kind: bias, onset: 1.0, size: 1.0}\n'


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
    bag, command, tmp_path, monkeypatch, capsys, changes, named
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'faults.yaml').write_text(FAULTS_OF_NOBODY)
    (tmp_path / 'tuned.yaml').write_text('/**: {ros__parameters: {diagnosis: {clear_dwell: soon}}}')
    (tmp_path / 'somewhere').mkdir()
    (tmp_path / 'somewhere' / 'precious.txt').write_text('mine')
    changes = dict(changes)
    assert main(command(changes.pop('bag', bag), **changes)) == 2
    said = capsys.readouterr().err
    assert said.startswith('lpv replay: ')
    assert said.count('\n') == 1
    assert named in said
    assert not (tmp_path / 'result').exists()
    assert (tmp_path / 'somewhere' / 'precious.txt').read_text() == 'mine'


def test_given_its_own_output_when_the_command_shall_replay_it_then_it_refuses(
    replayed, command, tmp_path, capsys
):
    shutil.copytree(replayed[1], tmp_path / 'result' / 'bag')
    for out in (tmp_path / 'result', tmp_path / 'result' / 'bag'):
        assert main(command(tmp_path / 'result' / 'bag', out=out)) == 2
        assert 'would overwrite' in capsys.readouterr().err
    assert main(command(tmp_path / 'result' / 'bag', out=tmp_path / 'result' / 'bag' / 'x')) == 2
    assert 'is inside' in capsys.readouterr().err
    assert raw(tmp_path / 'result' / 'bag') == raw(replayed[1])


def test_given_a_bag_with_its_gains_when_the_command_is_run_then_neither_arm_nor_gains_are_needed(
    bag, replayed, paper_gains, tmp_path, capsys
):
    shutil.copytree(bag, tmp_path / 'bag')
    save_gains(paper_gains, tmp_path / 'bag' / 'gains.yaml')
    arguments = ['replay', str(tmp_path / 'bag'), '--out', str(tmp_path / 'result')]
    assert main(arguments) == 0
    assert "arm 'paper' and gains as in the bag" in capsys.readouterr().out
    assert raw(tmp_path / 'result') == raw(replayed[1])
    assert main([*arguments, '--arm', str(BRINGUP / 'arms' / 'real_arm.yaml'), '--gains', 'x']) == 2
    assert "'x' is neither a file nor shipped" in capsys.readouterr().err
    assert main([*arguments, '--gains', 'paper']) == 0


def test_given_a_bag_that_names_no_arm_when_the_command_is_run_then_it_asks_for_one(
    bag, tmp_path, capsys
):
    assert main(['replay', str(bag), '--out', str(tmp_path / 'result')]) == 2
    assert '--arm: is needed where neither gains nor the bag name an arm' in capsys.readouterr().err
