"""Alarms of a serial arm in the form of the messages."""

import math
from collections.abc import Sequence

import numpy as np

from lpv.core.serial_arm.chain import BoolArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import (
    GUARANTEED,
    RATE_BIAS,
    STATISTICAL,
    Alarm,
    AlarmEvent,
)
from lpv.core.serial_arm.diagnosis.monitor import SerialAlarm

_STATISTICAL = math.nextafter(1.0, 0.0)
"""Largest confidence that is not a guarantee."""
_DROPOUT = 'dropout'


class AlarmConverter:
    """Alarm events of one arm."""

    def __init__(self, arm: SerialArm) -> None:
        self._names = arm.sensor_names
        self._units = arm.position_units
        self._raised = np.zeros(len(self._names), bool)
        self._missing = np.zeros(len(self._names), bool)

    def convert(
        self, alarms: Sequence[SerialAlarm], onset: list[int], stamp: int, sigmas: float
    ) -> list[Alarm]:
        """Events of alarms that name a sensor, in the order in which they were found.

        ``onset`` is that of each alarm, ``stamp`` that of the sample [ns]; a bound has ``sigmas``
        standard deviations.
        """
        events = []
        for alarm, begin in zip(alarms, onset):
            if not alarm.sensor:
                continue
            basis = GUARANTEED if alarm.guaranteed else STATISTICAL
            i = self._names.index(alarm.sensor)
            events.append(Alarm(
                AlarmEvent[alarm.event.upper()], i, alarm.sensor, begin, stamp, alarm.size,
                sigmas * alarm.sigma, alarm.kind, confidence(alarm), basis=basis,
                unit=self._units[i], rate=alarm.rate))  # fmt: skip
            if alarm.kind != RATE_BIAS:
                self._raised[i] = alarm.event != 'cleared'
        return events

    def dropouts(self, missing: BoolArray, since: IntArray, stamp: int) -> list[Alarm]:
        """Events of sensors that fail to deliver, or deliver again.

        ``missing`` says which sensors have failed to deliver for long, ``since`` when that began
        [ns].  The end of a dropout does not clear another fault of the sensor.
        """
        events = []
        for i in np.nonzero(missing != self._missing)[0]:
            event = AlarmEvent.UPDATED if self._raised[i] else AlarmEvent.RAISED
            if not missing[i]:
                event = AlarmEvent.CLEARED
            if missing[i] or not self._raised[i]:
                onset, name = int(since[i]), self._names[i]
                events.append(Alarm(event, int(i), name, onset, stamp, 0.0, 0.0, _DROPOUT, 1.0))
        self._missing = missing.copy()
        return events


def confidence(alarm: SerialAlarm) -> float:
    """Probability that a named fault is the cause; one, exactly, where it is guaranteed."""
    return 1.0 if alarm.guaranteed else min(alarm.confidence, _STATISTICAL)
