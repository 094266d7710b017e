"""CSV recordings: columns by a column map, or guessed from the names in the header."""

import re
from array import array
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lpv.bag.run.csv_import import ColumnMap, opened, read_samples
from lpv.core.serial_arm.chain import MAX_JOINTS
from lpv.core.support.limits import MOST_SAMPLES
from lpv.identify.errors import IdentificationError

_START = 2.0**30  # middle of the range of stamps: a clock may be set either way [s]
_PATTERNS = {
    'position': '{}_position {}_pos position_{} q_{} pos_meas{} motor_position{} position{} q{}',
    'velocity': '{}_velocity {}_vel velocity_{} v_{} vel_meas{} motor_velocity{} velocity{} dq{} '
    'v{}',
    'effort': '{}_effort {}_torque effort_{} tau_{} tau_meas{} motor_torque{} effort{} torque{} '
    'tau{} current{}',
}
"""Names of columns by the joint's name, or by its number."""


def read_csv(
    path: Path, joints: Sequence[str], columns: ColumnMap | None, others: Sequence[str] = ()
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray | None, np.ndarray, list[str]]:
    """Stamps, positions, rates (or None), efforts, remarks of a CSV file with a header line.

    Columns of ``others`` are positions of the same joints, too.
    """
    notes, count = list[str](), len(joints) + len(others)
    stamps, *parts = array('q'), array('d'), array('d'), array('d')
    columns = columns or guess_columns(path, _header(path), joints)
    chosen = _chosen(path, columns, joints, others)
    for stamp, *vectors in read_samples(path, chosen, ',', notes):
        stamps.append(stamp)
        for part, vector in zip(parts, vectors):
            part.extend(vector)
        if len(stamps) > MOST_SAMPLES:
            raise IdentificationError(f'{path}: has more than {MOST_SAMPLES} samples')
    time = np.array(stamps)
    position, velocity, effort = (
        np.array(part).reshape(-1, count) if part else np.full((len(time), count), np.nan)
        for part in parts
    )
    rates = velocity if np.isfinite(velocity).any() else None
    return [1e-9 * (time - time[:1])], position, rates, effort, notes


def _header(path: Path) -> list[str]:
    with opened(path) as reader:
        return [name.strip() for name in next(reader, [])]


def _chosen(
    path: Path, columns: ColumnMap, joints: Sequence[str], others: Sequence[str]
) -> ColumnMap:
    """Columns of some joints, in their order, and of other positions of theirs."""
    for joint in joints:
        if joint not in columns.joints:
            known = ', '.join(columns.joints)
            raise IdentificationError(
                f'{path}: the column map has no joint {joint!r}; it has {known}'
            )
    found = {name: columns.joints[name] for name in joints}
    found |= {f'column {name}': (name, '', '') for name in others}
    units = {f'column {name}': columns.unit(joint) for name, joint in zip(others, joints)}
    return replace(columns, start=_START, joints=found, units=columns.units | units)


def guess_columns(path: Path, header: list[str], joints: Sequence[str]) -> ColumnMap:
    """Column map from a header that names columns after joints or their numbers."""
    time = next((name for name in header if re.fullmatch(r'(time|t|stamp)(_s)?', name, re.I)), None)
    if time is None:
        raise IdentificationError(f'{path}: has no column "time"; give a column map (--columns)')
    found, labels = {}, _labels(path, header, joints)
    for label, joint in zip(labels, joints):
        names = []
        for kind, patterns in _PATTERNS.items():
            wanted = [pattern.format(label) for pattern in patterns.split()]
            match = next((name for name in wanted if name in header), None)
            if match is None and kind != 'velocity':
                raise IdentificationError(
                    f'{path}: no column looks like the {kind} of '
                    f'{joint!r}; give a column map (--columns)'
                )
            names.append(match or '')
        found[joint] = tuple(names)
    return ColumnMap(time, 's', 0.0, 'rad', found)


def _labels(path: Path, header: list[str], joints: Sequence[str]) -> Sequence[str]:
    """What the columns of the joints' positions are named after: joints, or numbers."""

    def among(labels: Sequence[str]) -> list[str]:
        return [x for x in labels if any(p.format(x) in header for p in patterns)]

    patterns = _PATTERNS['position'].split()
    numbers = among([str(k) for k in range(MAX_JOINTS + 1)])
    if among(joints) or not numbers:
        return joints
    if len(numbers) != len(joints):
        raise IdentificationError(
            f'{path}: positions are numbered {", ".join(numbers)}, but the arm has '
            f'{len(joints)} joints; give a column map (--columns)'
        )
    return numbers
