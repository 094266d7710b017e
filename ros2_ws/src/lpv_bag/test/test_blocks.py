"""Blocks of messages: the same as message by message, from every kind of file."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as PeerWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from lpv_bag.blocks.cdr_layout import find_layout
from lpv_bag.blocks.message_blocks import ahead, split
from lpv_bag.errors import DamageError
from lpv_bag.replay.answer_records import RecordTemplate
from lpv_bag.rosbag import reading
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import BagError, open_bag

TYPESTORE = make_typestore()
JOINT_STATE = 'sensor_msgs/msg/JointState'
STRING = 'std_msgs/msg/String'
TOPICS = {'/joint_states': JOINT_STATE, '/chatter': STRING}


def joint_state(stamp, names=('joint1', 'joint2'), values=None, frame='base_link'):
    values = [[0.1, 0.2], [0.3, math.nan], []] if values is None else values
    return BagMessages(TYPESTORE, frame).joint_state(stamp, names, *values)


def cdr(message, msgtype=JOINT_STATE):
    return bytes(TYPESTORE.serialize_cdr(message, msgtype))


def entries(count=400, seed=1, disorder=0):
    """Topic, log time and bytes; times are out of order by as much as is asked for [ns]."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        time = 10_000 + 10 * k + int(rng.integers(2 * disorder + 1))
        yield '/joint_states', time, cdr(joint_state(k, values=rng.normal(size=(3, 2))))
        if k % 7 == 0:
            text = TYPESTORE.types[STRING]('x' * int(rng.integers(0, 40)))
            yield '/chatter', time, cdr(text, STRING)


def write_peer(path, content, **options):
    """A file by the mcap package."""
    with open(path, 'wb') as file:
        writer = PeerWriter(file, chunk_size=4000, **options)
        writer.start(profile='ros2', library='test')
        channels = {}
        for topic, msgtype in TOPICS.items():
            definition = TYPESTORE.generate_msgdef(msgtype, ros_version=2)[0]
            schema = writer.register_schema(msgtype, 'ros2msg', definition.encode())
            channels[topic] = writer.register_channel(topic, 'cdr', schema)
        for topic, time, data in content:
            writer.add_message(channels[topic], log_time=time, publish_time=time - 1, data=data)
        writer.finish()
    return path


def by_blocks(path, wanted=tuple(TOPICS), **options):
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.topic in wanted]
        found = [
            (connections[b.connection[i]].topic, int(b.time[i]), b.message(i))
            for b in reader.blocks(connections, **options)
            for i in range(len(b))
        ]
        assert reader.warnings == []
        return found


def by_rosbags(path, wanted=tuple(TOPICS), **limits):
    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic in wanted]
        return [
            (c.topic, time, bytes(data)) for c, time, data in reader.messages(connections, **limits)
        ]


KINDS = {
    'none': {'compression': CompressionType.NONE},
    'lz4': {'compression': CompressionType.LZ4},
    'zstd': {'compression': CompressionType.ZSTD},
    'no chunks': {'use_chunking': False},
    'no crc': {'compression': CompressionType.NONE, 'enable_crcs': False},
}


@pytest.mark.parametrize('size', [5000, 2 << 20])
@pytest.mark.parametrize('kind', KINDS)
def test_given_a_file_of_any_kind_when_read_in_blocks_then_messages_are_those_of_rosbags(
    tmp_path, monkeypatch, kind, size
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', size)
    path = write_peer(tmp_path / 'a.mcap', entries(), **KINDS[kind])
    assert by_blocks(path) == by_rosbags(path)
    assert by_blocks(path, ('/chatter',)) == by_rosbags(path, ('/chatter',))
    for limits in ({'start': 11_000}, {'stop': 12_345}, {'start': 11_111, 'stop': 13_000}):
        assert by_blocks(path, **limits) == by_rosbags(path, **limits)


@pytest.mark.parametrize('disorder', [15, 400, 1_000_000])
def test_given_chunks_that_overlap_when_read_in_blocks_then_the_order_is_that_of_times(
    tmp_path, monkeypatch, disorder
):
    monkeypatch.setattr(reading, 'BLOCK_SIZE', 5000)
    content = list(entries(disorder=disorder))
    path = write_peer(tmp_path / 'a.mcap', content)
    assert by_blocks(path) == sorted(content, key=lambda entry: entry[1])
    monkeypatch.setattr(reading, '_LARGEST_GROUP', 20_000)
    if disorder == 1_000_000:
        with pytest.raises(BagError, match='overlap in time'):
            by_blocks(path)


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_given_a_folder_when_read_in_blocks_then_messages_are_the_same(tmp_path, plugin):
    content = list(entries())
    with Writer(tmp_path / 'bag', version=9, storage_plugin=plugin) as writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=TYPESTORE)
            for topic, msgtype in TOPICS.items()
        }
        for topic, time, data in content:
            writer.write(connections[topic], time, data)
    assert by_blocks(tmp_path / 'bag') == content


def test_given_bytes_that_are_no_records_when_split_then_it_is_damage():
    good = np.frombuffer(b'\x05' + (22).to_bytes(8, 'little') + bytes(22), np.uint8)
    assert len(split(good)[0]) == 1
    for bad in (good[:-1], good[:5], np.concatenate([good, good[:20]])):
        with pytest.raises(DamageError):
            split(bad)
    short = good.copy()
    short[1] = 21
    with pytest.raises(DamageError):
        split(short[:-1])


# ------------------------------------------------------------------ layouts

NUMBERS = st.floats(allow_nan=True, width=64)
NAMES = st.lists(st.text('abcäß/_ ', min_size=0, max_size=9), min_size=1, max_size=5)


@given(st.data(), NAMES, st.text(max_size=20).filter(lambda t: '\0' not in t))
def test_given_any_measurement_when_read_by_its_layout_then_values_are_those_of_the_message(
    data, names, frame
):
    count = len(names)
    lengths = [data.draw(st.sampled_from([0, count])) for _ in range(3)]
    values = [data.draw(st.lists(NUMBERS, min_size=n, max_size=n)) for n in lengths]
    stamp = data.draw(st.integers(0, 2**31 * 10**9 - 1))
    content = cdr(joint_state(stamp, names, values, frame))
    layout = find_layout(content, JOINT_STATE, TYPESTORE)
    buffer, start = np.frombuffer(b'???' + content, np.uint8), np.array([3])
    assert layout.match(buffer, start, np.array([len(content)])).all()
    assert layout.stamps(buffer, start)[0] == stamp
    for name, expected in zip(('position', 'velocity', 'effort'), values):
        np.testing.assert_array_equal(layout.read(buffer, start, name)[0], expected)


def test_given_one_byte_that_differs_when_matched_then_only_numbers_and_padding_may():
    content = cdr(joint_state(5))
    layout = find_layout(content, JOINT_STATE, TYPESTORE)
    sizes = np.array([len(content)])
    for at in range(len(content)):
        changed = np.frombuffer(content, np.uint8).copy()
        changed[at] ^= 1
        try:
            other = TYPESTORE.deserialize_cdr(changed.tobytes(), JOINT_STATE)
            same = list(other.name) == ['joint1', 'joint2'] and other.header.frame_id == 'base_link'
        except Exception:
            same = False
        if layout.match(changed, np.zeros(1, int), sizes)[0]:
            assert same
            back = layout.read(changed, np.zeros(1, int), 'position')[0]
            np.testing.assert_array_equal(back, other.position)


@pytest.mark.parametrize('content', [b'', b'\0\1', bytes(11), b'\0\0' + cdr(joint_state(1))[2:]])
def test_given_bytes_that_are_no_short_message_when_a_layout_is_sought_then_there_is_none(content):
    assert find_layout(content, JOINT_STATE, TYPESTORE) is None


# ------------------------------------------------------------------ whole chunks


@pytest.mark.parametrize('preset', ['none', 'zstd_fast', 'zstd_small'])
def test_given_chunks_when_written_then_others_read_what_was_written_one_by_one(tmp_path, preset):
    rng, times = np.random.default_rng(4), 10**18 + 7 * np.arange(500)
    values = rng.normal(size=(3, 500, 2))
    names = ('position', 'velocity', 'effort')
    for way in ('chunks', 'messages'):
        with BagWriter(tmp_path / way, preset) as writer:
            for topic, msgtype in TOPICS.items():
                writer.add_topic(topic, msgtype)
            messages = BagMessages(writer.typestore, 'base_link')
            zero = messages.joint_state(0, ('a', 'b'), *np.zeros((3, 2)))
            template = RecordTemplate(
                writer.typestore, zero, JOINT_STATE, writer.channel('/joint_states')
            )
            for first in range(0, 500, 200):
                rows = slice(first, first + 200)
                if way == 'chunks':
                    fields = {name: v[rows] for name, v in zip(names, values)}
                    writer.write_chunk(template.fill(times[rows], times[rows], fields))
                for k in range(first, min(first + 200, 500)):
                    if way == 'messages':
                        message = messages.joint_state(int(times[k]), ('a', 'b'), *values[:, k])
                        writer.write('/joint_states', int(times[k]), message)
                writer.write('/chatter', int(times[first]), writer.typestore.types[STRING]('a'))
            counts = writer.counts
        assert counts == {'/joint_states': 500, '/chatter': 3}
    assert by_rosbags(tmp_path / 'chunks') == by_blocks(tmp_path / 'chunks')
    assert sorted(by_blocks(tmp_path / 'chunks')) == sorted(by_blocks(tmp_path / 'messages'))
    with open(next((tmp_path / 'chunks').glob('*.mcap')), 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        found = [message.log_time for _, _, message in reader.iter_messages(['/joint_states'])]
    assert found == times.tolist()
    assert summary.statistics.message_count == 503
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (
        times[0],
        times[-1],
    )


def test_given_items_when_read_ahead_then_they_come_in_order_and_errors_too():
    assert list(ahead(range(100))) == list(range(100))

    def fail():
        yield 1
        raise KeyError('here')

    found = ahead(fail())
    assert next(found) == 1
    with pytest.raises(KeyError, match='here'):
        next(found)
