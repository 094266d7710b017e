"""Mutated bags and CSV recordings: no traceback, clear messages, bounded memory."""

import shutil

import pytest
from bags import JOINT_STATE, storage, write_small
from fuzzing import Tally, cases, mutate_bytes, mutate_text, peak_memory
from places import BRINGUP
from rosbags.rosbag2 import StoragePlugin, Writer

from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.reading import open_bag
from lpv_bag.rosbag.recovery import recover
from lpv_bag.run.csv_import import import_csv, load_column_map
from lpv_bag.run.record import load_run
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.uio.certificate.gains import load_gains

pytestmark = [pytest.mark.fuzz, pytest.mark.slow]
_CASES = 80
_MEMORY = 300 << 20
COLUMNS = 'time: {column: t}\njoints:\n  a: {position: q, velocity: w, effort: u}\n'
CSV = 't,q,w,u\n' + ''.join(f'{k / 500},{k % 7}.5,-0.25,{k}\n' for k in range(60))


@pytest.fixture(autouse=True)
def quiet(caplog):
    caplog.set_level('CRITICAL', 'lpv_bag')


@pytest.fixture(scope='module', params=['none', 'zstd_fast'])
def mcap(request, tmp_path_factory):
    return write_small(tmp_path_factory.mktemp('mcap') / 'bag', 120, preset=request.param)


@pytest.fixture(scope='module')
def sqlite(tmp_path_factory):
    """A bag with the storage of older distributions, as rosbags writes it."""
    path = tmp_path_factory.mktemp('sqlite') / 'bag'
    with Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        from lpv_bag.rosbag.interfaces import make_typestore

        store = make_typestore()
        messages = BagMessages(store, 'arm')
        connection = writer.add_connection('/joint_states', JOINT_STATE, typestore=store)
        for stamp in range(10**9, 10**9 + 120 * 2_000_000, 2_000_000):
            message = messages.joint_state(stamp, 'ab', [1.0, 2.0], [0.0, 0.0], [3.0, 4.0])
            writer.write(connection, stamp, store.serialize_cdr(message, JOINT_STATE))
    return path


def use(path):
    """All that the commands do with a bag."""
    with open_bag(path) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
    load_run(path)


def fuzz(read, mutate, count=_CASES):
    """Counts of a fuzzer; ``mutate`` lays the file for a seed, ``read`` uses it."""
    tally, memory = Tally(), peak_memory()
    for seed in cases(count):
        mutate(seed)
        tally.run(seed, read)
    print(tally)
    assert not tally.failed
    assert peak_memory() - memory < _MEMORY
    return tally


def copy(bag, tmp_path):
    return shutil.copytree(bag, tmp_path / 'bag')


def test_given_mutated_mcap_files_when_used_then_nothing_but_bag_errors_comes_out(mcap, tmp_path):
    bag = copy(mcap, tmp_path)
    file, data = storage(bag), storage(mcap).read_bytes()
    tally = fuzz(lambda: use(bag), lambda seed: file.write_bytes(mutate_bytes(data, seed)))
    assert tally.refused and tally.accepted


def test_given_mutated_mcap_files_when_recovered_then_the_new_bag_is_whole(mcap, tmp_path):
    bag = copy(mcap, tmp_path)
    file, data = storage(bag), storage(mcap).read_bytes()

    def mended():
        shutil.rmtree(tmp_path / 'new', ignore_errors=True)
        recover(bag, tmp_path / 'new')
        with open_bag(tmp_path / 'new') as reader:
            assert not reader.warnings
            for _ in reader.messages():
                pass

    fuzz(mended, lambda seed: file.write_bytes(mutate_bytes(data, seed)), 40)


def test_given_mutated_metadata_when_used_then_nothing_but_bag_errors_comes_out(mcap, tmp_path):
    bag = copy(mcap, tmp_path)
    text = (mcap / 'metadata.yaml').read_text()
    tally = fuzz(
        lambda: use(bag), lambda seed: (bag / 'metadata.yaml').write_bytes(mutate_text(text, seed))
    )
    assert tally.accepted


def test_given_mutated_sqlite_files_when_used_then_nothing_but_bag_errors_comes_out(
    sqlite, tmp_path
):
    bag = copy(sqlite, tmp_path)
    (file,) = bag.glob('*.db3')
    data = file.read_bytes()
    tally = fuzz(lambda: use(bag), lambda seed: file.write_bytes(mutate_bytes(data, seed)))
    assert tally.refused and tally.accepted


def test_given_mutated_measurements_when_replayed_then_answers_or_bag_errors_come_out(
    real_arm, tmp_path
):
    gains, good = load_gains(BRINGUP / 'gains' / 'real_arm.yaml'), tmp_path / 'good'
    write_small(good, 120, preset='none', names=real_arm.joint_names)
    bag = copy(good, tmp_path)
    file, data = storage(bag), storage(good).read_bytes()

    def replay():
        shutil.rmtree(tmp_path / 'out', ignore_errors=True)
        Replay(SerialSensorMonitor('', real_arm, gains=gains)).run(bag, tmp_path / 'out')
        record = load_run(tmp_path / 'out', joint_names=real_arm.joint_names)
        return {name: record.streams.get(name) for name in ('state_estimate', 'fault_estimate')}

    replay()  # what compiles takes its time
    tally = Tally(unbounded=('.fault_estimate.bound', '.fault_estimate.threshold'))
    for seed in cases(30):
        file.write_bytes(mutate_bytes(data, seed))
        tally.run(seed, replay)
    print(tally)
    assert not tally.failed
    assert tally.accepted


def test_given_mutated_csv_files_when_imported_then_a_bag_or_a_clear_error_comes_out(tmp_path):
    (tmp_path / 'columns.yaml').write_text(COLUMNS)
    columns, source = load_column_map(tmp_path / 'columns.yaml'), tmp_path / 'r.csv'

    def convert():
        shutil.rmtree(tmp_path / 'out', ignore_errors=True)
        import_csv(source, columns, tmp_path / 'out')
        load_run(tmp_path / 'out', answers_only=True)

    tally = fuzz(convert, lambda seed: source.write_bytes(mutate_text(CSV, seed)), 50)
    assert tally.refused and tally.accepted
