"""Figures of a run: mean squared errors, beside Table 2 of the paper where its arm ran."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from lpv.bag.run.record import RunRecord
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.metrics import mise
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import SAME
from lpv.core.uio.planar import planar_model

PAPER = {
    'x1': 0.006, 'x2': 0.002, 'x3': 0.024, 'x4': 0.047, 'f1': 0.006, 'f2': 0.002,
    'y1': 0.034, 'y2': 0.053, 'e_t1': 0.003, 'e_t2': 0.007,
}  # fmt: skip
"""MISE of Table 2 of the paper; states and tracking in absolute angles."""
_TABLE_1 = ((10.0, 1.0, 0.5, 0.83 + 10.0 * 0.5**2), (5.0, 1.0, 0.5, 0.41 + 5.0 * 0.5**2))
"""Mass [kg], length, centre of mass [m], inertia about the joint [kg m2] of the paper's links."""
_ERRORS = (
    (('x1', 'x2'), 'estimate of the position', 'position', 'ground_truth', 'state_estimate'),
    (('x3', 'x4'), 'estimate of the rate', 'velocity', 'ground_truth', 'state_estimate'),
    (('f1', 'f2'), 'estimate of the fault', 'fault', 'ground_truth', 'fault_estimate'),
    (('y1', 'y2'), 'tracking error, measured', 'position', 'joint_states', 'reference'),
    (('e_t1', 'e_t2'), 'tracking error, true', 'position', 'ground_truth', 'reference'),
)
"""Names in the paper, meaning, field, and the streams whose difference is the error."""


def is_paper_arm(arm: SerialArm) -> bool:
    """Whether an arm is that of the paper's Table 1, whose errors Table 2 lists."""
    try:
        planar = planar_model(arm)
    except ConfigError:
        return False
    links = [(k.mass, k.length, k.center_of_mass, k.inertia) for k in planar.links]
    same = np.allclose(links, _TABLE_1, rtol=SAME, atol=0.0)
    return bool(same) and planar.arrangement == 'absolute' and planar.sign > 0


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    signal: str  # name in the paper, joint or sensor
    meaning: str  # in words
    unit: str  # of the figures
    value: float  # of this run
    paper: float | None = None  # of the paper's Table 2

    @property
    def is_error(self) -> bool:
        """Whether it is a mean squared error, smaller is better."""
        return '²' in self.unit


def make_table(record: RunRecord, arm: SerialArm) -> list[Row]:
    """MISE against ground truth, as Table 2 for the paper's arm, or sizes of estimates."""
    if not {'ground_truth', 'state_estimate'} <= set(record.streams):
        return _sizes(record, arm)
    is_paper, rows = is_paper_arm(arm), []
    for names, meaning, field, stream, other in _ERRORS:
        one = record.aligned(stream, field)
        two = record.aligned(other, 'estimate' if field == 'fault' else field)
        if one is None or two is None:
            continue
        error = one - two
        per = '/s²' if field == 'velocity' else ''
        signals = arm.sensor_names if field == 'fault' else arm.joint_names
        if is_paper:
            signals = names
            error = error if field == 'fault' else np.cumsum(error, axis=1)
        values = np.asarray(mise(error)).tolist()
        rows += [
            Row(signal, meaning, f'{unit}²{per}', value, PAPER[signal] if is_paper else None)
            for signal, unit, value in zip(signals, arm.position_units, values)
        ]
    return rows


def _sizes(record: RunRecord, arm: SerialArm) -> list[Row]:
    estimate = record.aligned('fault_estimate', 'estimate')
    rows = []
    later = np.zeros((0, 0)) if estimate is None else np.abs(estimate[record.time > 1.0])
    for sensor, unit, column in zip(record.sensor_names, arm.position_units, later.T):
        column = column[np.isfinite(column)]
        if column.size:
            rms = float(np.sqrt(np.mean(column**2)))
            rows += [
                Row(sensor, 'largest fault estimate after 1 s', unit, float(column.max())),
                Row(sensor, 'RMS of the fault estimate after 1 s', unit, rms),
            ]
    return rows


def print_table(rows: list[Row], console: Console | None = None) -> None:
    """Show a table on the terminal, if it has rows."""
    title = 'mean squared errors over the run (MISE, eq. (70)): smaller is better'
    heads = ['signal', 'meaning', 'unit', '>this run']
    lines = [[row.signal, row.meaning, row.unit, f'{row.value:.2g}'] for row in rows]
    if any(row.paper is not None for row in rows):
        heads += ['>paper', '>better by']
        for row, cells in zip(rows, lines):
            ratio = row.paper / row.value if row.paper is not None and row.value > 0.0 else 0.0
            times = f'{ratio:.0f} x' if ratio >= 10.0 else f'{ratio:.1f} x'
            cells += [f'{row.paper:g}', times if ratio else '-']
    is_error = any(row.is_error for row in rows)
    print_grid(console or Console(markup=False), heads, lines, title if is_error else '')


def print_grid(
    console: Console, heads: Sequence[str], rows: Sequence[Sequence[str]], title: str = ''
) -> None:
    """Show rows on the terminal, if there are any; heads of columns of figures begin with ">".

    In a narrow terminal the words wrap, and no figure is cut off.
    """
    if not rows:
        return
    look: Any = {'box': box.SIMPLE_HEAD, 'pad_edge': False, 'padding': (0, 1, 0, 0)}
    table = Table(title=title or None, title_justify='left', **look)
    for head in heads:
        if head.startswith('>'):
            table.add_column(head[1:], justify='right', no_wrap=True)
        else:
            table.add_column(head, overflow='fold')
    for row in rows:
        table.add_row(*row)
    console.print(table, markup=False, soft_wrap=False)
