"""Alarm events as a list with one row for each alarm."""

import math
from typing import Any

from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, SensorState, subject
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
        self._open: dict[tuple[str, str], Row] = {}
        self.changed = False

    def rows(self) -> list[Row]:
        """The alarms, oldest first; times in [s], ``ended`` is None while it lasts."""
        return [dict(row) for row in self._rows]

    def add(self, event: Any) -> None:
        """Add one event, with the fields of lpv_msgs/FaultAlarm."""
        sensor = event.sensor[:MOST_TEXT]
        key = sensor, subject(event.kind)
        if event.event == RAISED and key in self._open:
            self._end(key, _time(event.onset))
        row = self._open.get(key)
        if row is None and event.event == CLEARED:  # `follow` may have ended it already
            row = next((r for r in reversed(self._rows) if _key(r) == key), None)
            row = row if row and row['onset'] == _time(event.onset) else None
        row = row or self._new_row(key)
        row.update(
            kind=event.kind[:MOST_TEXT],
            onset=_time(event.onset),
            confidence=_finite(event.confidence),
        )
        row.setdefault('detected', _time(event.detected))  # when it was raised
        if event.event == CLEARED:
            self._open.pop(key, None)
            row['ended'] = _time(event.header.stamp)
        else:
            row.update(size=_finite(event.size), bound=_finite(event.bound))
        self.changed = True

    def follow(self, faults: Any) -> None:
        """End alarms that a lpv_msgs/FaultEstimate no longer has, e.g. after a reset."""
        stamp = _time(faults.header.stamp)
        for sensor, alarm, state in zip(faults.sensor_names, faults.alarm, faults.state):
            self._follow((sensor, ''), not alarm, stamp)
            self._follow((sensor, 'dropout'), state != SensorState.STALE, stamp)

    def restart(self, stamp: int) -> None:
        """End all alarms: the observer has begun anew at a stamp [ns]."""
        for key in list(self._open):
            self._follow(key, True, seconds(stamp))

    def forget_clock(self) -> None:
        """Time has started anew: those that are over have no place on its axis."""
        for row in self._rows:
            row['past'] = row['ended'] is not None
        self.changed = True

    def _follow(self, key: tuple[str, str], is_over: bool, stamp: float) -> None:
        row = self._open.get(key)
        # The alarm and the estimate of one sample come on two topics, in any order.
        if row is not None and is_over and abs(stamp - row['detected']) > 0.5:
            self._end(key, max(stamp, row['detected']))

    def _new_row(self, key: tuple[str, str]) -> Row:
        row: Row = {'sensor': key[0], 'ended': None, 'size': None, 'bound': None, 'past': False}
        self._rows.append(row)
        self._open[key] = row
        if len(self._rows) > MAX_FAULTS:
            # What lasts stays, as long as senders name sensors that there are.
            over = (r for r in self._rows if r['ended'] is not None)
            oldest = next(over, self._rows[0])
            self._rows.remove(oldest)
            if oldest['ended'] is None:
                del self._open[_key(oldest)]
        return row

    def _end(self, key: tuple[str, str], stamp: float) -> None:
        self._open.pop(key)['ended'] = stamp
        self.changed = True


def _key(row: Row) -> tuple[str, str]:
    return row['sensor'], subject(row['kind'])


def _time(stamp: Any) -> float:
    return seconds(to_nanoseconds(stamp))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
