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
        self.changed = False

    def rows(self) -> list[Row]:
        """The alarms, oldest first; times in [s], ``ended`` is None while it lasts."""
        return [dict(row) for row in self._rows]

    def add(self, event: Any) -> None:
        """Add one event, with the fields of lpv_msgs/FaultAlarm."""
        sensor, onset = event.sensor[:MOST_TEXT], _time(event.onset)
        key = sensor, subject(event.kind)
        row = self._open(key)
        if row is not None and event.event == RAISED:
            row['ended'], row = onset, None
        if row is None and event.event == CLEARED:  # `follow` may have ended it already
            row = next((r for r in reversed(self._rows) if _key(r) == key), None)
            row = row if row and row['onset'] == onset else None
        row = row or self._new_row(sensor)
        kind, confidence = event.kind[:MOST_TEXT], _finite(event.confidence)
        row.update(kind=kind, onset=onset, confidence=confidence)
        row.setdefault('detected', _time(event.detected))  # when it was raised
        if event.event == CLEARED:
            row['ended'] = _time(event.header.stamp)
        else:
            row.update(size=_finite(event.size), bound=_finite(event.bound))
        self.changed = True

    def follow(self, faults: Any) -> None:
        """End alarms that a lpv_msgs/FaultEstimate no longer has, e.g. after a reset."""
        stamp = _time(faults.header.stamp)
        for sensor, alarm, state in zip(faults.sensor_names, faults.alarm, faults.state):
            self._end(self._open((sensor, '')), not alarm, stamp)
            self._end(self._open((sensor, 'dropout')), state != SensorState.STALE, stamp)

    def restart(self, stamp: int) -> None:
        """End all alarms: the observer has begun anew at a stamp [ns]."""
        for row in self._rows:
            self._end(row, row['ended'] is None, seconds(stamp))

    def forget_clock(self) -> None:
        """Time has started anew: those that are over have no place on its axis."""
        for row in self._rows:
            row['past'] = row['ended'] is not None
        self.changed = True

    def _open(self, key: tuple[str, str]) -> Row | None:
        """The alarm of a sensor and a subject that lasts."""
        return next((r for r in self._rows if r['ended'] is None and _key(r) == key), None)

    def _end(self, row: Row | None, is_over: bool, stamp: float) -> None:
        # The alarm and the estimate of one sample come on two topics, in any order.
        if row is not None and is_over and abs(stamp - row['detected']) > 0.5:
            row['ended'], self.changed = max(stamp, row['detected']), True

    def _new_row(self, sensor: str) -> Row:
        if len(self._rows) == MAX_FAULTS:
            # What lasts stays, as long as senders name sensors that there are.
            over = (r for r in self._rows if r['ended'] is not None)
            self._rows.remove(next(over, self._rows[0]))
        row: Row = {'sensor': sensor, 'ended': None, 'size': None, 'bound': None, 'past': False}
        self._rows.append(row)
        return row


def _key(row: Row) -> tuple[str, str]:
    return row['sensor'], subject(row['kind'])


def _time(stamp: Any) -> float:
    return seconds(to_nanoseconds(stamp))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
