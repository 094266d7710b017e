"""Recorded runs as arrays: alignment by stamps, names, alarms."""

import math
import re
import shutil

import numpy as np
import pytest

from lpv_bag.rosbag.interfaces import message_text
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run import decoder
from lpv_bag.run.record import ALARM_TYPE, STREAMS, BagError, load_run
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent, Mode

EPOCH = 1_700_000_000_123_456_789
MS = 1_000_000


class Recorder:
    """Writes messages of a made-up run; they are logged in the order in which they are added."""

    def __init__(self, path):
        self.path, self._writer, self._time = path, BagWriter(path), 0
        self._messages = BagMessages(self._writer.typestore, 'arm')

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._writer.close()

    def topic(self, topic, msgtype):
        if topic not in self._writer.counts:
            self._writer.add_topic(topic, msgtype)

    def write(self, topic, msgtype, message):
        self.topic(topic, msgtype)
        self._time += 1
        self._writer.write(topic, self._time, message)

    def measure(
        self,
        stamp,
        position,
        names=('joint1', 'joint2'),
        velocity=None,
        effort=None,
        topic='/joint_states',
    ):
        zeros = [0.0] * len(names)
        self.write(
            topic,
            'sensor_msgs/msg/JointState',
            self._messages.joint_state(
                stamp,
                names,
                position,
                zeros if velocity is None else velocity,
                zeros if effort is None else effort,
            ),
        )

    def stream(self, name, stamp, topic=None, **fields):
        msgtype = STREAMS[name][0]
        defaults = {
            'state_estimate': STATE,
            'fault_estimate': FAULT,
            'reference': REFERENCE,
            'torque_command': {'torque': [0.0, 0.0], 'safe_stop': False},
        }[name]
        self.write(
            topic or f'/{name}',
            msgtype,
            self._messages.make(msgtype, stamp, {**defaults, **fields}),
        )

    def alarm(self, stamp, **fields):
        self.write(
            '/fault_alarm', ALARM_TYPE, self._messages.make(ALARM_TYPE, stamp, {**ALARM, **fields})
        )


ZERO = [0.0, 0.0]
STATE = {
    'position': ZERO,
    'velocity': ZERO,
    'compensated_position': ZERO,
    'measured_position': ZERO,
    'measured_velocity': ZERO,
    'mode': 0,
    'trustworthy': True,
}
FAULT = {
    'sensor_names': ['left', 'right'],
    'estimate': ZERO,
    'bound': ZERO,
    'threshold': ZERO,
    'state': [0, 0],
    'alarm': [False, False],
}
REFERENCE = {'position': ZERO, 'velocity': ZERO, 'acceleration': ZERO, 'tip_position': ZERO}
ALARM = {
    'sensor': 'left',
    'sensor_index': 0,
    'event': 0,
    'onset': 5 * MS,
    'detected': 15 * MS,
    'size': 0.3,
    'bound': 0.1,
    'kind': 'unclassified',
    'confidence': 0.99,
}


@pytest.fixture
def recorder(tmp_path):
    return Recorder(tmp_path / 'bag')


# ------------------------------------------------------------------ streams


def test_given_measurements_when_loaded_then_fields_names_and_times_are_exact(recorder):
    with recorder as bag:
        for k in range(4):
            bag.measure(EPOCH + 2 * MS * k, [k, k + 0.25], velocity=[k + 0.5, k], effort=[k, -k])
    record = load_run(recorder.path)
    assert record.stamps['joint_states'].tolist() == [EPOCH + 2 * MS * k for k in range(4)]
    assert record.stamps['joint_states'].dtype == np.int64
    assert record.time.tolist() == [0.0, 0.002, 0.004, 0.006]
    assert record.get('joint_states', 'position').tolist() == [[k, k + 0.25] for k in range(4)]
    assert record.get('joint_states', 'velocity').tolist() == [[k + 0.5, k] for k in range(4)]
    assert record.get('joint_states', 'effort').tolist() == [[k, -k] for k in range(4)]
    assert record.joint_names == ('joint1', 'joint2')
    assert record.seconds(EPOCH - 1) == -1e-9


def test_given_streams_when_loaded_then_each_field_is_an_array_of_numbers(recorder):
    with recorder as bag:
        for stamp in (10, 20):
            bag.measure(stamp, ZERO)
        bag.stream('state_estimate', 20, position=[1, 2], mode=int(Mode.HOLDING))
        bag.stream('fault_estimate', 20, estimate=[3, 4], state=[2, 3], alarm=[True, False])
        bag.stream('torque_command', 10, torque=[5, 6], safe_stop=True)
        bag.stream('reference', 10, tip_position=[7, 8])
    record = load_run(recorder.path)
    assert set(record.streams) == {
        'joint_states',
        'state_estimate',
        'fault_estimate',
        'torque_command',
        'reference',
    }
    for name, fields in record.streams.items():
        assert tuple(fields) == STREAMS[name][1]
        assert all(values.dtype == float for values in fields.values())
    assert record.get('state_estimate', 'mode').tolist() == [Mode.HOLDING]
    assert record.get('fault_estimate', 'state').tolist() == [[2, 3]]
    assert record.get('fault_estimate', 'alarm').tolist() == [[1, 0]]
    assert record.get('torque_command', 'safe_stop').tolist() == [1]
    assert record.get('reference', 'tip_position').tolist() == [[7, 8]]
    assert record.sensor_names == ('left', 'right')
    assert record.get('ground_truth', 'fault') is None
    assert record.aligned('ground_truth', 'fault') is None


def test_given_a_stream_with_other_stamps_when_aligned_then_only_equal_stamps_are_taken(recorder):
    with recorder as bag:
        for k in range(5):
            bag.measure(EPOCH + k, ZERO)
        for k in (-3, 1, 3, 9):
            bag.stream('fault_estimate', EPOCH + k, estimate=[k, 2 * k])
    record = load_run(recorder.path)
    np.testing.assert_array_equal(
        record.aligned('fault_estimate', 'estimate'),
        [[math.nan] * 2, [1, 2], [math.nan] * 2, [3, 6], [math.nan] * 2],
    )
    assert record.get('fault_estimate', 'estimate').tolist() == [[-3, -6], [1, 2], [3, 6], [9, 18]]


def test_given_a_field_without_columns_when_aligned_then_it_has_none_either(recorder):
    with recorder as bag:
        for k in range(3):
            bag.measure(k, ZERO)
        bag.stream('state_estimate', 1, mode=int(Mode.STALE))
    mode = load_run(recorder.path).aligned('state_estimate', 'mode')
    np.testing.assert_array_equal(mode, [math.nan, Mode.STALE, math.nan])


def test_given_messages_in_any_order_when_loaded_then_rows_are_sorted_and_the_last_one_counts(
    recorder,
):
    with recorder as bag:
        for stamp, value in ((30, 1), (10, 2), (20, 3), (10, 4), (30, 5)):
            bag.measure(stamp, [value, 0])
            bag.stream('fault_estimate', stamp, estimate=[value, 0])
    record = load_run(recorder.path)
    assert record.stamps['joint_states'].tolist() == [10, 20, 30]
    assert record.get('joint_states', 'position')[:, 0].tolist() == [4, 3, 5]
    assert record.aligned('fault_estimate', 'estimate')[:, 0].tolist() == [4, 3, 5]


def test_given_answers_that_know_nothing_when_loaded_then_they_are_left_out_but_counted(recorder):
    with recorder as bag:
        for k in range(4):
            bag.measure(k, ZERO)
            mode = Mode.NO_ESTIMATE if k < 2 else Mode.OBSERVING
            bag.stream('state_estimate', k, position=[k, k], mode=int(mode))
    record = load_run(recorder.path)
    assert record.stamps['state_estimate'].tolist() == [2, 3]
    np.testing.assert_array_equal(
        record.aligned('state_estimate', 'position')[:, 0], [math.nan, math.nan, 2, 3]
    )
    assert record.counts['/state_estimate'] == 4


def test_given_answers_that_all_know_nothing_when_loaded_then_the_stream_is_absent(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(k, ZERO)
            bag.stream('state_estimate', k, mode=int(Mode.NO_ESTIMATE))
    assert load_run(recorder.path).aligned('state_estimate', 'position') is None


def test_given_topics_of_any_type_when_loaded_then_all_are_counted(recorder):
    with recorder as bag:
        for k in range(3):
            bag.measure(k, ZERO, topic='/lpv/joint_states')
        for k in range(2):
            bag.write(
                '/chatter',
                'std_msgs/msg/String',
                bag._writer.typestore.types['std_msgs/msg/String'](str(k)),
            )
        bag.topic('/lpv/fault_alarm', ALARM_TYPE)
    record = load_run(recorder.path)
    assert record.counts == {'/lpv/joint_states': 3, '/chatter': 2, '/lpv/fault_alarm': 0}
    assert record.topics == {'joint_states': '/lpv/joint_states', 'fault_alarm': '/lpv/fault_alarm'}
    assert record.alarms == []


def test_given_a_single_storage_file_when_loaded_then_it_is_the_same_run(recorder, tmp_path):
    with recorder as bag:
        for k in range(3):
            bag.measure(EPOCH + k, [k, k])
    (storage,) = recorder.path.glob('*.mcap')
    record = load_run(shutil.copy(storage, tmp_path / 'alone.mcap'))
    assert record.get('joint_states', 'position').tolist() == [[0, 0], [1, 1], [2, 2]]
    assert record.counts == {'/joint_states': 3}


# ------------------------------------------------------------------ joints


def test_given_joints_whose_order_changes_when_loaded_then_names_decide(recorder):
    with recorder as bag:
        bag.measure(1, [1, 2])
        bag.measure(2, [2, 1], names=('joint2', 'joint1'))
        bag.measure(3, [9, 2, 8, 1], names=('a', 'joint2', 'b', 'joint1'))
        bag.measure(4, [1, 2])
    record = load_run(recorder.path)
    assert record.joint_names == ('joint1', 'joint2')
    assert record.get('joint_states', 'position').tolist() == [[1, 2]] * 4


def test_given_wanted_joints_when_loaded_then_they_are_taken_in_that_order(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(k, [1, 2, 3], names=('a', 'b', 'c'), effort=[4, 5, 6])
    record = load_run(recorder.path, joint_names=('c', 'a'))
    assert record.joint_names == ('c', 'a')
    assert record.get('joint_states', 'position').tolist() == [[3, 1]] * 2
    assert record.get('joint_states', 'effort').tolist() == [[6, 4]] * 2


def test_given_arrays_of_another_size_when_loaded_then_their_values_are_unknown(recorder):
    with recorder as bag:
        bag.measure(1, [1, 2], effort=[])
        bag.measure(2, [1, 2], effort=[5, 6], velocity=[7])
    record = load_run(recorder.path)
    np.testing.assert_array_equal(record.get('joint_states', 'effort'), [[math.nan] * 2, [5, 6]])
    np.testing.assert_array_equal(record.get('joint_states', 'velocity'), [[0, 0], [math.nan] * 2])


def test_given_a_joint_that_no_message_has_when_loaded_then_the_error_names_it(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(k, ZERO, names=('a', 'b'))
    with pytest.raises(BagError, match="'elbow' .*a, b"):
        load_run(recorder.path, joint_names=('a', 'elbow'))


def test_given_messages_of_other_joints_between_when_loaded_then_they_are_passed_over(recorder):
    with recorder as bag:
        for k in range(3):
            bag.measure(2 * k, [k, k])
            bag.measure(2 * k + 1, [0.5], names=('finger',))
    record = load_run(recorder.path, joint_names=('joint1', 'joint2'))
    position = record.get('joint_states', 'position')
    assert position[~np.isnan(position[:, 0])].tolist() == [[0, 0], [1, 1], [2, 2]]


# ------------------------------------------------------------------ alarms


def test_given_alarms_when_loaded_then_all_fields_are_there_in_the_order_of_their_stamps(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(EPOCH + k, ZERO)
        bag.alarm(EPOCH + 900, event=2, size=0.01, onset=EPOCH + 1, detected=EPOCH + 2)
        bag.alarm(EPOCH + 2, onset=EPOCH + 1, detected=EPOCH + 2)
        bag.alarm(EPOCH + 2, onset=EPOCH + 2, detected=EPOCH + 2, sensor='right', sensor_index=1)
        bag.alarm(EPOCH + 50, event=1, size=-0.5, kind='bias', confidence=0.5)
    alarms = load_run(recorder.path).alarms
    assert [(a.stamp - EPOCH, a.event, a.sensor) for a in alarms] == [
        (2, AlarmEvent.RAISED, 'left'),
        (2, AlarmEvent.RAISED, 'right'),
        (50, AlarmEvent.UPDATED, 'left'),
        (900, AlarmEvent.CLEARED, 'left'),
    ]
    assert (alarms[0].onset, alarms[0].detected) == (EPOCH + 1, EPOCH + 2)
    assert (alarms[1].sensor_index, alarms[1].bound) == (1, 0.1)
    assert (alarms[2].size, alarms[2].kind, alarms[2].confidence) == (-0.5, 'bias', 0.5)


def test_given_latched_alarms_that_came_twice_when_loaded_then_each_is_there_once(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(k, ZERO)
        for _ in range(3):
            bag.alarm(10)
            bag.alarm(10, sensor='right', sensor_index=1)
        bag.alarm(20)
    record = load_run(recorder.path)
    assert [(a.stamp, a.sensor) for a in record.alarms] == [
        (10, 'left'),
        (10, 'right'),
        (20, 'left'),
    ]
    assert record.counts['/fault_alarm'] == 7


def test_given_an_event_that_nobody_knows_when_loaded_then_it_is_an_error(recorder):
    with recorder as bag:
        for k in range(2):
            bag.measure(k, ZERO)
        bag.alarm(10, event=7)
    with pytest.raises(BagError, match='unknown event 7'):
        load_run(recorder.path)


# ------------------------------------------------------------------ bags that hold no run


@pytest.mark.parametrize('stamps', [(), (5,), (5, 5, 5)])
def test_given_fewer_than_two_measurements_when_loaded_then_the_error_says_so(recorder, stamps):
    with recorder as bag:
        bag.topic('/joint_states', 'sensor_msgs/msg/JointState')
        for stamp in stamps:
            bag.measure(stamp, ZERO)
    with pytest.raises(BagError, match='bag: .*/joint_states'):
        load_run(recorder.path)


def test_given_two_arms_when_loaded_then_a_namespace_tells_them_apart(recorder):
    with recorder as bag:
        for k in range(3):
            for i, name in enumerate(('/a', '/b/c')):
                bag.measure(k, [i, i], topic=f'{name}/joint_states')
                bag.stream('fault_estimate', k, f'{name}/fault_estimate', estimate=[i, k])
    with pytest.raises(BagError, match='/a/joint_states, /b/c/joint_states.*namespace'):
        load_run(recorder.path)
    for i, name in enumerate(('a', '/b/c/')):
        record = load_run(recorder.path, namespace=name)
        assert record.get('joint_states', 'position')[:, 0].tolist() == [i] * 3
        assert record.get('fault_estimate', 'estimate')[:, 0].tolist() == [i] * 3
    with pytest.raises(BagError, match='namespace /c'):
        load_run(recorder.path, namespace='/c')


# ------------------------------------------------------------------ padding


@pytest.mark.parametrize('attempts', [0, 32])
def test_given_messages_without_efforts_that_end_in_padding_when_loaded_then_they_are_read(
    tmp_path, monkeypatch, attempts
):
    monkeypatch.setattr('lpv_bag.run.decoder._MOST_ATTEMPTS', attempts)
    kind, names = 'sensor_msgs/msg/JointState', ('joint1', 'joint2')
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/joint_states', kind)
        for k in range(3):
            message = BagMessages(writer.typestore, 'arm').joint_state(k, names, [k, 1], [0, 0], [])
            data = bytes(writer.typestore.serialize_cdr(message, kind))
            padded = data + bytes(-len(data) % 4)
            assert writer.without_garbage(kind, padded + b'junk') == padded
            writer.write_raw('/joint_states', k, padded + b'junk')
    record = load_run(tmp_path / 'bag')
    assert list(record.get('joint_states', 'position')[:, 0]) == [0, 1, 2]
    assert np.isnan(record.get('joint_states', 'effort')).all()


# ------------------------------------------------------------------ numbers of joints


def test_given_seven_joints_when_loaded_then_all_are_in_the_record(recorder):
    names = tuple(f'j{i}' for i in range(7))
    with recorder as bag:
        for k in range(2):
            bag.measure(k * MS, np.arange(7.0), names=names)
            bag.stream(
                'fault_estimate',
                k * MS,
                **{name: np.arange(7.0) for name in ('estimate', 'bound', 'threshold')},
                sensor_names=names,
                state=[0] * 7,
                alarm=[False] * 7,
            )
    record = load_run(recorder.path)
    assert record.sensor_names == record.joint_names == names
    np.testing.assert_array_equal(record.get('fault_estimate', 'estimate'), [np.arange(7.0)] * 2)


def test_given_one_joint_when_loaded_then_its_columns_stay_columns(recorder):
    with recorder as bag:
        for k in range(3):
            bag.measure(k * MS, [0.5], names=('j',))
            bag.stream('torque_command', k * MS, torque=[2.0])
    record = load_run(recorder.path)
    assert record.get('torque_command', 'torque').shape == (3, 1)
    assert record.get('torque_command', 'safe_stop').shape == (3,)


@pytest.mark.parametrize('fast', [False, True])
def test_given_arrays_that_do_not_fit_when_loaded_then_they_are_left_out_with_a_warning(
    recorder, monkeypatch, fast
):
    with recorder as bag:
        for k in range(4):
            bag.measure(k * MS, [0.0, 0.0])
            torque = [0.0] * (2 if k != 2 else 3)
            bag.stream('torque_command', k * MS, torque=torque)
            bag.stream('fault_estimate', k * MS, bound=[0.1] * (2 if k else 1))
    if not fast:
        monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 0)
    record = load_run(recorder.path, joint_names=('joint1', 'joint2'))
    assert list(record.stamps['torque_command']) == [0, MS, 3 * MS]
    assert list(record.stamps['fault_estimate']) == [MS, 2 * MS, 3 * MS]
    assert [w for w in record.warnings if 'number of joints does not fit' in w and ': 1 ' in w]


def test_given_a_bag_whose_arrays_have_a_fixed_length_when_loaded_then_it_is_as_ever(
    tmp_path, monkeypatch
):
    def as_before(msgtype):
        text = message_text(msgtype)
        return re.sub(r'^(\w+)\[\] ', r'\1[2] ', text, flags=re.M) if 'lpv' in msgtype else text

    with monkeypatch.context() as old:
        old.setattr('lpv_bag.rosbag.interfaces.message_text', as_before)
        bag = Recorder(tmp_path / 'bag')
    with bag:
        for k in range(3):
            bag.measure(k * MS, [0.0, 0.0])
            bag.stream('fault_estimate', k * MS, estimate=[k, 0.5])
    assert b'float64[2] estimate' in next((tmp_path / 'bag').glob('*.mcap')).read_bytes()
    record = load_run(tmp_path / 'bag')
    np.testing.assert_array_equal(record.get('fault_estimate', 'estimate')[:, 0], range(3))


# ------------------------------------------------------------------ many at a time


def mixed(path, seed):
    """Messages of many shapes, in any order, some of them with the stamp of another one."""
    random = np.random.default_rng(seed)
    values = iter(random.normal(size=100_000).tolist())

    def pair(count=2):
        return [next(values) for _ in range(count)]

    with Recorder(path) as bag:
        bag.measure(EPOCH, pair())
        for _ in range(400):
            stamp, kind = EPOCH + int(random.integers(1, 300)) * MS, random.integers(9)
            if kind < 3:
                bag.measure(stamp, pair(), velocity=pair(), effort=pair())
            elif kind == 3:
                bag.measure(stamp, pair(3), names=('grip', 'joint2', 'joint1'), effort=[])
            elif kind == 4:
                bag.measure(stamp, pair(1), names=('finger',))
            elif kind == 5:
                bag.stream('state_estimate', stamp, position=pair(), mode=int(random.integers(5)))
            elif kind == 6:
                bag.stream(
                    'fault_estimate',
                    stamp,
                    estimate=pair(),
                    state=[0, 4],
                    sensor_names=['left', 'right'] if random.random() < 0.8 else ['l', 'r'],
                )
            elif kind == 7:
                bag.stream(
                    'torque_command', stamp, torque=pair(), safe_stop=bool(random.integers(2))
                )
            else:
                bag.alarm(stamp, size=next(values), event=int(random.integers(3)))
    return path


@pytest.mark.parametrize('seed', range(4))
def test_given_messages_of_many_shapes_when_read_many_at_a_time_then_it_is_as_one_by_one(
    tmp_path, monkeypatch, seed
):
    path = mixed(tmp_path / 'bag', seed)
    one_by_one, read = [], BagReader.deserialize
    monkeypatch.setattr(
        BagReader, 'deserialize', lambda *given: (one_by_one.append(1), read(*given))[1]
    )
    fast, few = load_run(path), len(one_by_one)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 0)
    slow = load_run(path)
    assert few < 100 < len(one_by_one) - few  # alarms are few and always one by one
    assert list(fast.streams) == list(slow.streams)
    for name, fields in slow.streams.items():
        np.testing.assert_array_equal(fast.stamps[name], slow.stamps[name])
        for field, column in fields.items():
            assert fast.streams[name][field].dtype == column.dtype == float
            np.testing.assert_array_equal(fast.streams[name][field], column)
    for attribute in ('alarms', 'counts', 'topics', 'joint_names', 'sensor_names', 'warnings'):
        assert getattr(fast, attribute) == getattr(slow, attribute)
