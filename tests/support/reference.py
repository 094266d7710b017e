"""The reference bag: what the diagnosis answers to one recording, so that changes are noticed.

``make reference`` replays the bag and stores the present answers; do so only where they were meant
to change, and say why in the commit.  The recording is of 6 s of the simulated arm of the paper,
with four faults, and lost, late and unusable samples; its gains are the shipped ones.
"""

import shutil
import tempfile
from pathlib import Path

from places import DATA
from rich.console import Console
from runs import copied

from lpv import load_arm, load_gains
from lpv.bag.replay.replay import Replay
from lpv.cli.commands.compare import show
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.support.timestamps import leading_stamp
from lpv.report.comparison import Tolerances, compare_runs, load_pair

BAG = DATA / 'reference.mcap'
TOLERANCES = Tolerances(mise=1e-3, delay=0.0, signal=1e-6, flags=0.0, missing=1.0)
"""Processors round differently in the last digits; everything else is a change of behaviour."""
_THINNED = 20
"""Of the estimates every so many are stored."""


def monitor(**options):
    return SerialSensorMonitor('', load_arm('paper'), gains=load_gains('paper'), **options)


def compare(replayed):
    arm = load_arm('paper')
    return compare_runs(*load_pair(BAG, replayed, arm), arm, TOLERANCES)


def renew():
    """Store what is answered now; the comparison with what was answered before."""
    with tempfile.TemporaryDirectory() as folder:
        replayed, new = Path(folder) / 'replayed', Path(folder) / 'reference'
        Replay(monitor()).run(BAG, replayed)
        before = compare(replayed)
        copied(replayed, new, lambda topic: topic[:5] == '/lpv/', _thinned, preset='zstd_small')
        shutil.copy(new / BAG.name, BAG)
    return before


def _thinned(topic, data):
    is_left_out = topic.endswith('_estimate') and leading_stamp(data) // 2_000_000 % _THINNED
    return None if is_left_out else data


if __name__ == '__main__':
    show(renew(), Console(soft_wrap=True, highlight=False))
    print(f'renewed {BAG}')
