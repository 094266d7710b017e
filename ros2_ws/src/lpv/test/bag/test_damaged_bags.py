import contextlib
import random
import re
import shutil
import struct

import pytest
from bag_messages import CHATTER, JOINTS, START, STEP, STRING, TOPICS, text
from bags import KINDS, contents, storage, write_by_mcap, write_by_rosbags, write_small
from fuzzing import fuzz, mutate_bytes, mutate_text
from mcap.writer import Writer as McapWriter
from places import BRINGUP
from rosbags.rosbag2 import StoragePlugin

from lpv import ConfigError, save_gains
from lpv.bag.errors import BagError
from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag import mcap_file, writing
from lpv.bag.rosbag.output_folder import GAINS_NAME, read_run_file
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.recovery import recover
from lpv.bag.run.csv_import import import_csv, load_column_map
from lpv.bag.run.record import load_run
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor

strict = pytest.mark.filterwarnings('error')
pytestmark = [strict, pytest.mark.slow, pytest.mark.usefixtures('quiet')]


@pytest.fixture
def bag(tmp_path):
    return write_small(tmp_path / 'bag')


def judge(path, good, load):
    """Read, load and recover a bag, or the file alone, of which one thing at most is wrong: nothing
    that was not recorded comes out, and what is missing is said.  Whether there is anything."""
    try:
        found, warnings = contents(path)
    except BagError as error:
        assert str(error).startswith(str(path)) and '\n' not in str(error)
        pytest.raises(BagError, recover, path)
        return False
    left, complete = iter(good), len(found) == len(good)
    assert all(message in left for message in found), 'not a part of what was recorded'
    assert complete or warnings, 'messages are missing, and nobody says so'
    result = recover(path)
    assert sum(topic.recovered for topic in result.topics.values()) == len(found)
    assert complete or not result.nothing_lost
    if path.is_dir():  # metadata.yaml is there, and says how many there were
        assert len(found) + result.lost == len(good)
    if load and not complete:
        with contextlib.suppress(BagError):  # too little is left
            assert load_run(path).warnings
    return bool(found)


def cut(data, at, rng):
    return data[:at]


def flipped(data, at, rng):
    return data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]


HARMS = [(cut, 'zstd_fast', 37, 0.33), (flipped, 'none', 101, 0.8), (flipped, 'zstd_fast', 71, 0.8)]


@pytest.mark.parametrize('harm, preset, step, readable', HARMS)
def test_given_a_wrong_byte_when_read_then_all_was_recorded(tmp_path, harm, preset, step, readable):
    bag, rng, read = write_small(tmp_path / 'bag', 8, preset=preset), random.Random(3), 0
    file, (good, _) = storage(bag), contents(bag)
    data = file.read_bytes()
    places = range(0, len(data), step)
    for at in places:
        file.write_bytes(harm(data, at, rng))
        read += judge(rng.choice((bag, file)), good, load=read % 4 == 0)
    assert read > readable * len(places)


@pytest.mark.parametrize('left', ['file', 'bag', 'no metadata'])
def test_given_a_sqlite_bag_that_was_cut_off_when_read_then_what_is_whole_is(tmp_path, left):
    content = [(JOINTS, START + k * STEP, 24 * bytes([k % 256])) for k in range(1500)]
    bag = write_by_rosbags(tmp_path / 'bag', content)
    (file,) = bag.glob('*.db3')
    data, most, before = file.read_bytes(), 0, sorted(tmp_path.rglob('*'))
    if left == 'no metadata':
        (bag / 'metadata.yaml').unlink()
    read = file if left == 'file' else bag
    for size in range(len(data) // 10, len(data) - 4096, 3301):
        file.write_bytes(data[:size])
        try:
            found, warnings = contents(read)
        except BagError as error:
            assert size < 40_000 and str(error).startswith(str(read))  # definitions are missing
            continue
        assert found == content[: len(found)] and len(found) >= most and warnings
        most = len(found)
    result = recover(read, tmp_path / 'new')
    assert contents(tmp_path / 'new') == (found, [])
    assert result.lost == (len(content) - most if left == 'bag' else 0) and result.cut == (
        [] if left == 'bag' else [file.name])  # fmt: skip
    shutil.rmtree(tmp_path / 'new')
    assert most > 0.9 * len(content)
    file.write_bytes(data)
    found, warnings = contents(read)
    assert (found, bool(warnings)) == (content, left == 'no metadata')
    if left != 'no metadata':
        assert sorted(tmp_path.rglob('*')) == before
    file.write_bytes(b'SQLite format 3' + bytes(5000))
    pytest.raises(BagError, contents, read).match('damaged or incomplete')


@pytest.mark.fuzz
@pytest.mark.parametrize('kind', ['none', 'zstd_fast', 'metadata', 'sqlite'])
def test_given_a_mutated_bag_when_used_then_only_bag_errors(real_arm, real_gains, tmp_path, kind):
    preset = 'none' if kind == 'none' else 'zstd_fast'
    bag = write_small(tmp_path / 'bag', 120, preset=preset, names=real_arm.joint_names)
    if kind == 'sqlite':
        measured = [entry for entry in contents(bag)[0] if entry[0] == JOINTS]
        bag = write_by_rosbags(tmp_path / 'old', measured)
    (file,) = bag.glob({'metadata': 'metadata.yaml', 'sqlite': '*.db3'}.get(kind, '*.mcap'))
    data, good = file.read_bytes(), contents(bag)[0]

    def use():
        found, warnings = contents(bag)
        assert found == good or warnings or kind == 'sqlite', 'silently missing'
        load_run(bag)
        for name in ('new', 'out'):
            shutil.rmtree(tmp_path / name, ignore_errors=True)
        if kind != 'sqlite':
            recover(bag, tmp_path / 'new')
            assert not contents(tmp_path / 'new')[1]
        if kind != 'none':
            return None
        Replay(SerialSensorMonitor('', real_arm, gains=real_gains)).run(bag, tmp_path / 'out')
        record = load_run(tmp_path / 'out', joint_names=real_arm.joint_names)
        return {name: record.streams.get(name) for name in ('state_estimate', 'fault_estimate')}

    def mutate(seed):
        text = kind == 'metadata'
        file.write_bytes(mutate_text(data.decode(), seed) if text else mutate_bytes(data, seed))

    use()  # what compiles takes its time
    unbounded = ('.fault_estimate.bound', '.fault_estimate.threshold')
    assert fuzz(40, mutate, use, unbounded=unbounded).refused or kind == 'metadata'


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


@pytest.mark.parametrize('kind', ['lz4', 'no chunks', 'no checksums'])
def test_given_a_file_of_another_writer_when_damaged_then_it_is_read_in_parts(tmp_path, kind):
    content = [(CHATTER, START + k, text('abc')) for k in range(100)]
    file = write_by_mcap(tmp_path / 'a.mcap', content, 500, **KINDS[kind])
    good, warnings = contents(file)
    assert (good, recover(file).nothing_lost, warnings) == (content, True, [])
    data, rng, most = file.read_bytes(), random.Random(2), 0
    for size in range(0, len(data), 211):
        file.write_bytes(data[:size])
        with contextlib.suppress(BagError):
            found, _ = contents(file)
            assert found == good[: len(found)]
            most = max(most, len(found))
    assert most > 80
    if kind == 'no checksums':  # an index with wrong times is not believed
        at = data.rindex(struct.pack('<Q', START + 99))
        file.write_bytes(data[:at] + b'\xff' * 8 + data[at + 8 :])
        found, warnings = contents(file)
        assert found == good and 'the times of a chunk are wrong' in warnings[0]
    for _ in range(25):
        file.write_bytes(flipped(data, rng.randrange(len(data)), rng))
        with contextlib.suppress(BagError):
            contents(file)
            recover(file)


def test_given_a_file_of_another_tool_without_messages_when_read_then_it_is_not_damaged(tmp_path):
    bag = write_by_rosbags(tmp_path / 'bag', [], StoragePlugin.MCAP)
    assert contents(bag) == ([], [])


@pytest.mark.parametrize('left_out', ['repeat_channels', 'repeat_schemas', 'counts', 'chunks'])
def test_given_a_short_summary_when_read_then_all_is_found_and_it_is_not_damaged(
    tmp_path, monkeypatch, left_out
):
    def finish(writer):
        writer.add_attachment(START, START, 'notes', 'text/plain', b'abc')
        if left_out == 'counts':  # an empty map says that they are not known
            writer._Writer__statistics.channel_message_counts.clear()
        end(writer)

    end, content = McapWriter.finish, [(CHATTER, START + k, text('abc')) for k in range(100)]
    monkeypatch.setattr(McapWriter, 'finish', finish)
    options = {'chunks': {'use_chunking': False}, 'counts': {}}.get(left_out, {left_out: False})
    file = write_by_mcap(tmp_path / 'a.mcap', content, 500, **options)
    assert contents(file) == (content, [])
    with open_bag(file) as reader:
        assert TOPICS[CHATTER] in {connection.msgtype for connection in reader.connections}
    assert recover(file).attachments == 1


@pytest.mark.parametrize('field', ['size', 'data', 'record'])
def test_given_sizes_of_petabytes_when_read_then_no_memory_goes(bag, tmp_path, monkeypatch, field):
    data = bytearray(storage(bag).read_bytes())
    chunk = data.index(b'zstd') - 4 - 28 - 9
    place = {'record': chunk + 1, 'size': chunk + 9 + 16, 'data': chunk + 9 + 36}[field]
    data[place : place + 8] = struct.pack('<Q', 1 << 50)
    storage(bag).write_bytes(data)
    found, warnings = contents(bag)
    # Chunks are found by the index, and what is read of them has a checksum.
    assert (len(found), bool(warnings)) == ((18, True) if field == 'size' else (24, False))
    # Nor is a bomb unpacked.
    monkeypatch.setattr(mcap_file, 'MOST_BYTES', 1000)
    with pytest.raises(BagError, match='no chunk of it is whole'):
        contents(write_small(tmp_path / 'bomb', 100, chunk_time=0))


def test_given_missing_files_or_metadata_when_read_then_the_others_are_and_it_is_said(tmp_path):
    bag = write_small(tmp_path / 'bag', 200, split_time=20_000_000)
    good, _ = contents(bag)
    assert len(list(bag.glob('*.mcap'))) > 10
    for missing, lost in (('metadata.yaml', 0), ('bag_1.mcap', 12)):
        content = (bag / missing).read_bytes()
        (bag / missing).unlink()
        found, warnings = contents(bag)
        assert lost or found == good, 'not in the order of their numbers'
        assert any(missing in text for text in warnings)
        assert recover(bag).lost == len(good) - len(found) == lost
        (bag / missing).write_bytes(content)


@pytest.mark.parametrize('place, said', [
    (3, 'bag_3.mcap was cut off: what came between it and the next file is lost'),
    (-1, r'the recording was not finished: what came after its first 0\.\d+ s is lost'),
])  # fmt: skip
@pytest.mark.parametrize('left', [0, 500])
def test_given_a_part_without_end_when_recovered_then_it_is_told(tmp_path, call, place, said, left):
    bag = write_small(tmp_path / 'bag', 200, split_time=20_000_000)
    (bag / 'metadata.yaml').unlink()
    part = bag / f'bag_{place % len(list(bag.iterdir()))}.mcap'
    part.write_bytes(part.read_bytes()[:left])
    out = call('recover', bag, code=3).out
    lost = [line for line in out.splitlines() if line.endswith(' is lost')]
    assert len(lost) == 1 and re.fullmatch(said, lost[0])
    assert recover(bag).end_missing is (place < 0)


def test_given_a_good_bag_when_recovered_then_it_is_copied_if_asked(bag, tmp_path, call):
    assert 'the bag is whole' in call('recover', bag).out
    assert [path.name for path in tmp_path.iterdir()] == ['bag']
    call('recover', bag, '--out', tmp_path / 'copy', '--preset', 'none')
    assert contents(tmp_path / 'copy') == contents(bag)
    # A file alone becomes a bag.
    (tmp_path / 'one.mcap').write_bytes(storage(bag).read_bytes()[:-1])
    call('recover', tmp_path / 'one.mcap')
    assert contents(tmp_path / 'one_recovered')[0] == contents(bag)[0]


def harm(bag, kind):
    data = storage(bag).read_bytes()
    first = data.index(b'zstd')
    second, garbage = data.index(b'zstd', first + 1), random.Random(1).randbytes(5000)
    harmed = {
        'cut in the summary': data[:-100],
        'cut in a chunk': data[: second + 30],
        'wrong checksum': flipped(data, first + 50, random.Random(1)),
        'garbage between chunks': data[: second - 41] + garbage + data[second + 59 :],
    }
    storage(bag).write_bytes(harmed.get(kind, data))
    if kind in ('no metadata', 'cut in a chunk'):
        (bag / 'metadata.yaml').unlink()


@pytest.mark.parametrize('kind, code, said, count', [
    ('cut in the summary', 0, 'nothing was lost', 24),
    ('no metadata', 0, 'nothing was lost', 24),
    ('cut in a chunk', 3, 'the recording was not finished', 6),
    ('wrong checksum', 3, r'joint_states +15 +5', 18),
    ('garbage between chunks', 3, r'joint_states +5 +15', 6),
])  # fmt: skip
def test_given_a_damaged_bag_when_recovered_then_the_new_one_is_good_and_the_old_one_untouched(
    bag, tmp_path, call, refused, monkeypatch, kind, code, said, count
):
    harm(bag, kind)
    monkeypatch.chdir(bag)
    before, new = {path: path.read_bytes() for path in bag.iterdir()}, tmp_path / 'bag_recovered'
    readable, _ = contents(bag)
    assert re.search(said, call('recover', '.', code=code).out)
    assert {path: path.read_bytes() for path in bag.iterdir()} == before
    assert contents(new) == (readable, []) and len(readable) == count
    call('recover', new)
    (new / 'mine').write_text('mine')
    assert refused('exists', 'recover', bag) and (new / 'mine').read_text() == 'mine'


FILES = {f'text.{kind}': b'this is no bag\n' * 100 for kind in ('mcap', 'db3', 'bag', 'txt')}
FILES |= {'empty.mcap': b'', 'bag.db3': b'SQLite format 3\0'}


@pytest.mark.parametrize('what', ['nothing', 'nothing.mcap', 'folder', 'no_storage', *FILES])
def test_given_what_is_no_bag_when_recovered_then_one_line_says_so(bag, tmp_path, call, what):
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / 'folder').mkdir()
    shutil.copytree(bag, tmp_path / 'no_storage', ignore=shutil.ignore_patterns('*.mcap'))
    before = sorted(tmp_path.iterdir())
    out, said = call('recover', tmp_path / what, '--out', tmp_path / 'new', code=1)
    assert (out, said.count('\n')) == ('', 1) and said.startswith(f'lpv recover: {tmp_path / what}')
    assert sorted(tmp_path.iterdir()) == before


def test_given_times_and_gains_when_recovered_then_they_stay_if_whole(tmp_path, paper_gains):
    a, b, c = (tmp_path / name for name in 'abc')
    with writing.BagWriter(a) as writer:
        writer.add_topic(CHATTER, STRING)
        for k in range(10):
            writer.write_raw(CHATTER, START + k * STEP, bytes(12), publish_time=START - k)
    gains = a / GAINS_NAME
    save_gains(paper_gains, gains)
    assert recover(a, b, 'none').damages == []
    assert storage(b).read_bytes()[:3000].count(struct.pack('<Q', START - 9)) == 1
    assert contents(a) == contents(b) and (b / GAINS_NAME).read_bytes() == gains.read_bytes()
    gains.write_bytes(gains.read_bytes()[:500])
    (damage,) = recover(a, c).damages
    assert damage.startswith('gains.yaml is left out') and not (c / GAINS_NAME).exists()
    for path in (BRINGUP / 'gains' / f'{name}.yaml' for name in ('paper', 'ur10')):
        assert read_run_file(path, GAINS_NAME) == path.read_bytes()
    for bad in ('{bandwidth: 10.0, loop: {format: 1}}', '{bandwidth: 10.0, other: 1.0}', '{}'):
        gains.write_text(f'/**: {{ros__parameters: {bad}}}\n', encoding='utf-8')
        pytest.raises(ConfigError, read_run_file, gains, GAINS_NAME)
