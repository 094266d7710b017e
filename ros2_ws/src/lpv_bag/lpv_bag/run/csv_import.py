"""From a CSV recording of an arm to measurements of a bag."""

import csv
import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter, qos_profile
from lpv_core.support.config import Section, read_yaml
from lpv_core.support.errors import LpvError

TIME_UNITS = {'s': 1_000_000_000, 'ms': 1_000_000, 'us': 1000, 'ns': 1}
ANGLE_UNITS = {'rad': 1.0, 'deg': math.pi / 180.0}
_LATEST = 2**31 * 1_000_000_000


class CsvError(LpvError):
    """A CSV file does not hold what its column map says; the message names line and column."""


@dataclass(frozen=True)
class ColumnMap:
    """Which column means what."""

    time: str  # column of the time
    time_unit: str  # key of `TIME_UNITS`
    start: float | None  # stamp of the first sample [s]; None keeps the times of the file as stamps
    angle_unit: str  # key of `ANGLE_UNITS`, for positions and rates
    joints: dict  # columns of position, velocity and effort by joint name; the effort may be ''

    @property
    def columns(self) -> list[str]:
        """All column names."""
        return [self.time, *(c for columns in self.joints.values() for c in columns if c)]


def load_column_map(path: str | Path) -> ColumnMap:
    """Read a column map; ConfigError names the offending field.

    A YAML file with ``time`` (``column``, ``unit``, ``start`` or ``keep``), ``angle_unit`` and
    ``joints`` (``position``, ``velocity`` and optionally ``effort`` of each).
    """
    data = read_yaml(path)
    top = Section(data, str(path))
    time = top.section('time')
    keep = time.flag('keep', False)
    start = None if keep else time.number('start', 1.0, low=1e-9, high=2e9)
    joints, section = {}, top.section('joints')
    for name in data['joints']:
        one = section.section(name)
        joints[str(name)] = (
            one.text('position'),
            one.text('velocity'),
            one.text('effort') if 'effort' in one else '',
        )
        one.finish()
    if not joints:
        raise top.error('joints', 'must name at least one joint')
    result = ColumnMap(
        time.text('column'),
        time.text('unit', 's', tuple(TIME_UNITS)),
        start,
        top.text('angle_unit', 'rad', tuple(ANGLE_UNITS)),
        joints,
    )
    time.finish()
    top.finish()
    return result


def import_csv(
    source: str | Path,
    columns: ColumnMap,
    out: str | Path,
    topic: str = '/joint_states',
    delimiter: str = ',',
) -> tuple[Any, ...]:
    """Write a bag of sensor_msgs/JointState from a CSV file.

    Empty cells become NaN: the observer has modes for missing values, and nothing recorded is
    left out.  Without any effort column the messages carry no effort.

    Parameters
    ----------
    source : str or pathlib.Path
        CSV file with a header line.
    columns : ColumnMap
        Meaning of its columns.
    out : str or pathlib.Path
        Bag to create.
    topic : str, optional
        Topic of the messages.
    delimiter : str, optional
        Between cells.

    Returns
    -------
    tuple
        Number of messages, and a list of warnings.

    Raises
    ------
    CsvError
        If a column is missing, or a cell is no number.
    ConfigError
        If the bag cannot be made.
    """
    rows = _Rows(source, columns, delimiter)
    try:
        count = _write(rows, columns, out, topic)
    except CsvError:
        # What is there looks like a whole recording, and would block the next try.
        shutil.rmtree(out, ignore_errors=True)
        raise
    return count, rows.warnings


def _write(rows: '_Rows', columns: ColumnMap, out: str | Path, topic: str) -> int:
    with rows, BagWriter(out) as writer:
        writer.add_topic(topic, 'sensor_msgs/msg/JointState', [qos_profile(True, False, 10)])
        messages = BagMessages(writer.typestore, 'base_link')
        count = 0
        for stamp, *values in rows:
            message = messages.joint_state(stamp, columns.joints, *values)
            writer.write(topic, stamp, message)
            count += 1
    if count == 0:
        raise CsvError(f'{rows.source}: holds no sample')
    return count


class _Rows:
    """Samples of a CSV file, one by one: a long recording is never held in memory as a whole."""

    def __init__(self, source: str | Path, columns: ColumnMap, delimiter: str) -> None:
        self.source, self._columns = Path(source), columns
        self._factor = ANGLE_UNITS[columns.angle_unit]
        self.warnings: list[str] = []
        self._offset: int | None = None
        self._last: int | None = None
        self._backwards = 0
        try:
            self._file = open(source, newline='', encoding='utf-8-sig')  # noqa: SIM115
            self._reader = csv.reader(self._file, delimiter=delimiter)
            header = [name.strip() for name in next(self._reader, [])]
        except (OSError, UnicodeDecodeError, csv.Error, TypeError) as error:
            raise CsvError(f'{source}: cannot be read ({error})') from error
        missing = [name for name in columns.columns if name not in header]
        if missing:
            self._file.close()
            raise CsvError(
                f'{source}: has no column {missing[0]!r}; it has '
                + (', '.join(header) or 'no columns at all')
            )
        self._index = {name: header.index(name) for name in columns.columns}
        self._width = len(header)

    def __enter__(self) -> '_Rows':
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._backwards:
            self.warnings.append(f'time stands still or runs backwards {self._backwards} times')

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        # A fault in the very last line is that of a recording that was cut off, not of the file.
        fault = None
        try:
            for cells in self._reader:
                if not cells:
                    continue
                if fault is not None:
                    raise fault
                try:
                    if len(cells) < self._width:
                        raise CsvError(
                            f'{self.source}: line {self._reader.line_num} has too few cells'
                        )
                    sample = self._sample(cells)
                except CsvError as error:
                    fault = error
                    continue
                yield sample
        except (csv.Error, UnicodeDecodeError) as error:
            raise CsvError(f'{self.source}: line {self._reader.line_num}: {error}') from error
        if fault is not None:
            if self._ends_with_newline():
                raise fault
            self.warnings.append(
                f'line {self._reader.line_num}, the last one, is cut off and left out'
            )

    def _ends_with_newline(self) -> bool:
        with open(self.source, 'rb') as file:
            file.seek(-1, 2)
            return file.read() in (b'\n', b'\r')

    def _sample(self, cells: list[str]) -> tuple[Any, ...]:
        vectors = []
        for kind, factor in enumerate((self._factor, self._factor, 1.0)):
            names = [columns[kind] for columns in self._columns.joints.values()]
            if any(names):
                vectors.append(
                    [factor * self._number(cells, name) if name else math.nan for name in names]
                )
            else:
                vectors.append([])
        return (self._stamp(cells), *vectors)

    def _error(self, name: str, text: str) -> CsvError:
        return CsvError(
            f'{self.source}: line {self._reader.line_num}, column {name!r}: '
            f'{text[:40]!r} is not a number that can be used'
        )

    def _number(self, cells: list[str], name: str) -> float:
        text = cells[self._index[name]].strip()
        try:
            return float(text) if text else math.nan
        except ValueError:
            raise self._error(name, text) from None

    def _stamp(self, cells: list[str]) -> int:
        text = cells[self._index[self._columns.time]].strip()
        try:
            # Decimal: a float of epoch seconds is 200 ns off.
            time = int((Decimal(text) * TIME_UNITS[self._columns.time_unit]).to_integral_value())
        except (ArithmeticError, ValueError):
            raise self._error(self._columns.time, text) from None
        if self._offset is None:
            start = self._columns.start
            self._offset = 0 if start is None else round(start * 1e9) - time
        stamp = time + self._offset
        if not 0 <= stamp < _LATEST:
            raise self._error(self._columns.time, text)
        self._backwards += self._last is not None and stamp <= self._last
        self._last = stamp
        return stamp
