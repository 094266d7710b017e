"""Table 2 of the paper beside the figures of a run."""

from dataclasses import dataclass, replace

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from lpv_bag.run.streams import RunRecord
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.metrics import mise

# Signal: (meaning, unit, the paper's figure).
PAPER = {
    'x1': ('estimate of link 1 angle', 'rad²', 0.006),
    'x2': ('estimate of link 2 angle', 'rad²', 0.002),
    'x3': ('estimate of link 1 rate', 'rad²/s²', 0.024),
    'x4': ('estimate of link 2 rate', 'rad²/s²', 0.047),
    'f1': ('estimate of fault 1', 'rad²', 0.006),
    'f2': ('estimate of fault 2', 'rad²', 0.002),
    'y1': ('tracking error, measured angle 1', 'rad²', 0.034),
    'y2': ('tracking error, measured angle 2', 'rad²', 0.053),
    'e_t1': ('tracking error, true angle 1', 'rad²', 0.003),
    'e_t2': ('tracking error, true angle 2', 'rad²', 0.007),
}
"""MISE of Table 2; states and tracking in absolute angles, as in the paper."""


_TABLE_1 = ((10.0, 1.0, 0.5, 0.83), (5.0, 1.0, 0.5, 0.41))
"""Mass [kg], length, center of mass [m] and inertia [kg m2] of the paper's links."""


def is_paper_arm(arm: ArmParameters) -> bool:
    """Whether an arm is that of the paper's Table 1, whose errors Table 2 lists."""
    links = tuple((k.mass, k.length, k.center_of_mass, k.inertia) for k in arm.links)
    return links == _TABLE_1 and arm.arrangement == 'absolute' and arm.sign > 0


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    signal: str  # name in the paper, joint or sensor
    meaning: str  # in words
    unit: str  # of the figures
    value: float  # of this run
    paper: float | None = None  # of the paper's Table 2


def make_table(record: RunRecord, arm: Arm) -> list[Row]:
    """MISE against ground truth, or the size of fault estimates where there is none.

    Parameters
    ----------
    record : RunRecord
        The run.
    arm : ArmParameters or SerialArm
        Its arm.

    Returns
    -------
    list of Row
        Rows in the order of the paper's Table 2; of a serial arm, by joint.
    """
    compared = 'ground_truth' in record.streams and 'state_estimate' in record.streams
    if compared and isinstance(arm, SerialArm):
        return _by_joint(record, arm)
    if compared and not isinstance(arm, SerialArm):
        rows = _against_truth(record, JointMap(arm))
        return rows if is_paper_arm(arm) else [replace(row, paper=None) for row in rows]
    return _without_truth(record)


def _against_truth(record: RunRecord, joints: JointMap) -> list[Row]:

    def get(stream: str, name: str) -> np.ndarray:
        values = record.aligned(stream, name)
        assert values is not None  # of streams that are there
        return values

    truth = joints.absolute_position(get('ground_truth', 'position'))
    errors = {
        'x1': truth - joints.absolute_position(get('state_estimate', 'position')),
        'x3': joints.absolute_velocity(
            get('ground_truth', 'velocity') - get('state_estimate', 'velocity')
        ),
    }
    if 'fault_estimate' in record.streams:
        errors['f1'] = get('ground_truth', 'fault') - get('fault_estimate', 'estimate')
    if 'reference' in record.streams:
        reference = joints.absolute_position(get('reference', 'position'))
        measured = joints.absolute_position(get('joint_states', 'position'))
        errors['y1'], errors['e_t1'] = reference - measured, reference - truth
    pairs = {'x1': 'x2', 'x3': 'x4', 'f1': 'f2', 'y1': 'y2', 'e_t1': 'e_t2'}
    values = {}
    for first, error in errors.items():
        values[first], values[pairs[first]] = np.asarray(mise(error)).tolist()
    return [
        Row(name, *PAPER[name][:2], values[name], PAPER[name][2])
        for name in PAPER
        if name in values
    ]


def _by_joint(record: RunRecord, arm: SerialArm) -> list[Row]:
    """MISE of estimates of each joint and sensor, and of tracking."""
    signals = (
        ('estimate of the position', 'rad²', 'position', 'state_estimate', 'position'),
        ('estimate of the rate', 'rad²/s²', 'velocity', 'state_estimate', 'velocity'),
        ('tracking of the true joint', 'rad²', 'position', 'reference', 'position'),
        ('estimate of the fault', 'rad²', 'fault', 'fault_estimate', 'estimate'),
    )
    rows = []
    for meaning, unit, true, stream, field in signals:
        truth, values = record.aligned('ground_truth', true), record.aligned(stream, field)
        if truth is None or values is None:
            continue
        names = arm.sensor_names if stream == 'fault_estimate' else arm.joint_names
        errors = np.asarray(mise(truth - values)).tolist()
        rows += [Row(name, meaning, unit, error) for name, error in zip(names, errors)]
    return rows


def _without_truth(record: RunRecord) -> list[Row]:
    estimate = record.aligned('fault_estimate', 'estimate')
    if estimate is None:
        return []
    later = np.abs(estimate[record.time > 1.0])
    rows = []
    for i, sensor in enumerate(record.sensor_names):
        column = later[:, i][np.isfinite(later[:, i])]
        if column.size:
            rows.append(Row(sensor, 'largest fault estimate after 1 s', 'rad', column.max()))
            rows.append(
                Row(
                    sensor,
                    'RMS of the fault estimate after 1 s',
                    'rad',
                    float(np.sqrt(np.mean(column**2))),
                )
            )
    return rows


def _times(row: Row) -> str:
    if row.paper is None or not row.value > 0.0:
        return '-'
    ratio = row.paper / row.value
    return f'{ratio:.0f} x' if ratio >= 10.0 else f'{ratio:.1f} x'


def print_table(rows: list[Row], console: Console | None = None) -> None:
    """Show a table on the terminal."""
    with_paper = any(row.paper is not None for row in rows)
    errors = any(row.signal in PAPER for row in rows)
    title = (
        'mean squared errors over the run (MISE, eq. (70)): smaller is better' if errors else None
    )
    table = Table(title=title, box=box.SIMPLE_HEAD)
    # In a narrow terminal the words wrap, and no figure is cut off.
    for name in ('signal', 'meaning', 'unit'):
        table.add_column(name, no_wrap=name != 'meaning')
    table.add_column('this run', justify='right', no_wrap=True)
    if with_paper:
        table.add_column('paper', justify='right', no_wrap=True)
        table.add_column('better by', justify='right', no_wrap=True)
    for row in rows:
        cells = [row.signal, row.meaning, row.unit, f'{row.value:.2g}']
        if with_paper:
            cells += [f'{row.paper:g}', _times(row)]
        table.add_row(*cells)
    (console or Console()).print(table)
