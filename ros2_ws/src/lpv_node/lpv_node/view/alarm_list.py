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
        self._count = 0
        self.changed = False

    def rows(self) -> list[Row]:
        """The alarms, oldest first; times in [s], ``ended`` is None while it lasts."""
        return [dict(row) for row in self._rows]

    def add(self, event: Any) -> None:
        """Add one event, with the fields of lpv_msgs/FaultAlarm."""
        sensor, onset = event.sensor[:MOST_TEXT], _time(event.onset)
        row = self._last(sensor)
        if event.event == RAISED and row is not None and row['ended'] is None:
            row['ended'] = onset
        # An alarm may have been ended by `follow` before the event that says so comes.
        elif event.event == CLEARED and row is not None and row['onset'] == onset:
            row['ended'] = None
        if row is None or row['ended'] is not None:
            row = self._new_row(sensor)
        row.update(
            kind=event.kind[:MOST_TEXT],
            onset=onset,
            detected=_time(event.detected),
            confidence=_finite(event.confidence),
        )
        if event.event == CLEARED:
            row['ended'] = _time(event.header.stamp)
        else:
            row.update(size=_finite(event.size), bound=_finite(event.bound))
        self.changed = True

    def follow(self, faults: Any) -> None:
        """End alarms that a lpv_msgs/FaultEstimate no longer has, e.g. after a reset."""
        stamp = _time(faults.header.stamp)
        for sensor, alarm in zip(faults.sensor_names, faults.alarm):
            row = self._last(sensor)
            if alarm or row is None or row['ended'] is not None:
                continue
            # The alarm and the estimate of one sample come on two topics, in any order.
            if abs(stamp - row['detected']) > 0.5:
                row['ended'] = max(stamp, row['detected'])
                self.changed = True

    def _last(self, sensor: str) -> Row | None:
        return next((row for row in reversed(self._rows) if row['sensor'] == sensor), None)

    def _new_row(self, sensor: str) -> Row:
        self._count += 1
        row: Row = {'id': self._count, 'sensor': sensor, 'ended': None, 'size': None, 'bound': None}
        self._rows = [*self._rows, row][-MAX_FAULTS:]
        return row


def _time(stamp: Any) -> float:
    return seconds(to_nanoseconds(stamp))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
