"""Written bags: read by others, split, cut by the data alone, ended in order on a full disk."""

import errno
import json
import resource
import subprocess
import sys

import numpy as np
import pytest
import yaml
from bags import CHATTER, JOINT_STATE, JOINTS, START, STEP, contents, storage, write_small
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from lpv_bag.errors import BagError
from lpv_bag.rosbag.message_loss import RECORD_NAME, TopicCount
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.reading import open_bag
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import load_run
from lpv_core.support.errors import ConfigError

MS = 1_000_000


def by_rosbags(path):
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
        return [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]


def by_mcap(file):
    with open(file, 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in reader.iter_messages()
        ]


# ------------------------------------------------------------------ format


@pytest.mark.parametrize('preset', ['none', 'zstd_fast', 'zstd_small'])
def test_given_a_preset_when_written_then_rosbags_and_mcap_read_the_same(tmp_path, preset):
    bag = write_small(tmp_path / 'bag', preset=preset)
    found, warnings = contents(bag)
    assert warnings == []
    assert len(found) == 24
    assert by_rosbags(bag) == by_mcap(storage(bag)) == found


def test_given_a_bag_when_written_then_the_file_is_in_the_profile_of_ros2(tmp_path):
    bag = write_small(tmp_path / 'bag', known={JOINTS: {'lost': 3, 'late': 1, 'gaps': 0}})
    with open(storage(bag), 'rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        header, summary = reader.get_header(), reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert header.profile == 'ros2'
    assert summary.statistics.message_count == 24
    assert {(s.name, s.encoding) for s in summary.schemas.values()} == {
        (JOINT_STATE, 'ros2msg'),
        ('std_msgs/msg/String', 'ros2msg'),
    }
    channel = next(c for c in summary.channels.values() if c.topic == JOINTS)
    assert channel.message_encoding == 'cdr'
    (profile,) = yaml.safe_load(channel.metadata['offered_qos_profiles'])
    assert (profile['reliability'], profile['history'], profile['depth']) == (
        'reliable',
        'keep_last',
        10,
    )
    inner = yaml.safe_load(metadata['rosbag2']['serialized_metadata'])
    outer = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert inner['version'] == outer['version'] == 9
    assert outer['storage_identifier'] == 'mcap'
    assert outer['duration']['nanoseconds'] == 19 * STEP
    topic = outer['topics_with_message_count'][0]
    assert topic['message_count'] == 20
    assert topic['topic_metadata']['type_description_hash'] == channel.metadata['topic_type_hash']
    # The hash of the release that everyone has.
    assert channel.metadata['topic_type_hash'].startswith('RIHS01_a13ee3a330e346c9d87b5aa18d24e1')
    assert json.loads(outer['custom_data'][RECORD_NAME])[JOINTS]['lost'] == 3
    assert json.loads(outer['custom_data'][RECORD_NAME])[JOINTS]['late'] == 1
    with open_bag(bag) as reader:
        assert reader.known[JOINTS] == {'lost': 3, 'late': 1, 'gaps': 0}
        assert (reader.start_time, reader.end_time) == (START, START + 19 * STEP + 1)
        assert {JOINT_STATE, 'std_msgs/msg/String'} <= set(reader.typestore.fielddefs)


@pytest.mark.parametrize('options', [{'split_size': 1000}, {'split_time': 10 * MS}])
def test_given_a_limit_when_written_then_the_bag_has_several_files_and_is_one(tmp_path, options):
    bag = write_small(tmp_path / 'bag', **options)
    files = sorted((path.name for path in bag.glob('*.mcap')), key=lambda n: (len(n), n))
    assert len(files) >= 4
    assert files[:2] == ['bag_0.mcap', 'bag_1.mcap']
    listed = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert listed['relative_file_paths'] == files
    assert sum(file['message_count'] for file in listed['files']) == 24
    found, warnings = contents(bag)
    assert warnings == []
    assert by_rosbags(bag) == found == contents(write_small(tmp_path / 'one'))[0]
    if 'split_time' in options:
        assert all(file['duration']['nanoseconds'] < 10 * MS for file in listed['files'])
    for name in files:  # each file is whole by itself
        assert contents(bag / name)[1] == []


def test_given_the_same_messages_when_written_with_pauses_then_the_files_are_the_same(tmp_path):
    def write(path, pauses):
        with BagWriter(path, 'zstd_fast', chunk_time=10 * MS) as writer:
            messages = BagMessages(writer.typestore, 'arm')
            writer.add_topic(JOINTS, JOINT_STATE)
            for k in range(40):
                if k % 7 == 0 and pauses:
                    writer.room()
                writer.write(
                    JOINTS,
                    START + k * STEP,
                    messages.joint_state(START + k * STEP, ('a',), [0.0], [0.0], [0.0]),
                )
        return storage(path).read_bytes(), (path / 'metadata.yaml').read_bytes()

    assert write(tmp_path / 'a' / 'bag', False) == write(tmp_path / 'b' / 'bag', True)


def test_given_garbage_between_fields_when_it_is_taken_out_then_the_message_is_the_same(tmp_path):
    with BagWriter(tmp_path / 'bag') as writer:
        message = BagMessages(writer.typestore, 'arm').joint_state(5, ('a',), [1.0], [2.0], [3.0])
        writer.add_topic(JOINTS, JOINT_STATE)
        data = bytes(writer.typestore.serialize_cdr(message, JOINT_STATE))
        hole = data.index(b'arm\0') + 4 + 4 + 4 + 2  # behind the name of the joint
        assert data[hole : hole + 2] == bytes(2)
        dirty = data[:hole] + b'\xaa\xbb' + data[hole + 2 :]
        assert writer.without_garbage(JOINT_STATE, dirty) == data + bytes(-len(data) % 4)
        for other in (b'', b'\0\1\0\0', data[:30], b'\0\0' + data[2:]):
            assert writer.without_garbage(JOINT_STATE, other) == other


def test_given_times_out_of_order_when_read_then_messages_come_by_log_time(tmp_path):
    rng, times = np.random.default_rng(5), {}
    with BagWriter(tmp_path / 'bag', chunk_time=3 * MS) as writer:
        writer.add_topic(CHATTER, 'std_msgs/msg/String')
        for k in range(300):
            time = START + int(rng.integers(40)) * MS
            writer.write(CHATTER, time, writer.typestore.types['std_msgs/msg/String'](str(k)))
            times.setdefault(time, []).append(k)
    with open_bag(tmp_path / 'bag') as reader:
        found = [
            (time, int(reader.deserialize(data, c.msgtype).data))
            for c, time, data in reader.messages()
        ]
        part = [time for _, time, _ in reader.messages(start=START + 5 * MS, stop=START + 9 * MS)]
    assert [time for time, _ in found] == sorted(time for time, ks in times.items() for _ in ks)
    assert sorted(k for _, k in found) == list(range(300))
    assert part == [time for time, _ in found if START + 5 * MS <= time < START + 9 * MS]
    assert found == [
        (t, int(d[8:].rstrip(b'\0'))) for _, t, d in by_mcap(storage(tmp_path / 'bag'))
    ]


def test_given_one_topic_with_two_types_when_copied_then_it_is_refused(tmp_path):
    write_small(tmp_path / 'a')
    with BagWriter(tmp_path / 'b') as writer, open_bag(tmp_path / 'a') as reader:
        writer.add_topic(JOINTS, 'std_msgs/msg/String')
        with pytest.raises(ConfigError, match='two types'):
            writer.copy_topic(reader.connections[0])


# ------------------------------------------------------------------ disks that are full


class FullDisk:
    """A file that takes some bytes and no more."""

    def __init__(self, file, room):
        self._file, self._room = file, room

    def write(self, data):
        if self._room == 0:
            raise OSError(errno.ENOSPC, 'No space left on device')
        count = min(len(data), self._room)
        self._room -= count
        return self._file.write(data[:count])

    def truncate(self, size):
        self._room += self._file.seek(0, 2) - size
        return self._file.truncate(size)

    def __getattr__(self, name):
        return getattr(self._file, name)


def write_until_full(path, room):
    """Write until the disk is full; what the bag says was missing at its end."""
    writer = BagWriter(path, chunk_time=10 * MS)
    output = writer._file.output
    output.file = FullDisk(output.file, room)
    messages = BagMessages(writer.typestore, 'arm')
    writer.add_topic(JOINTS, JOINT_STATE)
    with pytest.raises(OSError, match='No space left'):
        for k in range(10_000):
            writer.write(
                JOINTS,
                START + k * STEP,
                messages.joint_state(START + k * STEP, ('a',), [float(k)], [0.0], [0.0]),
            )
    return writer.close()


@pytest.mark.parametrize('room', [0, 2800, 4000, 4200, 5000, 6000, 10_000, 10_300])
def test_given_a_disk_that_gets_full_when_writing_then_all_chunks_before_can_be_read(
    tmp_path, room
):
    bag = tmp_path / 'bag'
    assert 'No space left' in write_until_full(bag, room)
    assert storage(bag).stat().st_size <= room + 40  # the header was written before
    if room == 0:
        with pytest.raises(BagError, match='nothing in it can be recovered'):
            contents(bag)
        return
    found, warnings = contents(bag)
    assert len(found) >= (room - 3200) // 180
    assert [time for _, time, _ in found] == [START + k * STEP for k in range(len(found))]
    assert any('not finished' in text for text in warnings)


ROOM = """
import resource, sys
from lpv_bag.rosbag.writing import BagWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
with BagWriter(sys.argv[1]) as writer:
    writer.add_topic('/a', 'std_msgs/msg/String')
    room = writer.room()
    written = 0
    while writer.room() > 10_000:
        writer.write_raw('/a', 0, bytes(1000))
        writer.flush()
        written += 1
    print(room, written)
"""


def test_given_a_limit_of_file_sizes_when_asked_then_the_room_is_known(tmp_path):
    if resource.getrlimit(resource.RLIMIT_FSIZE)[0] != resource.RLIM_INFINITY:
        pytest.skip('this process has a limit already')
    result = subprocess.run(
        [sys.executable, '-c', ROOM, tmp_path / 'bag'], text=True, capture_output=True, check=True
    )
    room, written = map(int, result.stdout.split())
    assert 80_000 < room < 100_000
    assert 50 < written < 90
    assert len(contents(tmp_path / 'bag')[0]) == written


# ------------------------------------------------------------------ counts


def test_given_numbers_with_gaps_when_counted_then_lost_messages_are_known_by_publisher():
    count = TopicCount()
    for publisher, sequence in (
        (b'a', 5),
        (b'a', 6),
        (b'b', 100),
        (b'a', 9),
        (b'b', 101),
        (b'a', 8),
        (None, None),
    ):
        count.take(publisher, sequence)
    assert (count.messages, count.lost) == (7, 1)  # 7 and 8 were lost, then 8 came


def test_given_stamps_that_are_older_when_counted_then_they_are_late():
    count = TopicCount()
    for stamp in (1, 2, 5, 3, 4, 5, 6):
        count.stamp(stamp)
    assert count.late == 2


# ------------------------------------------------------------------ definitions


def test_given_another_definition_of_a_type_when_loaded_then_the_error_names_the_field(
    tmp_path, monkeypatch
):
    with BagWriter(tmp_path / 'bag') as writer:
        types = writer.typestore
        text, digest = types.generate_msgdef(JOINT_STATE, ros_version=2)
        changed = text.replace('float64[] velocity', 'float32[] velocity')
        assert changed != text
        monkeypatch.setattr(types, 'generate_msgdef', lambda *_, **__: (changed, digest))
        monkeypatch.setattr(types, 'hash_rihs01', lambda _: '')
        writer.add_topic(JOINTS, JOINT_STATE)
        writer.write_raw(JOINTS, 1, bytes(60))
    with pytest.raises(BagError, match='bag: .*velocity of sensor_msgs/msg/JointState has another'):
        load_run(tmp_path / 'bag')


def test_given_a_hash_that_is_not_that_of_the_definition_when_loaded_then_it_is_an_error(
    tmp_path, monkeypatch
):
    with BagWriter(tmp_path / 'bag') as writer:
        monkeypatch.setattr(writer.typestore, 'hash_rihs01', lambda _: 'RIHS01_' + '0' * 64)
        writer.add_topic(JOINTS, JOINT_STATE)
        writer.write_raw(JOINTS, 1, bytes(60))
    with pytest.raises(BagError, match='hash'):
        load_run(tmp_path / 'bag')


@pytest.mark.parametrize('chunk', [0, 1, 5])
def test_given_a_chunk_that_is_damaged_when_read_then_its_messages_alone_are_lost(tmp_path, chunk):
    bag = write_small(tmp_path / 'bag', 60)
    data, at = bytearray(storage(bag).read_bytes()), -1
    for _ in range(chunk + 1):
        at = data.index(b'zstd', at + 1)
    data[at + 40] ^= 1
    storage(bag).write_bytes(data)
    found, warnings = contents(bag)
    assert [k for k in range(60) if (JOINTS, START + k * STEP) not in {e[:2] for e in found}] == [
        *range(5 * chunk, 5 * chunk + 5)
    ]
    assert len(found) == 72 - 6
    assert any('is damaged' in text for text in warnings)
