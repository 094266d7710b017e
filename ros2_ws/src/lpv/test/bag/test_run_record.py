"""Recorded runs as arrays: what is read is what was written, whatever order and shape it has."""

import math
import re
import shutil
from itertools import chain

import numpy as np
import pytest

from lpv.bag.errors import BagError
from lpv.bag.rosbag.interfaces import message_text
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.reading import BagReader
from lpv.bag.rosbag.writing import BagWriter
from lpv.bag.run import decoder
from lpv.bag.run.record import ALARM_TYPE, load_run
from lpv.bag.run.streams import SCALARS, STREAMS
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, Mode

EPOCH, MS = 1_700_000_000_123_456_789, 1_000_000
JOINTS, ZERO = ('joint1', 'joint2'), [0.0, 0.0]
TYPES = {name: msgtype for name, (msgtype, _) in STREAMS.items()} | {'fault_alarm': ALARM_TYPE}
FIELDS = {
    'state_estimate': {
        **dict.fromkeys(('position', 'velocity', 'compensated_position'), ZERO),
        **dict.fromkeys(('measured_position', 'measured_velocity'), ZERO),
        **{'mode': 0, 'trustworthy': True},
    },
    'fault_estimate': {
        **dict.fromkeys(('estimate', 'bound', 'threshold'), ZERO),
        **{'sensor_names': ['left', 'right'], 'state': [0, 0], 'alarm': [False, False]},
    },
    'reference': dict.fromkeys(('position', 'velocity', 'acceleration', 'tip_position'), ZERO),
    'torque_command': {'torque': ZERO, 'safe_stop': False},
    'fault_alarm': {
        **{'sensor': 'left', 'sensor_index': 0, 'event': 0, 'onset': 5 * MS, 'detected': 15 * MS},
        **{'size': 0.3, 'bound': 0.1, 'kind': 'unclassified', 'confidence': 0.99},
    },
}


def measure(stamp, position, names=JOINTS, topic='/joint_states', **others):
    zeros = dict.fromkeys(('velocity', 'effort'), [0.0] * len(names))
    return topic, stamp, {'names': names, 'position': position, **zeros, **others}


def write(path, entries, topics=()):
    """Bag of messages in the order in which they are logged: topic, stamp, fields."""
    with BagWriter(path) as writer:
        messages = BagMessages(writer.typestore, 'arm')
        for topic, msgtype in topics:
            writer.add_topic(topic, msgtype)
        for time, (topic, stamp, fields) in enumerate(entries, 1):
            name = topic.rsplit('/', 1)[-1]
            if topic not in writer.counts:
                writer.add_topic(topic, TYPES[name])
            make = messages.joint_state
            if name != 'joint_states':
                fields = {'msgtype': TYPES[name], 'fields': FIELDS[name] | fields}
                make = messages.make
            writer.write(topic, time, make(stamp=stamp, **fields))
    return path


def mixed(seed):
    """Messages of many shapes in any order, some with the stamp of another one; and what has to be
    read of them, by stream, stamp and field."""
    random, model = np.random.default_rng(seed), {}

    def pair(count=2):
        return random.normal(size=count).tolist()

    def expect(name, stamp, fields):
        row = {field: FIELDS.get(name, {}).get(field) for field in STREAMS[name][1]}
        model.setdefault(name, {})[stamp] = row | fields
        return f'/{name}', stamp, fields

    entries, alarms = [expect_measurement(expect, EPOCH, pair)], {}
    for _ in range(400):
        stamp, kind = EPOCH + int(random.integers(1, 300)) * MS, random.integers(9)
        if kind < 4:
            entries.append(expect_measurement(expect, stamp, pair, kind))
        elif kind == 4:
            entries.append(measure(stamp, pair(1), names=('finger',)))
        elif kind == 5:
            mode = int(random.integers(5))
            fields = {'position': pair(), 'mode': mode}
            no_estimate = mode == Mode.NO_ESTIMATE
            entries.append(('/state_estimate', stamp, fields) if no_estimate
                           else expect('state_estimate', stamp, fields))  # fmt: skip
        elif kind == 6:
            fields = {'estimate': pair(), 'state': [0, 4]}
            topic, *entry = expect('fault_estimate', stamp, fields)
            names = ['left', 'right'] if random.random() < 0.8 else ['l', 'r']
            entries.append((topic, entry[0], entry[1] | {'sensor_names': names}))
        elif kind == 7:
            fields = {'torque': pair(), 'safe_stop': bool(random.integers(2))}
            entries.append(expect('torque_command', stamp, fields))
        else:
            fields = {'size': pair(1)[0], 'event': int(random.integers(3))}
            alarms[stamp, fields['event']] = fields['size']
            entries.append(('/fault_alarm', stamp, fields))
    return entries, model, alarms


def expect_measurement(expect, stamp, pair, kind=0):
    """In the arm's order, or of more joints in disorder and without efforts, or of other sizes."""
    fields = {'position': pair(), 'velocity': pair(), 'effort': pair()}
    if kind == 2:
        fields['velocity'] = [math.nan] * 2
        expect('joint_states', stamp, fields)
        return measure(stamp, **(fields | {'velocity': [7.0]}))
    if kind == 3:
        fields['effort'] = [math.nan] * 2
    expect('joint_states', stamp, fields)
    if kind < 3:
        return measure(stamp, **fields)
    swapped = {n: [9.0, *v[::-1]] for n, v in fields.items()}
    return measure(stamp, names=('grip', *JOINTS[::-1]), **(swapped | {'effort': []}))


@pytest.mark.parametrize('seed', range(4))
def test_given_messages_of_any_order_and_shape_when_loaded_then_rows_are_the_last_of_each_stamp(
    tmp_path, monkeypatch, seed
):
    entries, model, alarms = mixed(seed)
    write(tmp_path / 'bag', entries)
    decoded, read = [], BagReader.deserialize
    monkeypatch.setattr(
        BagReader, 'deserialize', lambda *given: (decoded.append(1), read(*given))[1]
    )
    fast, few = load_run(tmp_path / 'bag'), len(decoded)
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', 0)
    slow = load_run(tmp_path / 'bag')
    assert few < 100 < len(decoded) - few  # alarms are few and always one by one
    for record in (fast, slow):
        assert set(record.streams) == set(model)
        for name, rows in model.items():
            assert record.stamps[name].tolist() == sorted(rows)
            assert record.stamps[name].dtype == np.int64
            for field in STREAMS[name][1]:
                expected = [rows[stamp][field] for stamp in sorted(rows)]
                found = record.get(name, field)
                assert found.dtype == float and found.ndim == 1 + (field not in SCALARS)
                np.testing.assert_array_equal(found, np.array(expected, float), field)
        estimate = record.aligned('fault_estimate', 'estimate')
        for row, stamp in zip(estimate, record.stamps['joint_states'].tolist()):
            fault = model['fault_estimate'].get(stamp, {'estimate': [math.nan] * 2})
            np.testing.assert_array_equal(row, fault['estimate'])
        first = next(fields for topic, _, fields in entries if topic == '/fault_estimate')
        assert record.joint_names == JOINTS
        assert list(record.sensor_names) == first['sensor_names']
        found = {(alarm.stamp, alarm.event): alarm.size for alarm in record.alarms}
        assert found == alarms and list(found) == sorted(found)
        assert record.counts['/joint_states'] == sum(e[0] == '/joint_states' for e in entries)
        assert record.time[0] == 0.0 and record.seconds(EPOCH - 1) == -1e-9
        assert record.get('ground_truth', 'fault') is record.aligned('reference', 'position')
    assert fast.warnings == slow.warnings
    assert sum('last one of each stamp counts' in text for text in fast.warnings) >= 3


def test_given_time_that_goes_backwards_or_stands_still_when_loaded_then_it_is_said(tmp_path):
    (one, two) = load_run(
        write(tmp_path / 'a', [measure(t, ZERO) for t in (1, 5, 3, 9, 9, 2)])
    ).warnings
    assert one == '/joint_states: time goes backwards 2 times, messages are sorted by their stamps'
    assert two.startswith('/joint_states: 1 messages have the stamp of another one, the last')
    assert load_run(write(tmp_path / 'b', [measure(t, ZERO) for t in range(9)])).warnings == []


def test_given_wanted_joints_when_loaded_then_they_are_taken_in_that_order(tmp_path):
    names = tuple(f'j{i}' for i in range(7))
    arrays = dict.fromkeys(('estimate', 'bound', 'threshold'), np.arange(7.0))
    fault = {**arrays, 'sensor_names': names, 'state': [0] * 7, 'alarm': [False] * 7}
    pairs = [(measure(k, np.arange(7.0), names), ('/fault_estimate', k, fault)) for k in (1, 2)]
    bag = write(tmp_path / 'bag', chain(*pairs))
    whole, part = load_run(bag), load_run(bag, joint_names=('j5', 'j2'))
    assert whole.joint_names == whole.sensor_names == names
    np.testing.assert_array_equal(whole.get('fault_estimate', 'estimate'), [np.arange(7.0)] * 2)
    assert part.joint_names == ('j5', 'j2')
    assert part.get('joint_states', 'position').tolist() == [[5, 2]] * 2
    with pytest.raises(BagError, match="'elbow' .*j0, j1"):
        load_run(bag, joint_names=('j1', 'elbow'))


def test_given_one_joint_when_loaded_then_its_columns_stay_columns(tmp_path):
    torque = {'torque': [2.0]}
    pairs = [(measure(k, [0.5], ('j',)), ('/torque_command', k, torque)) for k in range(3)]
    record = load_run(write(tmp_path / 'bag', chain(*pairs)))
    assert record.get('torque_command', 'torque').shape == (3, 1)
    assert record.get('torque_command', 'safe_stop').shape == (3,)


@pytest.mark.parametrize('attempts', [0, 32])
def test_given_arrays_that_do_not_fit_when_loaded_then_they_are_left_out_with_a_warning(
    tmp_path, monkeypatch, attempts
):
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    entries = []
    for k in range(4):
        entries += [measure(k, ZERO), ('/torque_command', k, {'torque': [0.0] * (2 + (k == 2))}),
                    ('/fault_estimate', k, {'bound': [0.1] * (2 if k else 1)})]  # fmt: skip
    record = load_run(write(tmp_path / 'bag', entries), joint_names=JOINTS)
    assert list(record.stamps['torque_command']) == [0, 1, 3]
    assert list(record.stamps['fault_estimate']) == [1, 2, 3]
    assert [w for w in record.warnings if 'number of joints does not fit' in w and ': 1 ' in w]


def test_given_alarms_when_loaded_then_each_is_there_once_with_all_its_fields(tmp_path):
    entries = [measure(EPOCH + k, ZERO) for k in range(2)]
    for stamp, fields in (
        (900, {'event': 2, 'size': 0.01, 'onset': EPOCH + 1, 'detected': EPOCH + 2}),
        (2, {'onset': EPOCH + 1, 'detected': EPOCH + 2}),
        (2, {'sensor': 'right', 'sensor_index': 1}),
        (2, {'sensor': 'right', 'sensor_index': 1}),  # latched: delivered again
        (50, {'event': 1, 'size': -0.5, 'kind': 'bias', 'confidence': 0.5}),
    ):
        entries.append(('/fault_alarm', EPOCH + stamp, fields))
    record = load_run(write(tmp_path / 'bag', entries))
    alarms = record.alarms
    assert [(a.stamp - EPOCH, a.event, a.sensor) for a in alarms] == [
        (2, AlarmEvent.RAISED, 'left'),
        (2, AlarmEvent.RAISED, 'right'),
        (50, AlarmEvent.UPDATED, 'left'),
        (900, AlarmEvent.CLEARED, 'left'),
    ]
    assert (alarms[0].onset, alarms[0].detected) == (EPOCH + 1, EPOCH + 2)
    assert (alarms[1].sensor_index, alarms[1].bound) == (1, 0.1)
    assert (alarms[2].size, alarms[2].kind, alarms[2].confidence) == (-0.5, 'bias', 0.5)
    assert record.counts['/fault_alarm'] == 5
    bad = write(tmp_path / 'bad', [*entries, ('/fault_alarm', EPOCH, {'event': 7})])
    with pytest.raises(BagError, match='unknown event 7'):
        load_run(bad)


@pytest.mark.parametrize('stamps', [(), (5,), (5, 5, 5)])
def test_given_fewer_than_two_measurements_when_loaded_then_the_error_says_so(tmp_path, stamps):
    topics = [] if stamps else [('/joint_states', TYPES['joint_states'])]
    bag = write(tmp_path / 'bag', [measure(stamp, ZERO) for stamp in stamps], topics)
    with pytest.raises(BagError, match='bag: .*/joint_states'):
        load_run(bag)


def test_given_two_arms_when_loaded_then_a_namespace_tells_them_apart(tmp_path):
    entries = []
    for k in range(3):
        for i, name in enumerate(('/a', '/b/c')):
            entries.append(measure(k, [i, i], topic=f'{name}/joint_states'))
            entries.append((f'{name}/fault_estimate', k, {'estimate': [i, k]}))
    bag = write(tmp_path / 'bag', entries, [('/a/fault_alarm', ALARM_TYPE)])
    with pytest.raises(BagError, match='/a/joint_states, /b/c/joint_states.*namespace'):
        load_run(bag)
    (storage,) = bag.glob('*.mcap')
    for place in (bag, shutil.copy(storage, tmp_path / 'alone.mcap')):
        for i, name in enumerate(('a', '/b/c/')):
            record = load_run(place, namespace=name)
            assert record.get('joint_states', 'position')[:, 0].tolist() == [i] * 3
            assert record.get('fault_estimate', 'estimate')[:, 0].tolist() == [i] * 3
            assert (record.alarms, record.counts['/a/fault_alarm']) == ([], 0)
    with pytest.raises(BagError, match='namespace /c'):
        load_run(bag, namespace='/c')


@pytest.mark.parametrize('attempts', [0, 32])
def test_given_messages_without_efforts_that_end_in_padding_when_loaded_then_they_are_read(
    tmp_path, monkeypatch, attempts
):
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    kind = TYPES['joint_states']
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/joint_states', kind)
        for k in range(3):
            message = BagMessages(writer.typestore, 'arm').joint_state(k, JOINTS, [k, 1], ZERO, [])
            data = bytes(writer.typestore.serialize_cdr(message, kind))
            padded = data + bytes(-len(data) % 4)
            assert writer.without_garbage(kind, padded + b'junk') == padded
            writer.write_raw('/joint_states', k, padded + b'junk')
    record = load_run(tmp_path / 'bag')
    assert list(record.get('joint_states', 'position')[:, 0]) == [0, 1, 2]
    assert np.isnan(record.get('joint_states', 'effort')).all()


def test_given_a_bag_whose_arrays_have_a_fixed_length_when_loaded_then_it_is_as_ever(
    tmp_path, monkeypatch
):
    def as_before(msgtype):
        text = message_text(msgtype)
        return re.sub(r'^(\w+)\[\] ', r'\1[2] ', text, flags=re.M) if 'lpv' in msgtype else text

    monkeypatch.setattr('lpv.bag.rosbag.interfaces.message_text', as_before)
    faults = [('/fault_estimate', k, {'estimate': [k, 0.5]}) for k in range(3)]
    bag = write(tmp_path / 'bag', [*(measure(k, ZERO) for k in range(3)), *faults])
    monkeypatch.undo()
    assert b'float64[2] estimate' in next(bag.glob('*.mcap')).read_bytes()
    record = load_run(bag)
    np.testing.assert_array_equal(record.get('fault_estimate', 'estimate')[:, 0], range(3))


@pytest.mark.parametrize('wrong', ['velocity of .*JointState has another', 'hash'])
def test_given_another_definition_of_a_type_when_loaded_then_the_error_says_so(
    tmp_path, monkeypatch, wrong
):
    with BagWriter(tmp_path / 'bag') as writer:
        types, kind = writer.typestore, TYPES['joint_states']
        text, digest = types.generate_msgdef(kind, ros_version=2)
        if wrong != 'hash':
            text = text.replace('float64[] velocity', 'float32[] velocity')
        monkeypatch.setattr(types, 'generate_msgdef', lambda *_, **__: (text, digest))
        monkeypatch.setattr(
            types, 'hash_rihs01', lambda _: 'RIHS01_' + '0' * 64 if wrong == 'hash' else ''
        )
        writer.add_topic('/joint_states', kind)
        writer.write_raw('/joint_states', 1, bytes(60))
    with pytest.raises(BagError, match=f'bag: .*{wrong}'):
        load_run(tmp_path / 'bag')
