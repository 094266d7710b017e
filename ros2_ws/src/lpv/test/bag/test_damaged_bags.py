"""Bags that are cut off, damaged or odd: what can be had is had, nothing wrong is let through."""

import contextlib
import random
import re
import shutil
import struct

import pytest
from bags import CHATTER, JOINT_STATE, JOINTS, START, STEP, contents, storage, write_small
from fuzzing import fuzz, mutate_bytes, mutate_text
from mcap.writer import CompressionType, Writer
from places import BRINGUP
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from lpv.bag.errors import BagError
from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag import mcap_file
from lpv.bag.rosbag.interfaces import make_typestore
from lpv.bag.rosbag.output_folder import GAINS_NAME, read_run_file
from lpv.bag.rosbag.recovery import recover
from lpv.bag.rosbag.writing import BagWriter
from lpv.bag.run.csv_import import import_csv, load_column_map
from lpv.bag.run.record import load_run
from lpv.cli.main import main
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.support.errors import ConfigError
from lpv.core.uio.certificate.gains import save_gains

pytestmark = [pytest.mark.filterwarnings('error'), pytest.mark.slow]
STRING = 'std_msgs/msg/String'


@pytest.fixture(autouse=True)
def quiet(caplog):
    """Ten thousands of warnings are not worth keeping."""
    caplog.set_level('CRITICAL', 'lpv.bag')


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
            try:
                assert complete or load_run(path).warnings
            except BagError:
                assert not complete
        self.read += bool(found)


def test_given_a_bag_that_is_cut_at_any_byte_when_read_then_what_comes_out_was_recorded(tmp_path):
    judge = Judge(write_small(tmp_path / 'bag', 8))
    sizes = range(0, len(judge.data), 37)
    for size in sizes:
        judge.check(judge.data[:size], single=size % 2)
    assert judge.read > len(sizes) / 3


@pytest.mark.parametrize(('preset', 'step'), [('none', 101), ('zstd_fast', 71)])
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


def test_given_metadata_that_is_wrong_at_any_byte_when_read_then_nothing_is_silently_missing(bag):
    path, good = bag / 'metadata.yaml', contents(bag)[0]
    text, rng = path.read_bytes(), random.Random(5)
    for at in range(0, len(text), 127):
        data = bytearray(text)
        data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        try:
            found, warnings = contents(bag)
        except BagError as error:
            assert str(error).startswith(str(bag))
        else:
            assert found == good or warnings


# ------------------------------------------------------------------ mutations of any kind


def sqlite(path):
    """A bag with the storage of older distributions, as rosbags writes it."""
    types = make_typestore()
    good = contents(write_small(path.with_name('good'), 60))[0]
    with RosbagsWriter(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection(JOINTS, JOINT_STATE, typestore=types)
        for topic, time, data in good:
            if topic == JOINTS:
                writer.write(connection, time, data)
    return path


@pytest.mark.fuzz
@pytest.mark.parametrize('kind', ['none', 'zstd_fast', 'metadata', 'sqlite'])
def test_given_a_mutated_bag_when_used_and_recovered_then_nothing_but_bag_errors_comes_out(
    tmp_path, kind
):
    path = tmp_path / 'bag'
    preset = kind if kind in ('none', 'zstd_fast') else 'zstd_fast'
    bag = sqlite(path) if kind == 'sqlite' else write_small(path, 60, preset=preset)
    (file,) = bag.glob(
        'metadata.yaml' if kind == 'metadata' else '*.db3' if kind == 'sqlite' else '*.mcap'
    )
    data = file.read_bytes()

    def use():
        contents(bag)
        load_run(bag)
        if kind != 'sqlite':
            shutil.rmtree(tmp_path / 'new', ignore_errors=True)
            recover(bag, tmp_path / 'new')
            assert not contents(tmp_path / 'new')[1]

    def mutate(seed):
        text = kind == 'metadata'
        file.write_bytes(mutate_text(data.decode(), seed) if text else mutate_bytes(data, seed))

    assert fuzz(40, mutate, use).refused or kind == 'metadata'


@pytest.mark.fuzz
def test_given_mutated_measurements_when_replayed_then_answers_or_bag_errors_come_out(
    real_arm, real_gains, tmp_path
):
    bag = write_small(tmp_path / 'bag', 120, preset='none', names=real_arm.joint_names)
    file, data = storage(bag), storage(bag).read_bytes()

    def replay():
        shutil.rmtree(tmp_path / 'out', ignore_errors=True)
        Replay(SerialSensorMonitor('', real_arm, gains=real_gains)).run(bag, tmp_path / 'out')
        record = load_run(tmp_path / 'out', joint_names=real_arm.joint_names)
        return {name: record.streams.get(name) for name in ('state_estimate', 'fault_estimate')}

    replay()  # what compiles takes its time
    unbounded = ('.fault_estimate.bound', '.fault_estimate.threshold')
    fuzz(20, lambda seed: file.write_bytes(mutate_bytes(data, seed)), replay, unbounded=unbounded)


@pytest.mark.fuzz
def test_given_mutated_csv_files_when_imported_then_a_bag_or_a_clear_error_comes_out(tmp_path):
    columns = 'time: {column: t}\njoints:\n  a: {position: q, velocity: w, effort: u}\n'
    text = 't,q,w,u\n' + ''.join(f'{k / 500},{k % 7}.5,-0.25,{k}\n' for k in range(60))
    (tmp_path / 'columns.yaml').write_text(columns)
    found, source = load_column_map(tmp_path / 'columns.yaml'), tmp_path / 'r.csv'

    def convert():
        shutil.rmtree(tmp_path / 'out', ignore_errors=True)
        import_csv(source, found, tmp_path / 'out')
        load_run(tmp_path / 'out', answers_only=True)

    assert fuzz(50, lambda seed: source.write_bytes(mutate_text(text, seed)), convert).refused


# ------------------------------------------------------------------ files of others


LZ4 = {'compression': CompressionType.LZ4, 'chunk_size': 500}
LOOSE = {'use_chunking': False}
PLAIN = {'compression': CompressionType.NONE, 'enable_crcs': False, 'chunk_size': 500}


@pytest.mark.parametrize('options', [LZ4, LOOSE, PLAIN], ids=['lz4', 'no chunks', 'no checksums'])
def test_given_a_file_of_another_writer_when_damaged_then_it_is_read_in_parts(tmp_path, options):
    file = tmp_path / 'a.mcap'
    with open(file, 'wb') as stream:
        writer = Writer(stream, **options)
        writer.start('ros2', 'another one')
        schema = writer.register_schema(STRING, 'ros2msg', b'string data\n')
        channel = writer.register_channel(CHATTER, 'cdr', schema)
        for k in range(100):
            writer.add_message(channel, START + k, struct.pack('<III', 256, 4, 0x30 + k), START)
        writer.finish()
    good, warnings = contents(file)
    assert (len(good), recover(file).nothing_lost, warnings) == (100, True, [])
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
def test_given_sizes_of_petabytes_when_read_then_no_memory_is_taken_for_them(bag, field):
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
    monkeypatch.setattr(mcap_file, 'MOST_BYTES', 1000)
    bag = write_small(tmp_path / 'bag', 100, chunk_time=0)
    with pytest.raises(BagError, match='no chunk of it is whole'):
        contents(bag)


def test_given_files_or_metadata_that_are_missing_when_read_then_the_others_are_and_it_is_said(
    tmp_path,
):
    bag = write_small(tmp_path / 'bag', 200, split_time=20_000_000)
    good, metadata = contents(bag)[0], (bag / 'metadata.yaml').read_bytes()
    assert len(list(bag.glob('*.mcap'))) > 10
    (bag / 'metadata.yaml').unlink()
    found, warnings = contents(bag)
    assert found == good  # in the order of their numbers
    assert any('metadata.yaml' in text for text in warnings)
    (bag / 'metadata.yaml').write_bytes(metadata)
    (bag / 'bag_1.mcap').unlink()
    found, warnings = contents(bag)
    assert any('bag_1.mcap' in text for text in warnings)
    assert recover(bag).lost == len(good) - len(found) == 12


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
    assert run(capsys, bag, '--out', tmp_path / 'copy', '--preset', 'none')[0] == 0
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
    assert found == code and re.search(said, out), out
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before
    assert contents(tmp_path / 'bag_recovered') == (readable, [])
    assert len(readable) == count
    assert run(capsys, tmp_path / 'bag_recovered')[0] == 0
    (tmp_path / 'bag_recovered' / 'mine').write_text('mine')
    code, _, told = run(capsys, bag)
    assert (code, 'exists' in told) == (2, True)
    assert (tmp_path / 'bag_recovered' / 'mine').read_text() == 'mine'


def test_given_a_single_file_when_recovered_then_it_becomes_a_bag(bag, tmp_path, capsys):
    (tmp_path / 'one.mcap').write_bytes(storage(bag).read_bytes()[:-1])
    assert run(capsys, tmp_path / 'one.mcap')[0] == 0
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


def test_given_times_and_gains_in_a_bag_when_recovered_then_they_stay_if_they_are_whole(
    tmp_path, paper_gains
):
    with BagWriter(tmp_path / 'a') as writer:
        writer.add_topic(CHATTER, STRING)
        for k in range(10):
            writer.write_raw(CHATTER, START + k * STEP, bytes(12), publish_time=START - k)
    gains = tmp_path / 'a' / GAINS_NAME
    save_gains(paper_gains, gains)
    assert recover(tmp_path / 'a', tmp_path / 'b', 'none').damages == []
    assert storage(tmp_path / 'b').read_bytes()[:3000].count(struct.pack('<Q', START - 9)) == 1
    assert contents(tmp_path / 'a') == contents(tmp_path / 'b')
    assert (tmp_path / 'b' / GAINS_NAME).read_bytes() == gains.read_bytes()
    gains.write_bytes(gains.read_bytes()[:500])
    (damage,) = recover(tmp_path / 'a', tmp_path / 'c').damages
    assert damage.startswith('gains.yaml is left out')
    assert not (tmp_path / 'c' / GAINS_NAME).exists()


@pytest.mark.parametrize(
    'text', ['{bandwidth: 10.0, loop: {format: 1}}', '{bandwidth: 10.0, other: 1.0}', '{}', None]
)
def test_given_a_gains_file_when_read_then_its_bytes_are_to_be_copied_if_it_is_good(tmp_path, text):
    if text is None:
        for path in (BRINGUP / 'gains' / f'{name}.yaml' for name in ('paper', 'ur10')):
            assert read_run_file(path, GAINS_NAME) == path.read_bytes()
        return
    path = tmp_path / 'gains.yaml'
    path.write_text(f'/**: {{ros__parameters: {text}}}\n', encoding='utf-8')
    with pytest.raises(ConfigError):
        read_run_file(path, GAINS_NAME)
