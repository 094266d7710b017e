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
from lpv.bag.rosbag.writing import BagWriter, padded_cdr
from lpv.bag.run import decoder
from lpv.bag.run.record import ALARM_TYPE, load_run
from lpv.bag.run.streams import SCALARS, STREAMS
from lpv.core.serial_arm.diagnosis.alarms import Mode

EPOCH, MS = 1_700_000_000_123_456_789, 1_000_000
JOINTS, SENSORS, ZERO = ('joint1', 'joint2'), ['left', 'right'], [0.0, 0.0]
TYPES = {name: msgtype for name, (msgtype, _) in STREAMS.items()} | {'fault_alarm': ALARM_TYPE}


def zeros(*names, **others):
    return dict.fromkeys(names, ZERO) | others


FIELDS = {
    'state_estimate': zeros(*STREAMS['state_estimate'][1], mode=0, trustworthy=True),
    'fault_estimate': zeros(
        'estimate', 'bound', 'threshold', sensor_names=SENSORS, state=[0, 0], alarm=[False, False]
    ),
    'reference': zeros(*STREAMS['reference'][1]),
    'torque_command': zeros('torque', safe_stop=False),
    'fault_alarm': {
        **{'sensor': 'left', 'sensor_index': 0, 'event': 0, 'onset': 5 * MS, 'detected': 15 * MS},
        **{'size': 0.3, 'bound': 0.1, 'kind': 'unclassified', 'confidence': 0.99},
    },
}
VECTORS = ('position', 'velocity', 'effort')
JUNK = b'junk'
"""Behind measurements without efforts: some serialisers pad with what was in memory."""


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
            if name == 'joint_states':
                message = messages.joint_state(stamp, **fields)
            else:
                message = messages.make(TYPES[name], stamp, FIELDS[name] | fields)
            data = padded_cdr(writer.typestore, message, TYPES[name])
            writer.write_raw(topic, time, data if fields.get('effort', True) else data + JUNK)
    return path


def mixed(seed):
    """Messages of many shapes in any order, some with the stamp of another one; and what has to be
    read of them: rows by stream and stamp, alarms by stamp, sensor and event."""
    random, entries, model, alarms = np.random.default_rng(seed), [], {}, {}

    def pair(count=2):
        return random.normal(size=count).tolist()

    def add(name, stamp, fields, **sent):
        """A message; what is sent otherwise than it is to be read comes last."""
        row = {field: FIELDS.get(name, {}).get(field) for field in STREAMS[name][1]}
        model.setdefault(name, {})[stamp] = row | fields
        entries.append((f'/{name}', stamp, fields | sent))

    for k in range(400):
        stamp = EPOCH + int(random.integers(1, 300)) * MS if k else EPOCH
        kind = random.integers(9) if k else 0
        if kind < 4:
            fields, sent = {name: pair() for name in VECTORS}, {'names': JOINTS}
            if kind == 2:
                fields['velocity'], sent['velocity'] = [math.nan] * 2, [7.0]
            elif kind == 3:  # more joints, in disorder, and no efforts
                sent = {name: [9.0, *values[::-1]] for name, values in fields.items()}
                sent |= {'names': ('grip', *JOINTS[::-1]), 'effort': []}
                fields['effort'] = [math.nan] * 2
            add('joint_states', stamp, fields, **sent)
        elif kind == 4:
            entries.append(measure(stamp, pair(1), names=('finger',)))
        elif kind == 5:
            fields = {'position': pair(), 'mode': int(random.integers(5))}
            if fields['mode'] == Mode.NO_ESTIMATE:
                entries.append(('/state_estimate', stamp, fields))
            else:
                add('state_estimate', stamp, fields)
        elif kind == 6:
            names = SENSORS if random.random() < 0.8 else ['l', 'r']
            fields = {'estimate': pair(), 'state': [0, 4]}
            add('fault_estimate', stamp, fields, sensor_names=names)
        elif kind == 7:
            fields = {'torque': pair(), 'safe_stop': bool(random.integers(2))}
            add('torque_command', stamp, fields)
        else:
            onset, sensor, event = (int(n) for n in random.integers((1, 0, 0), (EPOCH, 2, 3)))
            fields = dict(zip(('size', 'bound', 'confidence'), pair(3)))
            fields |= {'sensor': SENSORS[sensor], 'sensor_index': sensor, 'event': event}
            fields |= {'onset': onset, 'detected': onset + MS, 'kind': ('bias', 'drift')[sensor]}
            alarms[stamp, sensor, event] = fields
            # Latched events are delivered again.
            entries += [('/fault_alarm', stamp, fields)] * (1 + sensor)
    return entries, model, alarms


@pytest.mark.parametrize('seed', range(4))
def test_given_any_messages_when_loaded_then_rows_are_the_last_ones(tmp_path, monkeypatch, seed):
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
        keys = [(alarm.stamp, alarm.sensor_index, alarm.event) for alarm in record.alarms]
        assert keys == sorted(alarms)
        for key, alarm in zip(keys, record.alarms):
            assert {name: getattr(alarm, name) for name in alarms[key]} == alarms[key]
        for topic in ('/joint_states', '/fault_alarm'):
            assert record.counts[topic] == sum(entry[0] == topic for entry in entries)
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
def test_given_arrays_that_do_not_fit_when_loaded_then_it_is_said(tmp_path, monkeypatch, attempts):
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    entries = []
    for k in range(4):
        entries += [measure(k, ZERO), ('/torque_command', k, {'torque': [0.0] * (2 + (k == 2))}),
                    ('/fault_estimate', k, {'bound': [0.1] * (2 if k else 1)})]  # fmt: skip
    record = load_run(write(tmp_path / 'bag', entries), joint_names=JOINTS)
    assert list(record.stamps['torque_command']) == [0, 1, 3]
    assert list(record.stamps['fault_estimate']) == [1, 2, 3]
    assert [w for w in record.warnings if 'number of joints does not fit' in w and ': 1 ' in w]


REST = [measure(k, ZERO) for k in range(2)]


@pytest.mark.parametrize(
    ('entries', 'told'),
    [
        ([], '/joint_states'),
        ([measure(5, ZERO)], '/joint_states'),
        ([measure(5, ZERO)] * 3, '/joint_states'),
        ([*REST, ('/fault_alarm', 0, {'event': 7})], 'unknown event 7'),
    ],
)
def test_given_too_little_or_an_unknown_event_when_loaded_then_it_is_said(tmp_path, entries, told):
    bag = write(tmp_path / 'bag', entries, [('/joint_states', TYPES['joint_states'])])
    with pytest.raises(BagError, match=f'bag: .*{told}'):
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


def test_given_arrays_of_fixed_length_when_loaded_then_it_is_as_ever(tmp_path, monkeypatch):
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
def test_given_another_definition_when_loaded_then_the_error_says_so(tmp_path, monkeypatch, wrong):
    with BagWriter(tmp_path / 'bag') as writer:
        types, kind = writer.typestore, TYPES['joint_states']
        text, digest = types.generate_msgdef(kind, ros_version=2)
        if wrong != 'hash':
            text = text.replace('float64[] velocity', 'float32[] velocity')
        said = 'RIHS01_' + '0' * 64 if wrong == 'hash' else ''
        monkeypatch.setattr(types, 'generate_msgdef', lambda *_, **__: (text, digest))
        monkeypatch.setattr(types, 'hash_rihs01', lambda _: said)
        writer.add_topic('/joint_states', kind)
        writer.write_raw('/joint_states', 1, bytes(60))
    with pytest.raises(BagError, match=f'bag: .*{wrong}'):
        load_run(tmp_path / 'bag')
