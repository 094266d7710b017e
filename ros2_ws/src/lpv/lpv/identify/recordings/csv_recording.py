"""CSV recordings: columns by a column map, or guessed from the names in the header."""

import csv
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lpv.bag.run.csv_import import ANGLE_UNITS, TIME_UNITS, ColumnMap, CsvError
from lpv.core.support.limits import MOST_BYTES
from lpv.identify.errors import IdentificationError

MAX_BYTES = 16 * MOST_BYTES
"""Largest CSV file that is read [bytes]."""
_PATTERNS = {
    'position': '{}_position {}_pos position_{} q_{} pos_meas{} motor_position{} position{} q{}',
    'velocity': '{}_velocity {}_vel velocity_{} v_{} vel_meas{} motor_velocity{} velocity{} dq{} '
    'v{}',
    'effort': '{}_effort {}_torque effort_{} tau_{} tau_meas{} motor_torque{} effort{} torque{} '
    'tau{} current{}',
}
"""Names of columns by the joint's name, or by its number."""


def read_csv(
    path: Path, joints: Sequence[str], columns: ColumnMap | None
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray | None, np.ndarray, list[str]]:
    """Stamps, positions, rates (or None), efforts, remarks of a CSV file with a header line."""
    header, table, notes = _read_table(path)
    if columns is None:
        columns = guess_columns(path, header, joints)
    index = _index(path, header, joints, columns)
    angle = ANGLE_UNITS[columns.angle_unit]
    table = np.column_stack([table, np.full(len(table), np.nan)])  # column -1: not recorded
    time = table[:, header.index(columns.time)] * (TIME_UNITS[columns.time_unit] / 1e9)
    position, velocity = angle * table[:, index[0]], angle * table[:, index[1]]
    effort = table[:, index[2]]
    return [time], position, velocity if np.isfinite(velocity).any() else None, effort, notes


def read_csv_columns(path: Path, names: Sequence[str], angle_unit: str) -> np.ndarray:
    """Angles of some columns of a CSV file, shape (n, columns) [rad]."""
    header, table, _ = _read_table(path)
    _require(path, header, names)
    return ANGLE_UNITS[angle_unit] * table[:, [header.index(name) for name in names]]


def _read_table(path: Path) -> tuple[list[str], np.ndarray, list[str]]:
    """Header, numbers and remarks of a CSV file."""
    if not path.is_file():
        raise CsvError(f'{path}: there is no such file')
    if path.stat().st_size > MAX_BYTES:
        raise CsvError(f'{path}: is larger than {MAX_BYTES} bytes')
    try:
        with open(path, newline='', encoding='utf-8-sig') as file:
            header = [name.strip() for name in next(csv.reader(file), [])]
            with warnings.catch_warnings(record=True) as caught:
                table = np.genfromtxt(file, delimiter=',', ndmin=2, invalid_raise=False)
    except (OSError, UnicodeDecodeError, ValueError, csv.Error) as error:
        raise CsvError(f'{path}: cannot be read ({error})') from error
    if table.shape[0] < 2 or table.shape[1] != len(header):
        raise CsvError(
            f'{path}: must have a header line and at least two lines of {len(header)} numbers'
        )
    return header, table, ['lines with another number of columns are left out'] if caught else []


def _index(
    path: Path, header: list[str], joints: Sequence[str], columns: ColumnMap
) -> list[list[int]]:
    for joint in joints:
        if joint not in columns.joints:
            known = ', '.join(columns.joints)
            raise IdentificationError(
                f'{path}: the column map has no joint {joint!r}; it has {known}'
            )
    wanted = [[columns.joints[joint][kind] for joint in joints] for kind in range(3)]
    _require(path, header, [columns.time, *(n for names in wanted for n in names if n)])
    return [[header.index(name) if name else -1 for name in names] for names in wanted]


def _require(path: Path, header: list[str], names: Sequence[str]) -> None:
    for name in names:
        if name not in header:
            raise CsvError(f'{path}: has no column {name!r}; it has {", ".join(header)}')


def guess_columns(path: Path, header: list[str], joints: Sequence[str]) -> ColumnMap:
    """Column map from a header that names columns after joints or their numbers."""
    time = next((name for name in header if re.fullmatch(r'(time|t|stamp)(_s)?', name, re.I)), None)
    if time is None:
        raise IdentificationError(f'{path}: has no column "time"; give a column map (--columns)')
    found = {}
    for number, joint in enumerate(joints, 1):
        names = []
        for kind, patterns in _PATTERNS.items():
            wanted = [p.format(label) for p in patterns.split() for label in (joint, number)]
            match = next((name for name in wanted if name in header), None)
            if match is None and kind != 'velocity':
                raise IdentificationError(
                    f'{path}: no column looks like the {kind} of '
                    f'{joint!r}; give a column map (--columns)'
                )
            names.append(match or '')
        found[joint] = tuple(names)
    return ColumnMap(time, 's', 0.0, 'rad', found)
