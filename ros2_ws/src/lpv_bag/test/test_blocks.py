"""Blocks of messages: the same as message by message, from every kind of file."""

import math
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType
from mcap.writer import Writer as PeerWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from lpv_bag.blocks import mcap_blocks, message_blocks
from lpv_bag.blocks.cdr_layout import find_layout
from lpv_bag.blocks.chunk_assembly import Buffer, ChunkAssembly
from lpv_bag.blocks.chunk_writing import ChunkBagWriter
from lpv_bag.blocks.message_blocks import read_blocks
from lpv_bag.blocks.prefetch import Behind, ahead
from lpv_bag.errors import DamageError
from lpv_bag.replay.answer_records import RecordTemplate
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.offered_qos import qos_profile
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
            schema = writer.register_schema(
                name=msgtype,
                encoding='ros2msg',
                data=TYPESTORE.generate_msgdef(msgtype, ros_version=2)[0].encode(),
            )
            channels[topic] = writer.register_channel(
                topic=topic, message_encoding='cdr', schema_id=schema
            )
        for sequence, (topic, time, data) in enumerate(content):
            writer.add_message(
                channels[topic], log_time=time, publish_time=time - 1, data=data, sequence=sequence
            )
        writer.finish()
    return path


def write_rosbags(path, content, plugin):
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=TYPESTORE)
            for topic, msgtype in TOPICS.items()
        }
        for topic, time, data in content:
            writer.write(connections[topic], time, data)
    return path


def by_blocks(path, wanted=tuple(TOPICS), **options):
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.topic in wanted]
        return [
            (connections[b.connection[i]].topic, int(b.time[i]), b.message(i))
            for b in read_blocks(reader, connections, **options)
            for i in range(len(b))
        ]


def one_by_one(path, wanted=tuple(TOPICS), **limits):
    with open_bag(path) as reader:
        connections = [c for c in reader.connections if c.topic in wanted]
        return [
            (c.topic, time, bytes(data)) for c, time, data in reader.messages(connections, **limits)
        ]


@pytest.fixture
def fast_only(monkeypatch):
    """Reading message by message fails."""

    def fail(messages, connections):
        raise AssertionError('the slow way was taken')

    monkeypatch.setattr(message_blocks, '_collect', fail)


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(message_blocks, 'BLOCK_SIZE', 5000)


KINDS = {
    'none': {'compression': CompressionType.NONE},
    'lz4': {'compression': CompressionType.LZ4},
    'zstd': {'compression': CompressionType.ZSTD},
    'no chunks': {'use_chunking': False},
    'no crc': {'compression': CompressionType.NONE, 'enable_crcs': False},
}


@pytest.mark.parametrize('size', [5000, 2 << 20])
@pytest.mark.parametrize('kind', KINDS)
def test_given_a_file_of_any_kind_when_read_in_blocks_then_messages_are_the_same(
    tmp_path, monkeypatch, fast_only, kind, size
):
    monkeypatch.setattr(message_blocks, 'BLOCK_SIZE', size)
    path = write_peer(tmp_path / 'a.mcap', entries(), **KINDS[kind])
    expected = one_by_one(path)
    assert len(expected) == 458
    assert by_blocks(path) == expected
    assert by_blocks(path, ['/chatter']) == one_by_one(path, ['/chatter'])


@pytest.mark.parametrize('disorder', [15, 400, 1_000_000])
def test_given_chunks_that_overlap_when_read_in_blocks_then_the_order_is_the_same(
    tmp_path, fast_only, small_blocks, disorder
):
    path = write_peer(
        tmp_path / 'a.mcap', entries(disorder=disorder), compression=CompressionType.ZSTD
    )
    found = by_blocks(path)
    assert found == one_by_one(path)
    assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)


@pytest.mark.parametrize(
    ('start', 'stop'), [(None, 11_000), (11_000, None), (11_003, 12_222), (0, 1), (99_999, None)]
)
@pytest.mark.parametrize('kind', ['zstd', 'no chunks'])
def test_given_limits_when_read_in_blocks_then_they_are_kept(
    tmp_path, fast_only, small_blocks, kind, start, stop
):
    path = write_peer(tmp_path / 'a.mcap', entries(), **KINDS[kind])
    limits = {'start': start, 'stop': stop}
    assert by_blocks(path, **limits) == one_by_one(path, **limits)


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_given_a_folder_when_read_in_blocks_then_messages_are_the_same(
    tmp_path, small_blocks, plugin
):
    bag = write_rosbags(tmp_path / 'bag', entries(), plugin)
    assert by_blocks(bag) == one_by_one(bag) == by_blocks(bag, fast=False)


def test_given_something_odd_in_the_middle_when_read_in_blocks_then_nothing_is_lost_or_doubled(
    tmp_path, monkeypatch, small_blocks
):
    path = write_peer(tmp_path / 'a.mcap', entries(disorder=15), compression=CompressionType.LZ4)
    inflate, calls = mcap_blocks.inflate, []

    def failing(*arguments):
        calls.append(arguments)
        if len(calls) == 7:
            raise DamageError('not now')
        return inflate(*arguments)

    monkeypatch.setattr(mcap_blocks, 'inflate', failing)
    assert by_blocks(path) == one_by_one(path)
    assert len(calls) == 7


@pytest.mark.parametrize('kind', ['none', 'zstd', 'lz4', 'no chunks'])
def test_given_bytes_that_are_wrong_when_read_in_blocks_then_it_is_as_one_by_one(tmp_path, kind):
    path = write_peer(tmp_path / 'a.mcap', entries(60), **KINDS[kind])
    data, rng = path.read_bytes(), np.random.default_rng(3)
    for at in rng.integers(len(data), size=60):
        path.write_bytes(data[:at] + bytes([data[at] ^ (1 << rng.integers(8))]) + data[at + 1 :])
        results = []
        for read in (one_by_one, by_blocks):
            try:
                results.append(read(path))
            except BagError as error:
                results.append(str(error))
        assert results[0] == results[1], at


# ------------------------------------------------------------------ layouts

NUMBERS = st.floats(width=64)
NAMES = st.lists(
    st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF), max_size=9), max_size=4
)


@given(NAMES, st.text(max_size=12), st.data())
def test_given_any_measurement_when_read_by_its_layout_then_values_are_those_of_the_message(
    names, frame, data
):
    vectors = [data.draw(st.lists(NUMBERS, max_size=4)) for _ in range(3)]
    stamp = data.draw(st.integers(0, 2**31 * 10**9 - 1))
    try:
        content = cdr(joint_state(stamp, names, vectors, frame))
    except UnicodeEncodeError:
        return
    if '\0' in frame or any('\0' in n for n in names):
        return
    layout = find_layout(content, JOINT_STATE, TYPESTORE)
    before = data.draw(st.integers(0, 9))
    buffer = np.frombuffer(bytes(before) + content + b'\1\2\3', np.uint8)
    starts, sizes = np.array([before]), np.array([len(content)])
    assert layout.match(buffer, starts, sizes).all()
    assert layout.strings.get('name', []) == names
    assert layout.strings['header.frame_id'] == [frame]
    assert layout.stamps(buffer, starts)[0] == stamp
    for name, vector in zip(('position', 'velocity', 'effort'), vectors):
        assert layout.read(buffer, starts, name).tobytes() == np.array(vector).tobytes()


def test_given_one_byte_that_differs_when_matched_then_only_numbers_and_padding_may():
    content = cdr(joint_state(12345, values=[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    layout = find_layout(content, JOINT_STATE, TYPESTORE)
    free = {2, 3}  # options of the representation identifier
    for field in layout.fields.values():
        free |= set(
            range(field.offset, field.offset + field.count * np.dtype(field.dtype).itemsize)
        )
    for at in range(len(content)):
        changed = content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]
        buffer = np.frombuffer(changed, np.uint8)
        same = layout.match(buffer, np.array([0]), np.array([len(content)]))[0]
        try:
            message = TYPESTORE.deserialize_cdr(changed, JOINT_STATE)
            known = (
                message.name == ['joint1', 'joint2']
                and message.header.frame_id == 'base_link'
                and [len(v) for v in (message.position, message.velocity, message.effort)]
                == [2, 2, 2]
            )
        except Exception:  # rosbags raises many kinds
            known = False
        assert same == known or at in (0, 1), at
        assert same or at not in free, at


@pytest.mark.parametrize(
    'content',
    [
        b'',
        b'\0',
        b'\0\1\0\0',
        cdr(joint_state(1))[:-5],
        b'\0\0\0\0' + cdr(joint_state(1))[4:],
        cdr(joint_state(1)) + bytes(9),
        b'\0\1\0\0' + b'\xff' * 60,
        cdr(joint_state(1, ['joint'] * 2000, [[0.0] * 2000] * 3)),
    ],
    ids=range(8),
)
def test_given_bytes_that_are_no_short_message_when_a_layout_is_sought_then_there_is_none(content):
    assert find_layout(content, JOINT_STATE, TYPESTORE) is None


# ------------------------------------------------------------------ chunks that are written


def chunk_bag(path, content, preset):
    with ChunkBagWriter(path, preset) as writer:
        for topic, msgtype in TOPICS.items():
            writer.add_topic(topic, msgtype, [qos_profile(True, True, 7)])
        for topic, time, data in content:
            writer.write_raw(topic, time, data)
    return path


@pytest.mark.parametrize('preset', ['none', 'zstd_fast', 'zstd_small'])
def test_given_chunks_when_written_then_all_readers_read_what_the_bag_writer_would_have_written(
    tmp_path, preset
):
    content = list(entries(8000))
    bag = chunk_bag(tmp_path / 'bag', content, preset)
    with BagWriter(tmp_path / 'plain') as writer:
        for topic, msgtype in TOPICS.items():
            writer.add_topic(topic, msgtype, [qos_profile(True, True, 7)])
        for topic, time, data in content:
            writer.write_raw(topic, time, data)
    assert one_by_one(bag) == one_by_one(tmp_path / 'plain')
    with AnyReader([bag]) as ours, AnyReader([tmp_path / 'plain']) as plain:
        for a, b in zip(ours.connections, plain.connections):
            assert (a.topic, a.msgtype, a.msgdef, a.digest, a.msgcount, a.ext) == (
                b.topic,
                b.msgtype,
                b.msgdef,
                b.digest,
                b.msgcount,
                b.ext,
            )
        assert (ours.start_time, ours.end_time) == (plain.start_time, plain.end_time)
    (file,) = bag.glob('*.mcap')
    with open(file, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(content)
        assert {
            summary.channels[i].topic: n
            for i, n in summary.statistics.channel_message_counts.items()
        } == {'/joint_states': 8000, '/chatter': 1143}
        found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        assert sorted(found) == sorted(content)
        assert len(summary.chunk_indexes) == (1 if preset == 'zstd_small' else 2)
        hashes = {c.metadata['topic_type_hash'] for c in summary.channels.values()}
        assert all(text.startswith('RIHS01_') for text in hashes)
    with open(file, 'rb') as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    assert type(records[-1]).__name__ == 'Footer'
    assert sum(type(r).__name__ == 'Message' for r in records) == len(content)


def test_given_times_of_the_epoch_when_chunks_are_written_then_index_and_order_are_exact(
    tmp_path, fast_only
):
    times = 1_700_000_000_123_456_789 + 3 * np.arange(500)
    with ChunkBagWriter(tmp_path / 'bag', 'zstd_fast') as writer:
        writer.add_topic('/joint_states', JOINT_STATE)
        writer.add_topic('/chatter', STRING)
        template = RecordTemplate(
            writer.typestore,
            joint_state(0, values=np.zeros((3, 2))),
            JOINT_STATE,
            writer.channel('/joint_states'),
        )
        for part in (times[:300], times[300:]):
            assembly = ChunkAssembly(2 * len(part), Buffer())
            position = np.column_stack([part, part]) * 1e-9
            assembly.add_rows(
                2 * np.arange(len(part)),
                template.fill(
                    part, part + 1, {name: position for name in ('position', 'velocity', 'effort')}
                ),
            )
            assembly.add_message(1, writer.channel('/chatter'), int(part[0]), b'odd')
            writer.write_chunk(*assembly.finish())
    expected = [
        ('/joint_states', int(t), cdr(joint_state(int(t) + 1, values=[[t * 1e-9] * 2] * 3)))
        for t in times
    ]
    expected.insert(301, ('/chatter', int(times[300]), b'odd'))
    expected.insert(1, ('/chatter', int(times[0]), b'odd'))
    found = by_blocks(tmp_path / 'bag')
    assert [(t, time, data.rstrip(b'\0')) for t, time, data in found] == [
        (t, time, data.rstrip(b'\0')) for t, time, data in expected
    ]
    with open(next((tmp_path / 'bag').glob('*.mcap')), 'rb') as stream:
        index = [
            r
            for r in StreamReader(stream, emit_chunks=True).records
            if type(r).__name__ == 'MessageIndex'
        ]
    assert [t for i in index if i.channel_id == 1 for t, _ in i.records] == times.tolist()
    with open(next((tmp_path / 'bag').glob('*.mcap')), 'rb') as stream:
        messages = [m for _, c, m in make_reader(stream).iter_messages(['/joint_states'])]
    assert [m.sequence for m in messages] == list(range(1, 501))


# ------------------------------------------------------------------ threads


@pytest.fixture
def no_thread_is_left():
    """Fails a test after which a thread runs that did not run before."""
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= before


@pytest.mark.usefixtures('no_thread_is_left')
def test_given_items_when_read_ahead_then_they_come_in_order_and_errors_too():
    def items():
        yield from range(50)
        raise BagError('the end is missing')

    found = []
    with pytest.raises(BagError, match='the end is missing'):
        for item in ahead(items()):
            found.append(item)
    assert found == list(range(50))


@pytest.mark.usefixtures('no_thread_is_left')
def test_given_a_reader_that_gives_up_when_reading_ahead_then_the_source_is_closed():
    closed = []

    def items():
        try:
            yield from range(10**9)
        finally:
            closed.append(True)

    for item in ahead(items()):
        if item == 5:
            break
    assert closed == [True]


@pytest.mark.usefixtures('no_thread_is_left')
def test_given_a_write_that_fails_when_writing_behind_then_the_error_is_raised_here():
    done = []

    def write(number):
        if number == 3:
            raise OSError('disk full')
        done.append(number)

    with pytest.raises(OSError, match='disk full'), Behind(write) as behind:
        for number in range(100):
            behind(number)
    assert done == [0, 1, 2]
