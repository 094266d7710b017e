"""Bags that are cut off, damaged or odd: what can be had is had, nothing wrong is let through."""

import contextlib
import random
import re
import shutil
import struct

import pytest
from bags import CHATTER, JOINT_STATE, JOINTS, START, STEP, contents, storage, write_small
from mcap.writer import CompressionType, Writer

from lpv_bag.errors import BagError
from lpv_bag.rosbag import mcap_file
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.recovery import recover
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.uio.certificate.gains import save_gains

pytestmark = [pytest.mark.filterwarnings('error'), pytest.mark.slow]


@pytest.fixture(autouse=True)
def quiet(caplog):
    """Ten thousands of warnings are not worth keeping."""
    caplog.set_level('CRITICAL', 'lpv_bag')


@pytest.fixture
def bag(tmp_path):
    return write_small(tmp_path / 'bag')


# ------------------------------------------------------------------ every byte of a small bag


class Judge:
    """Reads, loads and recovers a bag of which one thing at most is wrong."""

    def __init__(self, bag):
        self.bag, self.file = bag, storage(bag)
        self.data = self.file.read_bytes()
        self.good = contents(bag)[0]
        self.read = 0

    def check(self, data, single):
        """Nothing that was not recorded comes out, and what is missing is said."""
        self.file.write_bytes(data)
        path = self.file if single else self.bag
        try:
            found, warnings = contents(path)
        except BagError as error:
            assert str(error).startswith(str(path))
            assert '\n' not in str(error)
            with pytest.raises(BagError):
                recover(path)
            return
        left = iter(self.good)
        assert all(message in left for message in found), 'not a part of what was recorded'
        complete = len(found) == len(self.good)
        assert complete or warnings, 'messages are missing, and nobody says so'
        result = recover(path)
        assert sum(topic.recovered for topic in result.topics.values()) == len(found)
        assert complete or not result.nothing_lost
        if not single:  # metadata.yaml is there, and says how many there were
            assert len(found) + result.lost == len(self.good)
        if self.read % 4 == 0:
            self._load(path, complete)
        self.read += bool(found)

    def _load(self, path, complete):
        try:
            record = load_run(path)
        except BagError:
            assert not complete
        else:
            assert complete or record.warnings


def test_given_a_bag_that_is_cut_at_any_byte_when_read_then_what_comes_out_was_recorded(tmp_path):
    judge = Judge(write_small(tmp_path / 'bag', 8))
    sizes = range(0, len(judge.data), 37)
    for size in sizes:
        judge.check(judge.data[:size], single=size % 2)
    assert judge.read > len(sizes) / 3


@pytest.mark.parametrize(('preset', 'step'), [('none', 53), ('zstd_fast', 37)])
def test_given_any_byte_that_is_wrong_when_read_then_what_comes_out_was_recorded(
    tmp_path, preset, step
):
    judge = Judge(write_small(tmp_path / 'bag', 8, preset=preset))
    rng, places = random.Random(3), range(0, len(judge.data), step)
    for at in places:
        data = bytearray(judge.data)
        data[at] ^= 1 << rng.randrange(8)
        judge.check(bytes(data), single=rng.randrange(2))
    assert judge.read > 0.8 * len(places)


def test_given_a_cut_bag_with_a_wrong_byte_when_read_then_only_bag_errors_come_out(tmp_path):
    rng = random.Random(7)
    for preset in ('none', 'zstd_fast'):
        bag = write_small(tmp_path / preset, preset=preset)
        file, data = storage(bag), storage(bag).read_bytes()
        for _ in range(25):
            broken = bytearray(data[: rng.randrange(len(data))])
            for _ in range(rng.randrange(1, 4)):
                at = rng.randrange(len(broken) or 1)
                broken[at : at + rng.randrange(9)] = rng.randbytes(rng.randrange(9))
            file.write_bytes(broken)
            with contextlib.suppress(BagError):
                load_run(bag)
            with contextlib.suppress(BagError):
                recover(file)


def test_given_metadata_that_is_wrong_at_any_byte_when_read_then_nothing_is_silently_missing(bag):
    path, good = bag / 'metadata.yaml', contents(bag)[0]
    text, rng = path.read_bytes(), random.Random(5)
    for at in range(0, len(text), 61):
        data = bytearray(text)
        data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        try:
            found, warnings = contents(bag)
        except BagError as error:
            assert str(error).startswith(str(bag))
        else:
            assert found == good or warnings


# ------------------------------------------------------------------ files of others


def foreign(path, **options):
    """A file as other writers make it."""
    with open(path, 'wb') as stream:
        writer = Writer(stream, **options)
        writer.start('ros2', 'another one')
        schema = writer.register_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
        channel = writer.register_channel('/chatter', 'cdr', schema)
        for k in range(100):
            writer.add_message(channel, START + k, struct.pack('<III', 256, 4, 0x30 + k), START)
        writer.finish()
    return path


LZ4 = {'compression': CompressionType.LZ4, 'chunk_size': 500}
LOOSE = {'use_chunking': False}
PLAIN = {'compression': CompressionType.NONE, 'enable_crcs': False, 'chunk_size': 500}


@pytest.mark.parametrize('options', [LZ4, LOOSE, PLAIN], ids=['lz4', 'no chunks', 'no checksums'])
def test_given_a_file_of_another_writer_when_damaged_then_it_is_read_in_parts(tmp_path, options):
    file = foreign(tmp_path / 'a.mcap', **options)
    good, warnings = contents(file)
    assert (len(good), recover(file).nothing_lost) == (100, True)
    assert warnings == []
    data, rng, most = file.read_bytes(), random.Random(2), 0
    for size in range(0, len(data), 211):
        file.write_bytes(data[:size])
        try:
            found, _ = contents(file)
        except BagError:
            continue
        assert found == good[: len(found)]
        most = max(most, len(found))
    assert most > 80
    for _ in range(25):
        broken = bytearray(data)
        broken[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        file.write_bytes(broken)
        with contextlib.suppress(BagError):
            contents(file)
            recover(file)


@pytest.mark.parametrize('field', ['size', 'data', 'record'])
def test_given_sizes_of_petabytes_when_read_then_no_memory_is_taken_for_them(
    bag, field, monkeypatch
):
    data = bytearray(storage(bag).read_bytes())
    chunk = data.index(b'zstd') - 4 - 28 - 9
    place = {'record': chunk + 1, 'size': chunk + 9 + 16, 'data': chunk + 9 + 36}[field]
    data[place : place + 8] = struct.pack('<Q', 1 << 50)
    storage(bag).write_bytes(data)
    found, warnings = contents(bag)
    # Chunks are found by the index, and what is read of them has a checksum.
    assert len(found) == (18 if field == 'size' else 24)
    assert bool(warnings) == (field == 'size')


def test_given_a_bomb_when_read_then_it_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_file, 'MAX_CHUNK', 1000)
    bag = write_small(tmp_path / 'bag', 100, chunk_time=0)
    with pytest.raises(BagError, match='no chunk of it is whole'):
        contents(bag)


# ------------------------------------------------------------------ directories


def test_given_no_metadata_when_read_then_files_are_found_in_their_order(tmp_path):
    bag = write_small(tmp_path / 'bag', 200, split_time=20_000_000)
    good = contents(bag)[0]
    assert len(list(bag.glob('*.mcap'))) > 10
    (bag / 'metadata.yaml').unlink()
    found, warnings = contents(bag)
    assert found == good
    assert any('metadata.yaml' in text for text in warnings)


def test_given_a_file_that_is_missing_when_recovered_then_its_messages_are_counted(tmp_path):
    bag = write_small(tmp_path / 'bag', split_time=10_000_000)
    (bag / 'bag_1.mcap').unlink()
    found, warnings = contents(bag)
    assert len(found) == 18
    assert any('bag_1.mcap' in text for text in warnings)
    assert recover(bag).lost == 6


# ------------------------------------------------------------------ odd recordings


def record(path, stamps, positions=None, topic=JOINTS):
    with BagWriter(path) as writer:
        messages = BagMessages(writer.typestore, 'arm')
        writer.add_topic(topic, JOINT_STATE)
        for k, stamp in enumerate(stamps):
            position = [positions[k] if positions else k, 0.0]
            writer.write(
                topic,
                START + k,
                messages.joint_state(stamp, ('a', 'b'), position, [0.0, 0.0], [0.0, 0.0]),
            )
    return path


def test_given_time_that_goes_backwards_when_loaded_then_it_is_said(tmp_path):
    found = load_run(record(tmp_path / 'bag', [10, 20, 15, 30, 5]))
    assert found.stamps['joint_states'].tolist() == [5, 10, 15, 20, 30]
    assert found.warnings == [
        f'{JOINTS}: time goes backwards 2 times, messages are sorted by their stamps'
    ]


def test_given_duplicates_when_loaded_then_it_is_said(tmp_path):
    found = load_run(record(tmp_path / 'bag', [10, 20, 20, 30], [1, 2, 7, 3]))
    assert found.get('joint_states', 'position')[:, 0].tolist() == [1, 7, 3]
    assert found.warnings == [
        f'{JOINTS}: 1 messages have the stamp of another one, the last one of each stamp counts'
    ]


def test_given_a_good_run_when_loaded_then_there_is_no_warning(bag):
    assert load_run(bag).warnings == []


# ------------------------------------------------------------------ lpv recover


def run(capsys, *arguments):
    code = main(['recover', *map(str, arguments)])
    said = capsys.readouterr()
    assert 'Traceback' not in said.out + said.err
    return code, said.out, said.err


def test_given_a_good_bag_when_recovered_then_nothing_is_written_unless_asked(
    bag, tmp_path, capsys
):
    code, said, _ = run(capsys, bag)
    assert (code, 'the bag is whole' in said) == (0, True)
    assert [path.name for path in tmp_path.iterdir()] == ['bag']
    code, said, _ = run(capsys, bag, '--out', tmp_path / 'copy', '--preset', 'none')
    assert code == 0
    assert contents(tmp_path / 'copy') == contents(bag)


def cut_in_summary(bag):
    storage(bag).write_bytes(storage(bag).read_bytes()[:-100])


def without_metadata(bag):
    (bag / 'metadata.yaml').unlink()


def cut_in_a_chunk(bag):
    data = storage(bag).read_bytes()
    second = data.index(b'zstd', data.index(b'zstd') + 1)
    storage(bag).write_bytes(data[: second + 30])
    without_metadata(bag)


def wrong_checksum(bag):
    data = bytearray(storage(bag).read_bytes())
    data[data.index(b'zstd') + 50] ^= 4
    storage(bag).write_bytes(data)


def garbage_in_the_middle(bag):
    data = storage(bag).read_bytes()
    at = data.index(b'zstd', data.index(b'zstd') + 1) - 41  # where the second chunk begins
    storage(bag).write_bytes(data[:at] + random.Random(1).randbytes(5000) + data[at + 100 :])


@pytest.mark.parametrize(
    ('harm', 'code', 'said', 'count'),
    [
        (cut_in_summary, 0, 'nothing was lost', 24),
        (without_metadata, 0, 'nothing was lost', 24),
        (cut_in_a_chunk, 3, 'the recording was not finished', 6),
        (wrong_checksum, 3, r'joint_states +15 +5', 18),
        (garbage_in_the_middle, 3, r'joint_states +5 +15', 6),
    ],
    ids=lambda value: getattr(value, '__name__', None),
)
def test_given_a_damaged_bag_when_recovered_then_the_new_one_is_good_and_the_old_one_untouched(
    bag, tmp_path, capsys, harm, code, said, count
):
    harm(bag)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    readable = contents(bag)[0]
    found, out, _ = run(capsys, bag)
    assert found == code, out
    assert re.search(said, out), out
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    recovered, warnings = contents(tmp_path / 'bag_recovered')
    assert warnings == []
    assert recovered == readable
    assert len(recovered) == count
    assert run(capsys, tmp_path / 'bag_recovered')[0] == 0


def test_given_a_single_file_when_recovered_then_it_becomes_a_bag(bag, tmp_path, capsys):
    file = tmp_path / 'one.mcap'
    shutil.copy(storage(bag), file)
    file.write_bytes(file.read_bytes()[:-1])
    assert run(capsys, file)[0] == 0
    assert contents(tmp_path / 'one_recovered')[0] == contents(bag)[0]


@pytest.mark.parametrize('what', ['nothing', 'text.mcap', 'empty.mcap', 'folder', 'bag.db3'])
def test_given_what_is_no_bag_when_recovered_then_one_line_says_so_and_the_code_is_1(
    tmp_path, capsys, what
):
    (tmp_path / 'text.mcap').write_text('this is no bag\n' * 100)
    (tmp_path / 'empty.mcap').write_bytes(b'')
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'bag.db3').write_bytes(b'SQLite format 3\0')
    before = sorted(tmp_path.iterdir())
    code, out, said = run(capsys, tmp_path / what, '--out', tmp_path / 'new')
    assert (code, out, said.count('\n')) == (1, '', 1)
    assert what in said
    assert sorted(tmp_path.iterdir()) == before


def test_given_an_output_that_exists_when_recovered_then_it_stays(bag, tmp_path, capsys):
    wrong_checksum(bag)
    (tmp_path / 'bag_recovered').mkdir()
    (tmp_path / 'bag_recovered' / 'mine').write_text('mine')
    code, _, said = run(capsys, bag)
    assert (code, 'exists' in said) == (2, True)
    assert (tmp_path / 'bag_recovered' / 'mine').read_text() == 'mine'


def test_given_messages_of_a_topic_when_recovered_then_times_stay(bag, tmp_path):
    with BagWriter(tmp_path / 'a') as writer:
        writer.add_topic(CHATTER, 'std_msgs/msg/String')
        for k in range(10):
            writer.write_raw(CHATTER, START + k * STEP, bytes(12), publish_time=START - k)
    recover(tmp_path / 'a', tmp_path / 'b', 'none')
    assert storage(tmp_path / 'b').read_bytes()[:3000].count(struct.pack('<Q', START - 9)) == 1
    assert contents(tmp_path / 'a') == contents(tmp_path / 'b')


def test_given_gains_in_a_bag_when_recovered_then_they_are_copied_if_they_are_whole(
    tmp_path, paper_gains
):
    with BagWriter(tmp_path / 'a') as writer:
        writer.add_topic(CHATTER, 'std_msgs/msg/String')
        writer.write_raw(CHATTER, START, bytes(12))
    gains = tmp_path / 'a' / 'gains.yaml'
    save_gains(paper_gains, gains)
    assert recover(tmp_path / 'a', tmp_path / 'b').damages == []
    assert (tmp_path / 'b' / 'gains.yaml').read_bytes() == gains.read_bytes()
    gains.write_bytes(gains.read_bytes()[:500])
    (damage,) = recover(tmp_path / 'a', tmp_path / 'c').damages
    assert damage.startswith('gains.yaml is left out')
    assert not (tmp_path / 'c' / 'gains.yaml').exists()
