"""Alarm events as a list with one row for each alarm."""

import math
from typing import Any

from lpv_core.support.timestamps import NANOSECONDS

RAISED, UPDATED, CLEARED = range(3)
_MOST_ROWS, _MOST_TEXT = 200, 100


def seconds(nanoseconds: int) -> float:
    """Seconds of a stamp, to the microsecond.

    Parameters
    ----------
    nanoseconds : int
        [ns].

    Returns
    -------
    float
        [s].
    """
    return round(nanoseconds / NANOSECONDS, 6)


class AlarmList:
    """Rows of the alarm list; the newest `_MOST_ROWS` are kept.

    Attributes
    ----------
    changed : bool
        Whether rows changed since this flag was last lowered.
    """

    def __init__(self) -> None:
        self._rows, self._open = [], {}
        self._count = 0
        self.changed = False

    def rows(self) -> list[dict[str, Any]]:
        """The alarms, oldest first.

        Returns
        -------
        list of dict
            ``id``, ``sensor``, ``kind``, ``onset``, ``detected``, ``ended`` [s] (None while it
            lasts), ``size``, ``bound`` [rad], ``confidence``.
        """
        return [dict(row) for row in self._rows]

    def take(self, event: object) -> None:
        """Take one event.

        Parameters
        ----------
        event : object
            With the fields of lpv_msgs/FaultAlarm.
        """
        sensor = event.sensor[:_MOST_TEXT]
        if event.event == RAISED and sensor in self._open:
            self._end(sensor, _time(event.onset))
        row = self._open.get(sensor) or self._over(event) or self._new_row(sensor)
        row.update(
            kind=event.kind[:_MOST_TEXT],
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

    def _over(self, event):
        """The row that `follow` ended before the event that says so came."""
        last = next((r for r in reversed(self._rows) if r['sensor'] == event.sensor), None)
        over = last is not None and event.event == CLEARED and last['onset'] == _time(event.onset)
        return last if over else None

    def follow(self, faults: object) -> None:
        """End alarms that the diagnosis no longer reports, e.g. after it was reset.

        Parameters
        ----------
        faults : object
            With the fields of lpv_msgs/FaultEstimate.
        """
        stamp = _time(faults.header.stamp)
        for sensor, alarm in zip(faults.sensor_names, faults.alarm):
            row = self._open.get(sensor)
            # The alarm and the estimate of one sample come on two topics, in any order.
            if row is not None and not alarm and abs(stamp - row['detected']) > 0.5:
                self._end(sensor, max(stamp, row['detected']))

    def _new_row(self, sensor):
        self._count += 1
        row = {'id': self._count, 'sensor': sensor, 'ended': None, 'size': None, 'bound': None}
        self._rows.append(row)
        self._open[sensor] = row
        if len(self._rows) > _MOST_ROWS:
            oldest = self._rows.pop(0)
            if self._open.get(oldest['sensor']) is oldest:
                del self._open[oldest['sensor']]
        return row

    def _end(self, sensor, stamp) -> None:
        self._open.pop(sensor)['ended'] = stamp
        self.changed = True


def _time(stamp):
    return seconds(stamp.sec * NANOSECONDS + stamp.nanosec)


def _finite(value):
    return float(value) if math.isfinite(value) else None
