"""Replay of a long bag, against what merely decoding it costs others, on the same bag in one run.

Ours reads, decodes, observes, diagnoses and writes the estimates.  The peers decode the messages
and do nothing with them.  Each candidate runs in a process of its own; slow peers get a shorter
bag of the same kind, and the table says so.
"""

import argparse
import os
import resource
import shutil
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from rich.console import Console

OUT = Path('out')
REPLAYED = OUT / 'bench_replayed'
TOPICS = ('/lpv/joint_states', '/lpv/torque_command')


# ------------------------------------------------------------------ candidates


def _arm_and_gains():
    from lpv.files import load_arm, load_gains

    return load_arm('paper'), load_gains('paper')


def replay(bag):
    """Read, decode, observe, diagnose, write the estimates."""
    from lpv.bag.replay.replay import Replay
    from lpv.core.monitoring.serial_monitor import SerialSensorMonitor

    arm, gains = _arm_and_gains()
    shutil.rmtree(REPLAYED, ignore_errors=True)
    result = Replay(
        SerialSensorMonitor('', arm, gains=gains),
        torque_from_command=True,
        estimates_only=True,
        preset=os.environ.get('PRESET', 'zstd_fast'),
    ).run(bag, REPLAYED)
    return 2 * result.measurements


def decode(bag):
    """Our reading and decoding alone."""
    import numpy as np

    from lpv.bag.blocks.message_blocks import ahead
    from lpv.bag.rosbag.reading import open_bag
    from lpv.bag.run.measurements import EffortReader, MeasurementReader

    count, joints = 0, _arm_and_gains()[0].joint_names
    with open_bag(bag) as reader:
        connections = list(reader.connections)
        measured = np.array([c.topic == TOPICS[0] for c in connections])
        measurements = MeasurementReader(reader, joints)
        efforts = EffortReader(reader, 'lpv_msgs/msg/TorqueCommand', joints)
        for block in ahead(reader.blocks(connections)):
            mask = measured[block.connection]
            positions = np.flatnonzero(mask)
            found = measurements.read(block, positions)
            efforts.before(block, np.flatnonzero(~mask), found.places)
            count += len(block)
    return count


def rosbags(bag):
    """rosbags' AnyReader."""
    from rosbags.highlevel import AnyReader

    count = 0
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            count += 1
    return count


def roboto(bag):
    """roboto-mcap-codec: Rust, into Arrow, a channel at a time."""
    import mcap_codec

    count, path = 0, _file(bag)
    for topic in TOPICS:
        with open(path, 'rb') as file:

            def read(offset, length, file=file):
                file.seek(offset)
                return file.read(length)

            with mcap_codec.open_mcap_file(
                read,
                path.stat().st_size,
                channel=mcap_codec.TopicName(topic),
                timestamp=mcap_codec.TimestampSource('message_log_time'),
            ) as cursor:
                count += sum(batch.num_rows for batch in cursor)
    return count


def _file(bag):
    (file,) = Path(bag).glob('*.mcap')
    return file


OURS = {'lpv replay, all': replay, 'lpv replay, decoding only': decode}
SLOW = {'rosbags AnyReader': rosbags}
CANDIDATES = {**OURS, 'roboto-mcap-codec': roboto, **SLOW}


# ------------------------------------------------------------------ measuring


def measured(work, argument):
    """What some work returns, or which package it lacks; its times [s] and memory [byte]."""
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        result = {'returned': work(argument)}
    except ImportError as error:
        result = {'missing': str(error)}
    result.update(wall=time.perf_counter() - wall, cpu=time.process_time() - cpu)
    return result | {'memory': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024}


def alone(work, argument):
    """The same in a process of its own, and how long that lasts [s]."""
    begin = time.perf_counter()
    with ProcessPoolExecutor(1, get_context('spawn')) as pool:
        result = pool.submit(measured, work, argument).result()
    return result | {'process': time.perf_counter() - begin}


def prepare(hours):
    """Make the bag of a length, if it is not there; its measurements."""
    from long_bag import long_bag

    return long_bag(_bag(hours), *_arm_and_gains(), hours)


def _bag(hours):
    return OUT / f'bench_{hours:g}h'


def main():
    """Measure all, and show the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=1.0, help='length of the bag (1)')
    parser.add_argument(
        '--peer-hours', type=float, default=0.05, help='length of the bag for slow peers (0.05)'
    )
    parser.add_argument('--rounds', type=int, default=3, help='of ours; the best one counts (3)')
    arguments = parser.parse_args()
    from lpv.report.table import print_grid  # only here: its memory is none of a candidate's

    OUT.mkdir(exist_ok=True)
    console = Console(soft_wrap=True, highlight=False, width=120)
    # In a process of its own, too: what this one has taken would count as memory of the others.
    long, short = (
        (_bag(hours), alone(prepare, hours)['returned'])
        for hours in (arguments.hours, min(arguments.hours, arguments.peer_hours))
    )
    size = _file(long[0]).stat().st_size
    console.print(
        f'{long[1]} measurements and {long[1]} torques ({arguments.hours:g} h), '
        f'{size / 1e6:.0f} MB, zstd'
    )
    rows = []
    for name, work in CANDIDATES.items():
        bag, count = short if name in SLOW else long
        rounds = arguments.rounds if name in OURS else 1
        result = min((alone(work, bag) for _ in range(rounds)), key=lambda r: r['wall'])
        if 'missing' in result:
            console.print(f'{name} is not installed: {result["missing"]}')
            continue
        assert result['returned'] == 2 * count, (name, result)
        rows.append((
            name, f'{count / long[1] * arguments.hours:.3g}', f'{result["wall"]:.2f}',
            f'{result["cpu"]:.2f}', f'{result["process"]:.2f}',
            f'{1e6 * result["wall"] / result["returned"]:.2f}', f'{result["memory"] / 1e6:.0f}',
        ))  # fmt: skip
    heads = '>wall [s]', '>processor [s]', '>process [s]', '>us/message', '>memory [MB]'
    print_grid(console, ('', '>hours', *heads), rows)
    written = sum(file.stat().st_size for file in REPLAYED.iterdir())
    console.print(f'the estimates take {written / 1e6:.0f} MB')
    shutil.rmtree(REPLAYED)


if __name__ == '__main__':
    main()
