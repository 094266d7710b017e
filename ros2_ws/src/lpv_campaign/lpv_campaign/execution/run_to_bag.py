"""One run of a campaign as a bag: what the graph would have recorded."""

import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from lpv_bag.replay.answer_records import RecordTemplate
from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter, qos_profile
from lpv_bag.run.measurements import MEASUREMENT_TYPE
from lpv_bag.run.record import load_run
from lpv_campaign.execution.run_files import write_run_files
from lpv_campaign.execution.runs import RunPlan
from lpv_core.decision.diagnosis import Alarm
from lpv_core.model.arm import ArmParameters
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.simulation.closed_loop import Run
from lpv_core.support.errors import ConfigError, LpvError
from lpv_core.support.timestamps import NANOSECONDS

NAMESPACE = '/lpv'
START = NANOSECONDS
"""Stamp of the first sample [ns], as in the lockstep graph: zero means "not set" in ROS."""
_TRUTH, _MEASURED, _COMMAND, _REFERENCE = range(4)
_ROWS = 2000
"""Samples in a chunk."""
_TYPES = {
    _TRUTH: ('ground_truth', 'lpv_msgs/msg/GroundTruth'),
    _MEASURED: ('joint_states', MEASUREMENT_TYPE),
    _COMMAND: ('torque_command', 'lpv_msgs/msg/TorqueCommand'),
    _REFERENCE: ('reference', 'lpv_msgs/msg/JointReference'),
}
_ANSWERS = {
    'estimate': ('state_estimate', 'position'),
    'estimated_velocity': ('state_estimate', 'velocity'),
    'fault_estimate': ('fault_estimate', 'estimate'),
    'threshold': ('fault_estimate', 'threshold'),
    'alarm': ('fault_estimate', 'alarm'),
}
"""Signals of a run that must be those of its bag, bit by bit."""


def stamps_of(run: Run) -> np.ndarray:
    """Header stamps of a run's samples in its bag.

    Returns ndarray of int64 of shape (n,): [ns].
    """
    return START + np.array([round(t * 1e9) for t in run.time.tolist()], np.int64)


def write_run_bag(plan: RunPlan, run: Run, out: str | Path) -> None:
    """Write a run as a bag, with the files that repeat it.

    Measurements, commands, references and truth come from the run; the answers of observer and
    diagnosis from a replay of these measurements, which must give what the run had.

    Parameters
    ----------
    plan : RunPlan
        What was simulated.
    run : lpv_core.simulation.closed_loop.Run
        What came out.
    out : str or pathlib.Path
        Bag to create.

    Raises
    ------
    ConfigError
        If it exists already or cannot be made.
    LpvError
        If the replay does not answer as the run did.
    """
    out = Path(out)
    if out.exists():
        raise ConfigError('--bag', 'exists already: name a new folder', str(out))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(prefix='.', dir=out.parent)
    except OSError as error:
        raise ConfigError('--bag', f'cannot be written: {error}', str(out)) from error
    with folder as name:
        measured, whole = Path(name) / 'measured', Path(name) / out.name
        _write_signals(plan, run, measured)
        monitor = SensorMonitor(f'{NAMESPACE}/uio', plan.arm, plan.gains, plan.parameters)
        Replay(monitor, preset='zstd_fast').run(measured, whole)
        check_answers(run, whole)
        write_run_files(plan, whole)
        shutil.move(whole, out)


def check_answers(run: Run, bag: str | Path) -> None:
    """Compare the answers in the bag of a run with those that the run had."""
    record, stamps = load_run(bag), stamps_of(run)
    kept = ~run.lost
    expected = {stream: stamps[kept] for stream in ('state_estimate', 'fault_estimate')}
    for name, (stream, field) in _ANSWERS.items():
        found = record.stamps.get(stream, np.empty(0, np.int64))
        # Nothing is estimated before the first usable measurement.
        first = np.searchsorted(stamps[kept], found[0]) if len(found) else len(stamps[kept])
        if not np.array_equal(found, expected[stream][first:]):
            raise LpvError(f'{bag}: {stream} has other samples than the run')
        answers = record.get(stream, field)
        expected_answers = getattr(run, name)[kept][first:]
        if answers is not None and not np.array_equal(answers, expected_answers, equal_nan=True):
            raise LpvError(f'{bag}: the replay gives another {name} than the run')
    if [_alarm(a, 0) for a in record.alarms] != [_alarm(a, START) for a in run.alarms]:
        raise LpvError(f'{bag}: the replay gives other alarms than the run')


def _alarm(alarm: Alarm, shift: int) -> tuple[Any, ...]:
    return (
        int(alarm.event),
        alarm.sensor,
        alarm.onset + shift,
        alarm.detected + shift,
        alarm.size,
        alarm.bound,
        alarm.kind,
        alarm.confidence,
    )


def differences(stored: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Figures that are not what the results of the campaign say."""
    return [name for name in found if name in stored and not _same(stored[name], found[name])]


def _same(one: Any, two: Any) -> bool:
    if isinstance(one, (list, tuple)) and isinstance(two, (list, tuple)):
        return len(one) == len(two) and all(map(_same, one, two))
    if isinstance(one, float) and isinstance(two, float):
        return (
            one == two
            or math.isnan(one)
            and math.isnan(two)
            or math.isclose(one, two, rel_tol=1e-9, abs_tol=1e-12)
        )
    return one == two


class _Signals:
    """Vectors of the messages of a run."""

    def __init__(self, run: Run) -> None:
        self.stamps = stamps_of(run)
        effort = np.vstack([np.zeros((1, 2)), run.torque[:-1]])
        reference = run.path[:, run.place]
        self.values = {
            _TRUTH: {
                'position': run.position,
                'velocity': run.velocity,
                'torque': effort,
                'fault': run.fault,
                'disturbance': run.disturbance,
            },
            _MEASURED: {
                'position': run.measured,
                'velocity': run.measured_velocity,
                'effort': effort,
            },
            _COMMAND: {
                'torque': np.where(run.safe_stop[:, None], 0.0, run.command),
                'safe_stop': run.safe_stop,
            },
            _REFERENCE: dict(
                zip(('position', 'velocity', 'acceleration', 'tip_position'), reference)
            ),
        }
        self.chosen = {
            _TRUTH: np.ones(len(run.time), bool),
            _MEASURED: ~run.lost,
            _COMMAND: ~run.lost,
            _REFERENCE: ~run.lost & ~run.safe_stop,
        }


def _write_signals(plan: RunPlan, run: Run, path: Path) -> None:
    signals = _Signals(run)
    bag = BagWriter(path)
    try:
        templates = _templates(bag, plan.arm)
        for first in range(0, len(run.time), _ROWS):
            parts = []
            for kind, template in templates.items():
                rows = first + np.flatnonzero(signals.chosen[kind][first : first + _ROWS])
                stamps = signals.stamps[rows]
                values = {name: array[rows] for name, array in signals.values[kind].items()}
                parts.append(template.fill(stamps, stamps, values))
            bag.write_chunk(*parts)
    finally:
        missing = bag.close()
    if missing:
        raise ConfigError('--bag', f'cannot be written as a whole: {missing} is missing', str(path))


def _templates(bag: BagWriter, arm: ArmParameters) -> dict[int, RecordTemplate]:
    zero, messages = np.zeros(2), BagMessages(bag.typestore, arm.name)
    examples: dict[int, dict[str, Any]] = {
        _TRUTH: {
            'position': zero,
            'velocity': zero,
            'torque': zero,
            'fault': zero,
            'disturbance': 0.0,
        },
        _COMMAND: {'torque': zero, 'safe_stop': False},
        _REFERENCE: {
            'position': zero,
            'velocity': zero,
            'acceleration': zero,
            'tip_position': zero,
        },
    }
    templates = {}
    for kind, (name, msgtype) in _TYPES.items():
        topic = f'{NAMESPACE}/{name}'
        bag.add_topic(topic, msgtype, [qos_profile(True, False, 50)])
        if kind == _MEASURED:
            message = BagMessages(bag.typestore, 'base_link').joint_state(
                0, arm.joint_names, *[zero.tolist()] * 3
            )
        else:
            message = messages.make(msgtype, 0, examples[kind])
        templates[kind] = RecordTemplate(bag.typestore, message, msgtype, bag.channel(topic))
    return templates
