"""From a CSV recording of an arm to measurements of a bag."""

import csv
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain
from pathlib import Path
from typing import Any

from lpv.bag.rosbag.writing import BagWriter
from lpv.core.support.config import Section, read_yaml
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import MOST_BYTES, MOST_TEXT
from lpv.core.support.timestamps import LAST_STAMP

TIME_UNITS = {'s': 1_000_000_000, 'ms': 1_000_000, 'us': 1000, 'ns': 1}
ANGLE_UNITS = {'rad': 1.0, 'deg': math.pi / 180.0}
UNITS = {**ANGLE_UNITS, 'm': 1.0, 'mm': 1e-3}


class CsvError(LpvError):
    """A CSV file does not hold what its column map says; the message names line and column."""


@dataclass(frozen=True)
class ColumnMap:
    """Which column means what."""

    time: str  # column of the time
    time_unit: str  # key of `TIME_UNITS`
    start: float | None  # stamp of the first sample [s]; None keeps the times of the file as stamps
    joints: dict  # columns of position, velocity and effort by joint name; the last two may be ''
    units: dict  # key of `UNITS` by joint name, for positions and rates

    @property
    def columns(self) -> list[str]:
        return [self.time, *(c for columns in self.joints.values() for c in columns if c)]


def load_column_map(path: str | Path) -> ColumnMap:
    """Read a column map from a YAML file; ConfigError names the offending field."""
    data = read_yaml(path)
    top = Section(data, str(path))
    time = top.section('time')
    keep = time.flag('keep', False)
    start = None if keep else time.number('start', 1.0, low=1e-9, high=2e9)
    angle_unit = top.text('angle_unit', 'rad', tuple(ANGLE_UNITS))
    joints, units, section = {}, {}, top.section('joints')
    for name in data['joints']:
        one = section.section(name)
        rate, effort = (one.text(kind) if kind in one else '' for kind in ('velocity', 'effort'))
        joints[str(name)] = (one.text('position'), rate, effort)
        units[str(name)] = one.text('unit', angle_unit, tuple(UNITS))
        one.finish()
    if not joints:
        raise top.error('joints', 'must name at least one joint')
    unit = time.text('unit', 's', tuple(TIME_UNITS))
    result = ColumnMap(time.text('column'), unit, start, joints, units)
    for name in result.columns:
        if result.columns.count(name) > 1:
            raise top.error('joints', f'use column {name!r} twice')
    time.finish()
    top.finish()
    return result


def import_csv(
    source: str | Path,
    columns: ColumnMap,
    out: str | Path,
    topic: str = '/joint_states',
    delimiter: str | None = None,
) -> tuple[int, list[str]]:
    """Write a bag of JointState from a CSV file, else CsvError; messages, and warnings."""
    if not re.fullmatch(r'(/[A-Za-z_]\w*)+', topic, re.ASCII):
        raise CsvError(f'{topic[:MOST_TEXT]!r} is no full name of a topic, such as /joint_states')
    # Empty cells become NaN: the observer has modes for missing values.
    warnings = list[str]()
    samples = read_samples(source, columns, delimiter, warnings)
    first = next(samples, None)
    if first is None:
        raise CsvError(f'{source}: holds no sample')
    with BagWriter(out) as writer:
        count = writer.write_joint_states(topic, columns.joints, chain([first], samples))
    return count, warnings


@contextmanager
def opened(source: str | Path, delimiter: str | None = None) -> Iterator[Any]:
    """The `csv.reader` of a file; CsvError, from whatever uses it inside, if it cannot be read.

    Without a delimiter, that of comma, semicolon and tab which is most often in the first line.
    """
    try:
        with open(source, newline='', encoding='utf-8-sig') as file:
            if delimiter is None:
                delimiter = max(',;\t', key=file.readline(MOST_BYTES).count)
                file.seek(0)
            yield csv.reader(file, delimiter=delimiter)
    except (OSError, UnicodeDecodeError, csv.Error, TypeError) as error:
        raise CsvError(f'{source}: cannot be read ({error})') from error


def read_samples(
    source: str | Path, columns: ColumnMap, delimiter: str | None, warnings: list[str]
) -> Iterator[tuple[Any, ...]]:
    """Stamps, positions, rates and efforts, one by one: a long recording is never in memory."""
    unit, scales = TIME_UNITS[columns.time_unit], [UNITS[columns.units[j]] for j in columns.joints]
    vectors = tuple(zip(zip(*columns.joints.values()), (scales, scales, [1.0] * len(scales))))
    with opened(source, delimiter) as reader:
        header = [name.strip() for name in next(reader, [])]
        for name in columns.columns:
            if header.count(name) != 1:
                there = ', '.join(header) or 'no columns at all'
                count = 'several columns' if name in header else 'no column'
                raise CsvError(f'{source}: has {count} {name!r}; it has {there}')
        fault, last, offset, backwards = None, -1, 0, 0
        for cells in filter(None, reader):
            if fault is not None:
                raise fault
            row, line = dict(zip(header, cells)), f'{source}: line {reader.line_num}'
            try:
                if len(cells) < len(header):
                    raise CsvError(f'{line} has too few cells')
                if ''.join(cells[len(header) :]).strip():
                    raise CsvError(f'{line} has more cells than the header: decimal commas?')
                values = [
                    [_number(row, n, line, float, s) for n, s in zip(names, scale)]
                    if any(names)
                    else []
                    for names, scale in vectors
                ]
                # Decimal: a float of epoch seconds is 200 ns off; an int may have too many digits.
                time = _number(row, columns.time, line, Decimal, unit).to_integral_value()
                if last < 0 and columns.start is not None:
                    offset = round(columns.start * 1e9) - time
                stamp = time + offset
                if not 0 <= stamp <= LAST_STAMP:
                    cell = f'column {columns.time!r}: {row[columns.time].strip()[:40]!r}'
                    raise CsvError(f'{line}, {cell} is no time of a stamp [{columns.time_unit}]')
            except CsvError as error:
                # In the very last line it is that of a recording that was cut off.
                fault = error
                continue
            backwards += stamp <= last
            last = stamp
            yield (int(stamp), *values)
    if fault is not None:
        with open(source, 'rb') as end:
            end.seek(-1, 2)
            if end.read() in (b'\n', b'\r'):
                raise fault
        warnings.append(f'line {reader.line_num}, the last one, is cut off and left out')
    if backwards:
        warnings.append(f'time stands still or runs backwards {backwards} times')


def _number(cells: dict[str, str], name: str, line: str, kind: Any, unit: float) -> Any:
    """Number of units in a cell; NaN where there is no such cell, or an empty one."""
    text = cells[name].strip() if name else ''
    try:
        value = kind(text or 'nan') * unit
        # Python reads 1_0 as 10; NaN is a missing value, but no time.
        if '_' not in text and (math.isfinite(value) or (kind is float and math.isnan(value))):
            return value
    except (ArithmeticError, ValueError):
        pass
    raise CsvError(f'{line}, column {name!r}: {text[:40]!r} is not a number that can be used')
