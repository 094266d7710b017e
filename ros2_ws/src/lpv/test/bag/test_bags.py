import json
import math
import re
import resource
import shutil
from itertools import chain
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
import zstandard
from bag_messages import CHATTER, JOINT_STATE, JOINTS, START, STEP, STRING, TYPESTORE, cdr, text
from bags import KINDS, TOPICS, contents, storage, write_by_mcap, write_by_rosbags, write_small
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from lpv import Alarm, ConfigError
from lpv.bag.blocks import cdr_layout, message_blocks
from lpv.bag.errors import BagError, DamageError
from lpv.bag.replay.writer import RecordTemplate
from lpv.bag.rosbag import message_loss, reading
from lpv.bag.rosbag.interfaces import message_text, padded_cdr, standard_types
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import RECORD_NAME
from lpv.bag.rosbag.reading import BagReader, open_bag
from lpv.bag.rosbag.recovery import recover
from lpv.bag.rosbag.writing import PRESETS, BagWriter
from lpv.bag.run import decoder
from lpv.bag.run.record import ALARM_TYPE, SCALARS, STREAMS, load_run
from lpv.core.monitoring.message_fields import alarm_fields
from lpv.core.serial_arm.diagnosis.alarms import Mode

EPOCH, MS = 1_700_000_000_123_456_789, 1_000_000
VECTORS = ('position', 'velocity', 'effort')
PAIR, SENSORS, ZERO = ('joint1', 'joint2'), ['left', 'right'], [0.0, 0.0]
TYPES = {name: msgtype for name, (msgtype, _) in STREAMS.items()} | {'fault_alarm': ALARM_TYPE}
FIELDS = {name: dict.fromkeys(fields, ZERO) for name, (_, fields) in STREAMS.items()}
FIELDS['state_estimate'] |= {'mode': 0, 'trustworthy': True}
FIELDS['fault_estimate'] |= {'sensor_names': SENSORS, 'state': [0, 0], 'alarm': [False, False]}
FIELDS['torque_command'] |= {'safe_stop': False}
FIELDS['fault_alarm'] = alarm_fields(Alarm(0, 0, 'left', 5 * MS, 15 * MS, 0.3, 0.1, 'bias', 0.99))
JUNK = b'junk'
"""Behind measurements without efforts: some serialisers pad with what was in memory."""


def by_rosbags(path, wanted=tuple(TOPICS), **limits):
    with AnyReader([path]) as reader:
        chosen = [c for c in reader.connections if c.topic in wanted]
        return [(c.topic, time, bytes(data)) for c, time, data in reader.messages(chosen, **limits)]


def by_blocks(path, wanted=tuple(TOPICS), **limits):
    with open_bag(path) as reader:
        chosen = [c for c in reader.connections if c.topic in wanted]
        found = [(c.topic, time, data) for c, time, data in reader.messages(chosen, **limits)]
        assert reader.warnings == []
        return found


def information(bag):
    return yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


def measurement(stamp, names=PAIR, values=([0.1, 0.2], [0.3, math.nan], [])):
    return BagMessages(TYPESTORE, 'base_link').joint_state(stamp, names, *values)


def test_given_a_bag_when_written_then_the_file_is_in_the_profile_of_ros2(tmp_path):
    known = {JOINTS: {'lost': 3, 'late': 1, 'gaps': 0}}
    bag = write_small(tmp_path / 'bag', known=known)
    with open(storage(bag), 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert (header.profile, summary.statistics.message_count) == ('ros2', 24)
    schemas = {(s.name, s.encoding) for s in summary.schemas.values()}
    assert schemas == {(JOINT_STATE, 'ros2msg'), (STRING, 'ros2msg')}
    channel = next(c for c in summary.channels.values() if c.topic == JOINTS)
    assert channel.message_encoding == 'cdr'
    (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    known_profile = {'reliability': 'reliable', 'history': 'keep_last', 'depth': 10}
    assert profile.items() >= known_profile.items()
    inner, outer = yaml.safe_load(metadata['rosbag2']['serialized_metadata']), information(bag)
    assert inner['version'] == outer['version'] == 9
    assert (outer['storage_identifier'], outer['duration']['nanoseconds']) == ('mcap', 19 * STEP)
    (topic, _), digest = outer['topics_with_message_count'], channel.metadata['topic_type_hash']
    assert topic['message_count'] == 20
    # The hash of the release that everyone has.
    assert digest.startswith('RIHS01_a13ee3a330e346c9d87b5aa18d24e1')
    assert topic['topic_metadata']['type_description_hash'] == digest
    assert json.loads(outer['custom_data'][RECORD_NAME]) == known
    with open_bag(bag) as reader:
        assert reader.known == known
        assert (reader.start_time, reader.end_time) == (START, START + 19 * STEP + 1)
        assert {JOINT_STATE, STRING} <= set(reader.typestore.fielddefs)


@pytest.mark.parametrize('options', [{'split_size': 1000}, {'split_time': 10 * MS}])
def test_given_a_limit_when_written_then_the_bag_has_several_files_and_is_one(tmp_path, options):
    bag = write_small(tmp_path / 'bag', **options)
    files = sorted((path.name for path in bag.glob('*.mcap')), key=lambda n: (len(n), n))
    assert len(files) >= 4 and files[:2] == ['bag_0.mcap', 'bag_1.mcap']
    listed = information(bag)
    assert listed['relative_file_paths'] == files
    assert sum(file['message_count'] for file in listed['files']) == 24
    if 'split_time' in options:
        assert all(file['duration']['nanoseconds'] < 10 * MS for file in listed['files'])
    assert by_rosbags(bag) == by_blocks(bag) == by_blocks(write_small(tmp_path / 'one'))
    parts = [time for name in files for _, time, _ in by_blocks(bag / name)]
    assert parts == [time for _, time, _ in by_blocks(bag)]


def test_given_garbage_or_another_type_when_copied_then_it_is_taken_out_or_refused(tmp_path):
    bag, data = write_small(tmp_path / 'a'), cdr(measurement(5, ('arm',), [[1.0], [2.0], [3.0]]))
    hole = data.index(b'base_link\0') + 10
    assert data[hole : hole + 2] == bytes(2)
    with BagWriter(tmp_path / 'b') as writer, open_bag(bag) as reader:
        for dirty in (data[:hole] + b'\xaa\xbb' + data[hole + 2 :], data + b'junk'):
            assert writer.without_garbage(JOINT_STATE, dirty) == data
        for other in (b'', b'\0\1\0\0', data[:30], b'\0\0' + data[2:]):
            assert writer.without_garbage(JOINT_STATE, other) == other
        writer.add_topic(JOINTS, STRING)
        pytest.raises(ConfigError, writer.copy_topic, reader.connections[0]).match('two types')


OTHERS = {
    'protobuf': ('foxglove.Image', 'protobuf', b'\xff\x01'),
    'json': ('sensor_msgs/msg/JointState', 'jsonschema', b'{}'),
    'cbor': None,  # without schema
    'cdr': ('my_msgs/msg/Mine', '', b''),  # of a distribution that stored no definitions
}
"""Schemas of topics that are not understood, by how their messages are encoded."""


@pytest.mark.parametrize('encoding', OTHERS)
def test_given_a_topic_of_any_kind_when_recovered_then_it_is_copied(tmp_path, encoding):
    content = [(CHATTER, START, text('abc')), ('/other', START + 1, b'any bytes')]
    with open(tmp_path / 'a.mcap', 'wb') as file:
        writer = McapWriter(file)
        writer.start()
        definition = TYPESTORE.generate_msgdef(STRING, ros_version=2)[0].encode()
        channels = {CHATTER: (STRING, 'ros2msg', definition, 'cdr')}
        channels['/other'] = (*(OTHERS[encoding] or ('', '', b'')), encoding)
        for topic, time, data in content:
            *schema, how = channels[topic]
            known = writer.register_schema(*schema) if schema[0] else 0
            channel = writer.register_channel(topic, how, known)
            writer.add_message(channel, time, data, time)
        writer.finish()
    assert recover(tmp_path / 'a.mcap', tmp_path / 'new').nothing_lost
    assert contents(tmp_path / 'new') == (content, [])
    (new,) = (tmp_path / 'new').glob('*.mcap')
    with open(new, 'rb') as file:
        found = {c.topic: (s, c) for s, c, _ in make_reader(file).iter_messages()}
    schema, channel = found['/other']
    assert channel.message_encoding == encoding
    assert (schema and (schema.name, schema.encoding, schema.data)) == OTHERS[encoding]
    if encoding == 'json':
        pytest.raises(BagError, load_run, new, '/other').match("encoded as 'json'")


@pytest.mark.parametrize('room', [0, 2800, 4000, 4200, 5000, 6000, 10_000, 10_300])
def test_given_a_disk_that_gets_full_when_writing_then_chunks_before_can_be_read(tmp_path, room):
    bag = tmp_path / 'bag'
    writer = BagWriter(bag, chunk_time=10 * MS)
    messages, header, free = BagMessages(writer.typestore, 'arm'), writer.size, writer.room()
    writer.add_topic(JOINTS, JOINT_STATE)
    # Files of this process get no larger, as on a disk that is full.
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        assert writer.room() < room - header < free
        with pytest.raises(OSError, match='too large'):
            for stamp in range(START, START + 10_000 * STEP, STEP):
                message = messages.joint_state(stamp, ('a',), [1.0], [0.0], [0.0])
                writer.write(JOINTS, stamp, message)
        assert 'too large' in writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert storage(bag).stat().st_size <= max(room, header)
    if room == 0:
        pytest.raises(BagError, contents, bag).match('nothing in it can be recovered')
        return
    found, warnings = contents(bag)
    assert len(found) >= (room - 3200) // 180
    assert [time for _, time, _ in found] == [START + k * STEP for k in range(len(found))]
    assert any('not finished' in text for text in warnings)


def test_given_an_error_when_a_bag_is_written_then_half_of_it_is_not_left(tmp_path):
    for kind in (ValueError, KeyboardInterrupt):
        with pytest.raises(kind), BagWriter(tmp_path / 'bag') as writer:
            writer.add_topic('/text', STRING)
            raise kind
        assert not (tmp_path / 'bag').exists()


def test_given_a_disk_that_fails_twice_when_closed_then_the_first_error_is_told(tmp_path):
    full, broken = OSError(28, 'No space left'), OSError(5, 'Input/output error')
    fail = Mock(side_effect=[full, broken, broken])
    with pytest.raises(ConfigError, match='whole: .*No space'), BagWriter(tmp_path / 'a') as writer:
        writer.add_topic(JOINTS, JOINT_STATE)
        writer.write_raw(JOINTS, START, cdr(measurement(0)))
        writer.flush()
        file = writer._file.output.file
        file.write = file.truncate = file.close = fail
        writer.write_raw(JOINTS, START + STEP, cdr(measurement(1)))
    assert len(contents(tmp_path / 'a')[0]) == 1 and fail.call_count == 3


def test_given_numbers_with_gaps_and_old_stamps_when_counted_then_lost_and_late_ones_are_known():
    count = message_loss.TopicCount()
    # 7 and 8 were lost, then 8 came; 2 was published before anybody listened.
    heard = {b'c': (3, 2), b'a': (5, 6, 9, 8), b'b': (100, 101), None: (None,)}
    for publisher, numbers in heard.items():
        for number in numbers:
            count.take(publisher, number)
    for stamp in (1, 2, 5, 3, 4, 5, 6):
        count.stamp(stamp)
    assert count.known() == {'messages': 9, 'lost': 1, 'late': 2}


def entries(disorder=0):
    """Topic, log time and bytes; times are out of order by as much as is asked for [ns]."""
    rng = np.random.default_rng(1)
    for k in range(400):
        time = 10_000 + 10 * k + int(rng.integers(2 * disorder + 1))
        yield JOINTS, time, cdr(measurement(k, values=rng.normal(size=(3, 2))))
        if k % 7 == 0:
            yield CHATTER, time, text('x' * int(rng.integers(0, 40)))


@pytest.mark.parametrize('size', [5000, 2 << 20])
@pytest.mark.parametrize('kind', KINDS)
def test_given_any_file_when_read_then_it_is_as_by_rosbags(tmp_path, monkeypatch, kind, size):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
    path = write_by_mcap(tmp_path / 'a.mcap', entries(), **KINDS[kind])
    assert by_blocks(path, (CHATTER,)) == by_rosbags(path, (CHATTER,))
    for limits in ({}, {'start': 11_000}, {'stop': 12_345}, {'start': 11_111, 'stop': 13_000}):
        assert by_blocks(path, **limits) == by_rosbags(path, **limits)


@pytest.mark.parametrize('plugin', StoragePlugin)
@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_given_a_bag_that_rosbag2_compressed_then_it_or_its_folder_is_read(tmp_path, mode, plugin):
    content = [(JOINTS, START + k * STEP, bytes([0, 1, 0, 0, k])) for k in range(9)]
    bag = write_by_rosbags(tmp_path / 'bag', content, plugin, mode)
    assert contents(bag) == (content, [])
    (file,) = set(bag.iterdir()) - {bag / 'metadata.yaml'}
    pytest.raises(BagError, contents, file).match('is compressed by rosbag2: give the folder')


@pytest.mark.parametrize('disorder', [15, 400, 1_000_000])
def test_given_chunks_that_overlap_when_read_then_times_are_sorted(tmp_path, monkeypatch, disorder):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 5000)
    content = list(entries(disorder))
    path = write_by_mcap(tmp_path / 'a.mcap', content)
    assert by_blocks(path) == sorted(content, key=lambda entry: entry[1])
    monkeypatch.setattr(reading, '_LARGEST_GROUP', 20_000)
    if disorder == 1_000_000:
        pytest.raises(BagError, by_blocks, path).match('overlap in time')


def test_given_bytes_that_are_no_records_when_split_then_it_is_damage():
    good, short = (b'\x05' + bytes([size]) + bytes(29) for size in (22, 21))
    assert len(message_blocks.split(good)[0]) == 1
    head = good[:9] + b'\x39\x30' + bytes(4)  # channel 12345
    latest, beyond = (
        head + time.to_bytes(8, 'little') + bytes(8) for time in (2**63 - 2, 2**63 - 1)
    )
    block = message_blocks.split(good + latest)[0]
    assert block.connection.tolist() == [0, 12345] and block.time.tolist() == [0, 2**63 - 2]
    assert block.start.tolist() == [31, 62] and block.size.tolist() == [0, 0]
    for bad in (good[:-1], good[:5], good + good[:20], short[:-1], beyond):
        pytest.raises(DamageError, message_blocks.split, bad)


@pytest.mark.parametrize('preset', ['none', 'zstd_fast', 'zstd_small'])
def test_given_chunks_when_written_then_others_read_what_was_written_one_by_one(tmp_path, preset):
    values, times = np.random.default_rng(4).normal(size=(3, 500, 2)), 10**18 + 7 * np.arange(500)
    places = tmp_path / 'single', tmp_path / 'chunks'
    single, chunks = writers = [BagWriter(place, preset) for place in places]
    with single, chunks:
        for writer in writers:
            for topic, msgtype in TOPICS.items():
                writer.add_topic(topic, msgtype)
        zero, number = measurement(0, values=np.zeros((3, 2))), chunks.channel(JOINTS)
        template = RecordTemplate(chunks.typestore, zero, JOINT_STATE, number)
        for first in range(0, 500, 200):
            rows = range(500)[first : first + 200]
            fields = dict(zip(VECTORS, values[:, rows]))
            chunks.write_chunk(template.fill(times[rows], times[rows], fields))
            for k in rows:
                single.write(JOINTS, int(times[k]), measurement(int(times[k]), values=values[:, k]))
            for writer in writers:
                writer.write_raw(CHATTER, int(times[first]), text('a'))
    assert single.counts == chunks.counts == {JOINTS: 500, CHATTER: 3}
    one_by_one, found = map(by_blocks, places)
    assert found == by_rosbags(places[1]) and sorted(found) == sorted(one_by_one)
    with open(storage(places[1]), 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        stamps = [message.log_time for *_, message in reader.iter_messages([JOINTS])]
        said = reader.get_summary().statistics
    assert stamps == times.tolist() and said.message_count == 503
    assert (said.message_start_time, said.message_end_time) == (times[0], times[-1])


@pytest.mark.parametrize('preset', ['zstd_fast', 'zstd_small'])
def test_given_a_preset_when_chunks_are_compressed_then_at_its_level(tmp_path, preset):
    with BagWriter(tmp_path / 'bag', preset) as writer:
        writer.add_topic(CHATTER, TOPICS[CHATTER])
        writer.write_raw(CHATTER, 1, text(''.join(map(str, range(5000)))))
    with open(storage(tmp_path / 'bag'), 'rb') as stream:
        records = StreamReader(stream, emit_chunks=True).records
        (chunk,) = (one for one in records if isinstance(one, Chunk))
    content = zstandard.decompress(chunk.data)
    at = {name: zstandard.compress(content, PRESETS[name][2]) for name in PRESETS}
    assert chunk.data == at[preset] and at['zstd_fast'] != at['zstd_small']


def test_given_one_byte_that_differs_when_matched_then_only_numbers_and_padding_may():
    content = cdr(measurement(5))
    layout, start = cdr_layout.find_layout(content, JOINT_STATE, TYPESTORE), np.zeros(1, int)
    for at in range(len(content)):
        changed = np.frombuffer(content, np.uint8).copy()
        changed[at] ^= 1
        try:
            other = TYPESTORE.deserialize_cdr(changed.tobytes(), JOINT_STATE)
            same = list(other.name) == ['joint1', 'joint2'] and other.header.frame_id == 'base_link'
        except Exception:
            same = False
        if layout.match(changed, start, np.array([len(content)]))[0]:
            assert same
            back = layout.read(changed, start, 'position')[0]
            np.testing.assert_array_equal(back, other.position)
    for bad in (b'', b'\0\1', bytes(11), b'\0\0' + content[2:]):
        assert cdr_layout.find_layout(bad, JOINT_STATE, TYPESTORE) is None


def measure(stamp, position, names=PAIR, topic='/joint_states', **others):
    zeros = dict.fromkeys(('velocity', 'effort'), [0.0] * len(names))
    return topic, stamp, {'names': names, 'position': position, **zeros, **others}


def write(path, entries, topics=()):
    """Bag of messages in the order in which they are logged: topic, stamp, fields."""
    with BagWriter(path) as writer:
        messages = BagMessages(writer.typestore, 'arm')
        for topic, msgtype in topics:
            writer.add_topic(topic, msgtype)
        for time, (topic, stamp, fields) in enumerate(entries, 1):
            name = 'joint_states' if 'names' in fields else topic.rsplit('/', 1)[-1]
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
        row = {field: FIELDS[name][field] for field in STREAMS[name][1]}
        model.setdefault(name, {})[stamp] = row | fields
        entries.append((f'/{name}', stamp, fields | sent))

    for k in range(400):
        stamp = EPOCH + int(random.integers(1, 300)) * MS if k else EPOCH
        kind = random.integers(9) if k else 0
        if kind < 4:
            fields, sent = {name: pair() for name in VECTORS}, {'names': PAIR}
            if kind == 2:  # of one of the joints alone: nobody knows of which
                entries.append(('/joint_states', stamp, fields | sent | {'velocity': [7.0]}))
                continue
            if kind == 3:  # more joints, in disorder, and no efforts
                sent = {name: [9.0, *values[::-1]] for name, values in fields.items()}
                sent |= {'names': ('grip', *PAIR[::-1]), 'effort': []}
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
            safe_stop = bool(random.integers(2))
            add('torque_command', stamp, {'torque': pair(), 'safe_stop': safe_stop})
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
    monkeypatch.setattr(BagReader, 'deserialize', lambda *a: (decoded.append(1), read(*a))[1])
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
        assert record.joint_names == PAIR and list(record.sensor_names) == first['sensor_names']
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
    def warnings(name, stamps):
        return load_run(write(tmp_path / name, (measure(t, ZERO) for t in stamps))).warnings

    one, two = warnings('a', (1, 5, 3, 9, 9, 2))
    assert one == '/joint_states: time goes backwards 2 times, messages are sorted by their stamps'
    assert two.startswith('/joint_states: 1 messages have the stamp of another one, the last')
    assert warnings('b', range(9)) == []


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
    pytest.raises(BagError, load_run, bag, joint_names=('j1', 'elbow')).match("'elbow' .*j0, j1")
    # The columns of one joint stay columns.
    torque = {'torque': [2.0]}
    pairs = [(measure(k, [0.5], ('j',)), ('/torque_command', k, torque)) for k in range(3)]
    record = load_run(write(tmp_path / 'one', chain(*pairs)))
    assert record.get('torque_command', 'torque').shape == (3, 1)
    assert record.get('torque_command', 'safe_stop').shape == (3,)


@pytest.mark.parametrize('attempts', [0, 32])
def test_given_arrays_that_do_not_fit_when_loaded_then_it_is_said(tmp_path, monkeypatch, attempts):
    monkeypatch.setattr(decoder, '_MOST_ATTEMPTS', attempts)
    entries = []
    for k in range(4):
        entries += [measure(k, ZERO), measure(9, ZERO, velocity=[0.0]), measure(9, [0.0] * 3),
                    ('/torque_command', k, {'torque': [0.0] * (2 + (k == 2))}),
                    ('/fault_estimate', k, {'bound': [0.1] * (2 if k else 1)})]  # fmt: skip
    record = load_run(write(tmp_path / 'bag', entries), joint_names=PAIR)
    assert list(record.stamps['torque_command']) == [0, 1, 3]
    assert list(record.stamps['fault_estimate']) == [1, 2, 3]
    assert list(record.stamps['joint_states']) == [0, 1, 2, 3]
    left_out = [w.split()[:2] for w in record.warnings if 'number of joints does not fit' in w]
    counts = {'/joint_states:': '8', '/torque_command:': '1', '/fault_estimate:': '1'}
    assert left_out == [list(one) for one in counts.items()]


@pytest.mark.parametrize('stamps', [[], [5], [5, 5, 5], [0, 1]])
def test_given_too_little_or_an_unknown_event_when_loaded_then_it_is_said(tmp_path, stamps):
    entries, enough = [measure(k, ZERO) for k in stamps], len({*stamps}) > 1
    entries += [('/fault_alarm', 0, {'event': 7})] * enough
    bag = write(tmp_path / 'bag', entries, [('/joint_states', TYPES['joint_states'])])
    told = 'unknown event 7' if enough else '/joint_states'
    pytest.raises(BagError, load_run, bag).match(f'bag: .*{told}')


def test_given_two_arms_when_loaded_then_their_measurements_tell_them_apart(tmp_path):
    entries = []
    for k in range(3):
        for i, name in enumerate(('/a', '/b/c')):
            entries.append(measure(k, [i, i], topic=f'{name}/joint_states'))
            entries.append((f'{name}/fault_estimate', k, {'estimate': [i, k]}))
    bag = write(tmp_path / 'bag', entries, [('/a/fault_alarm', ALARM_TYPE)])
    told = 'carry the joints joint1, joint2: /a/joint_states, /b/c/joint_states; .*--topic'
    pytest.raises(BagError, load_run, bag).match(told)
    for place in (bag, shutil.copy(storage(bag), tmp_path / 'alone.mcap')):
        for i, name in enumerate(('/a', '/b/c')):
            record = load_run(place, f'{name}/joint_states')
            assert record.get('joint_states', 'position')[:, 0].tolist() == [i] * 3
            assert record.get('fault_estimate', 'estimate')[:, 0].tolist() == [i] * 3
            assert (record.alarms, record.counts['/a/fault_alarm']) == ([], 0)
    pytest.raises(BagError, load_run, bag, '/c/joint_states').match("no topic '/c/joint_states'")


def test_given_a_gripper_on_a_topic_of_its_own_when_loaded_then_the_joints_choose(tmp_path):
    entries = []
    for k in range(3):
        entries.append(measure(k, [0.5], ['finger'], topic='/gripper/joint_states'))
        entries += [measure(k, [0.7], ['finger']), measure(k, [k, k])]
    bag = write(tmp_path / 'bag', entries)
    record = load_run(bag, joint_names=PAIR)
    assert record.get('joint_states', 'position')[:, 0].tolist() == [0.0, 1.0, 2.0]
    told = r'/gripper/joint_states \(finger\), /joint_states \(finger, joint1, joint2\)'
    for joints in (None, ('elbow',)):
        pytest.raises(BagError, load_run, bag, joint_names=joints).match(told)
    # Whatever it is called.
    others = [measure(k, ZERO, topic='/arm/measured') for k in range(3)]
    bag = write(tmp_path / 'other', [*(measure(k, [0.5], ['finger']) for k in range(3)), *others])
    assert load_run(bag, joint_names=PAIR).topics['joint_states'] == '/arm/measured'


def test_given_arrays_of_fixed_length_when_loaded_then_it_is_as_ever(tmp_path, monkeypatch):
    def as_before(msgtype):
        text = message_text(msgtype)
        return re.sub(r'^(\w+)\[\] ', r'\1[2] ', text, flags=re.M) if 'lpv' in msgtype else text

    monkeypatch.setattr('lpv.bag.rosbag.interfaces.message_text', as_before)
    monkeypatch.setattr('lpv.bag.rosbag.writing.standard_types', standard_types.__wrapped__)
    entries = [(measure(k, ZERO), ('/fault_estimate', k, {'estimate': [k, 0.5]})) for k in range(3)]
    bag = write(tmp_path / 'bag', chain(*entries))
    monkeypatch.undo()
    assert b'float64[2] estimate' in storage(bag).read_bytes()
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
    pytest.raises(BagError, load_run, tmp_path / 'bag').match(f'bag: .*{wrong}')
