"""Alarm events as a list with one row for each alarm."""

import math
from typing import Any

from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv.core.simulation.faults import MAX_FAULTS
from lpv.core.support.limits import MOST_TEXT
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds

RAISED, UPDATED, CLEARED = AlarmEvent
Row = dict[str, Any]


def seconds(nanoseconds: int) -> float:
    """Seconds of a stamp in nanoseconds, to the microsecond."""
    return round(nanoseconds / NANOSECONDS, 6)


class AlarmList:
    """Rows of the newest `MAX_FAULTS` alarms; ``changed`` until that flag is lowered."""

    def __init__(self) -> None:
        self._rows: list[Row] = []
        self._open: dict[str, Row] = {}
        self._count = 0
        self.changed = False

    def rows(self) -> list[Row]:
        """The alarms, oldest first; times in [s], ``ended`` is None while it lasts."""
        return [dict(row) for row in self._rows]

    def add(self, event: Any) -> None:
        """Add one event, with the fields of lpv_msgs/FaultAlarm."""
        sensor = event.sensor[:MOST_TEXT]
        if event.event == RAISED and sensor in self._open:
            self._end(sensor, _time(event.onset))
        row = self._open.get(sensor) or self._ended_row(event) or self._new_row(sensor)
        row.update(
            kind=event.kind[:MOST_TEXT],
            onset=_time(event.onset),
            detected=_time(event.detected),
            confidence=_finite(event.confidence),
        )
        if event.event == CLEARED:
            self._open.pop(sensor, None)
            row['ended'] = _time(event.header.stamp)
        else:
            row.update(size=_finite(event.size), bound=_finite(event.bound))
        self.changed = True

    def _ended_row(self, event: Any) -> Row | None:
        """The row that `follow` ended before the event that says so came."""
        last = next((r for r in reversed(self._rows) if r['sensor'] == event.sensor), None)
        if last is None or event.event != CLEARED or last['onset'] != _time(event.onset):
            return None
        return last

    def follow(self, faults: Any) -> None:
        """End alarms that a lpv_msgs/FaultEstimate no longer has, e.g. after a reset."""
        stamp = _time(faults.header.stamp)
        for sensor, alarm in zip(faults.sensor_names, faults.alarm):
            row = self._open.get(sensor)
            # The alarm and the estimate of one sample come on two topics, in any order.
            if row is not None and not alarm and abs(stamp - row['detected']) > 0.5:
                self._end(sensor, max(stamp, row['detected']))

    def _new_row(self, sensor: str) -> Row:
        self._count += 1
        row: Row = {'id': self._count, 'sensor': sensor, 'ended': None, 'size': None, 'bound': None}
        self._rows.append(row)
        self._open[sensor] = row
        if len(self._rows) > MAX_FAULTS:
            oldest = self._rows.pop(0)
            if self._open.get(oldest['sensor']) is oldest:
                del self._open[oldest['sensor']]
        return row

    def _end(self, sensor: str, stamp: float) -> None:
        self._open.pop(sensor)['ended'] = stamp
        self.changed = True


def _time(stamp: Any) -> float:
    return seconds(to_nanoseconds(stamp))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
