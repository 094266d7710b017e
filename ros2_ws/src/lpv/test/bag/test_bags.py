"""Bags as files: what is written is read by others, in blocks as one by one, on a full disk too."""

import json
import math
import resource
from contextlib import contextmanager

import numpy as np
import pytest
import yaml
from bags import CHATTER, JOINT_STATE, JOINTS, START, STEP, contents, storage, write_small
from foreign_bags import KINDS, STRING, TOPICS, TYPESTORE, cdr, text, write_by_mcap
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from lpv.bag.blocks.cdr_layout import find_layout
from lpv.bag.blocks.message_blocks import split
from lpv.bag.errors import BagError, DamageError
from lpv.bag.replay.writer import RecordTemplate
from lpv.bag.rosbag import reading
from lpv.bag.rosbag.message_loss import TopicCount
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import RECORD_NAME
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.support.errors import ConfigError

MS = 1_000_000
VECTORS = ('position', 'velocity', 'effort')


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


def measurement(stamp, names=('joint1', 'joint2'), values=None, frame='base_link'):
    values = [[0.1, 0.2], [0.3, math.nan], []] if values is None else values
    return BagMessages(TYPESTORE, frame).joint_state(stamp, names, *values)


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
    offered = profile['reliability'], profile['history'], profile['depth']
    assert offered == ('reliable', 'keep_last', 10)
    inner = yaml.safe_load(metadata['rosbag2']['serialized_metadata'])
    outer = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert inner['version'] == outer['version'] == 9
    assert (outer['storage_identifier'], outer['duration']['nanoseconds']) == ('mcap', 19 * STEP)
    topic = outer['topics_with_message_count'][0]
    assert topic['message_count'] == 20
    assert topic['topic_metadata']['type_description_hash'] == channel.metadata['topic_type_hash']
    # The hash of the release that everyone has.
    assert channel.metadata['topic_type_hash'].startswith('RIHS01_a13ee3a330e346c9d87b5aa18d24e1')
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
    listed = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert listed['relative_file_paths'] == files
    assert sum(file['message_count'] for file in listed['files']) == 24
    if 'split_time' in options:
        assert all(file['duration']['nanoseconds'] < 10 * MS for file in listed['files'])
    assert by_rosbags(bag) == by_blocks(bag) == by_blocks(write_small(tmp_path / 'one'))
    parts = [time for name in files for _, time, _ in by_blocks(bag / name)]
    assert parts == [time for _, time, _ in by_blocks(bag)]


def test_given_garbage_in_a_message_when_it_is_taken_out_then_the_message_is_the_same(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        data = cdr(measurement(5, ('arm',), [[1.0], [2.0], [3.0]]))
        hole = data.index(b'base_link\0') + 10
        assert data[hole : hole + 2] == bytes(2)
        for dirty in (data[:hole] + b'\xaa\xbb' + data[hole + 2 :], data + b'junk'):
            assert writer.without_garbage(JOINT_STATE, dirty) == data
        for other in (b'', b'\0\1\0\0', data[:30], b'\0\0' + data[2:]):
            assert writer.without_garbage(JOINT_STATE, other) == other


def test_given_one_topic_with_two_types_when_copied_then_it_is_refused(tmp_path):
    write_small(tmp_path / 'a')
    with BagWriter(tmp_path / 'b') as writer, open_bag(tmp_path / 'a') as reader:
        writer.add_topic(JOINTS, STRING)
        with pytest.raises(ConfigError, match='two types'):
            writer.copy_topic(reader.connections[0])


@contextmanager
def full_disk(room):
    """Files of this process get no larger, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize('room', [0, 2800, 4000, 4200, 5000, 6000, 10_000, 10_300])
def test_given_a_disk_that_gets_full_when_writing_then_chunks_before_can_be_read(tmp_path, room):
    bag = tmp_path / 'bag'
    writer = BagWriter(bag, chunk_time=10 * MS)
    messages, header, free = BagMessages(writer.typestore, 'arm'), writer.size, writer.room()
    writer.add_topic(JOINTS, JOINT_STATE)
    with full_disk(room):
        assert writer.room() < room - header < free
        with pytest.raises(OSError, match='too large'):
            for stamp in range(START, START + 10_000 * STEP, STEP):
                message = messages.joint_state(stamp, ('a',), [1.0], [0.0], [0.0])
                writer.write(JOINTS, stamp, message)
        assert 'too large' in writer.close()
    assert storage(bag).stat().st_size <= max(room, header)
    if room == 0:
        with pytest.raises(BagError, match='nothing in it can be recovered'):
            contents(bag)
        return
    found, warnings = contents(bag)
    assert len(found) >= (room - 3200) // 180
    assert [time for _, time, _ in found] == [START + k * STEP for k in range(len(found))]
    assert any('not finished' in text for text in warnings)


def test_given_numbers_with_gaps_and_old_stamps_when_counted_then_lost_and_late_ones_are_known():
    count = TopicCount()
    # 7 and 8 were lost, then 8 came.
    for publisher, numbers in {b'a': (5, 6, 9, 8), b'b': (100, 101), None: (None,)}.items():
        for number in numbers:
            count.take(publisher, number)
    for stamp in (1, 2, 5, 3, 4, 5, 6):
        count.stamp(stamp)
    assert count.known() == {'messages': 7, 'lost': 1, 'late': 2}


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


@pytest.mark.parametrize('disorder', [15, 400, 1_000_000])
def test_given_chunks_that_overlap_when_read_then_times_are_sorted(tmp_path, monkeypatch, disorder):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 5000)
    content = list(entries(disorder))
    path = write_by_mcap(tmp_path / 'a.mcap', content)
    assert by_blocks(path) == sorted(content, key=lambda entry: entry[1])
    monkeypatch.setattr(reading, '_LARGEST_GROUP', 20_000)
    if disorder == 1_000_000:
        with pytest.raises(BagError, match='overlap in time'):
            by_blocks(path)


def test_given_bytes_that_are_no_records_when_split_then_it_is_damage():
    good = np.frombuffer(b'\x05' + (22).to_bytes(8, 'little') + bytes(22), np.uint8)
    assert len(split(good)[0]) == 1
    short = good.copy()
    short[1] = 21
    for bad in (good[:-1], good[:5], np.concatenate([good, good[:20]]), short[:-1]):
        with pytest.raises(DamageError):
            split(bad)


@pytest.mark.parametrize('preset', ['none', 'zstd_fast', 'zstd_small'])
def test_given_chunks_when_written_then_others_read_what_was_written_one_by_one(tmp_path, preset):
    values, times = np.random.default_rng(4).normal(size=(3, 500, 2)), 10**18 + 7 * np.arange(500)
    single, chunks = (BagWriter(tmp_path / name, preset) for name in ('single', 'chunks'))
    with single, chunks:
        for writer in (single, chunks):
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
            for writer in (single, chunks):
                writer.write_raw(CHATTER, int(times[first]), text('a'))
    assert single.counts == chunks.counts == {JOINTS: 500, CHATTER: 3}
    found = by_rosbags(tmp_path / 'chunks')
    assert found == by_blocks(tmp_path / 'chunks')
    assert sorted(found) == sorted(by_blocks(tmp_path / 'single'))
    with open(storage(tmp_path / 'chunks'), 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        stamps = [message.log_time for *_, message in reader.iter_messages([JOINTS])]
        said = reader.get_summary().statistics
    assert stamps == times.tolist()
    assert (said.message_count, said.message_start_time) == (503, times[0])
    assert said.message_end_time == times[-1]


NUMBERS = st.floats(allow_nan=True, width=64)
NAMES = st.lists(st.text('abcäß/_ ', min_size=0, max_size=9), min_size=1, max_size=5)
FRAMES = st.text(max_size=20).filter(lambda frame: '\0' not in frame)


@settings(max_examples=100)
@given(st.data(), NAMES, FRAMES, st.integers(0, 2**31 * 10**9 - 1))
def test_given_any_message_when_read_by_layout_then_values_are_its_own(data, names, frame, stamp):
    lengths = [data.draw(st.sampled_from([0, len(names)])) for _ in VECTORS]
    values = [data.draw(st.lists(NUMBERS, min_size=n, max_size=n)) for n in lengths]
    content = cdr(measurement(stamp, names, values, frame))
    layout = find_layout(content, JOINT_STATE, TYPESTORE)
    buffer, start = np.frombuffer(b'???' + content, np.uint8), np.array([3])
    assert layout.match(buffer, start, np.array([len(content)])).all()
    assert layout.stamps(buffer, start)[0] == stamp
    for name, expected in zip(VECTORS, values):
        np.testing.assert_array_equal(layout.read(buffer, start, name)[0], expected)


def test_given_one_byte_that_differs_when_matched_then_only_numbers_and_padding_may():
    content = cdr(measurement(5))
    layout, start = find_layout(content, JOINT_STATE, TYPESTORE), np.zeros(1, int)
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
        assert find_layout(bad, JOINT_STATE, TYPESTORE) is None
