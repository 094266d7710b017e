"""Alarms of a serial arm in the form of the messages."""

import numpy as np
import numpy.typing as npt

from lpv.core.monitoring.stepped_monitor import Snapshot
from lpv.core.serial_arm.chain import IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import GUARANTEED, STATISTICAL, Alarm, AlarmEvent
from lpv.core.serial_arm.diagnosis.monitor import SerialAlarm

BoolArray = npt.NDArray[np.bool_]

_STATISTICAL = 1.0 - 1e-9
"""Largest confidence that is not a guarantee."""
_DROPOUT, _RATE_BIAS = 'dropout', 'rate_bias'


class AlarmConverter:
    """Alarm events of one arm.

    Parameters
    ----------
    arm : SerialArm
        Names of the sensors.
    """

    def __init__(self, arm: SerialArm) -> None:
        self._names = arm.sensor_names
        self._units = [joint.units[0] for joint in arm.joints]
        self._raised = np.zeros(len(self._names), bool)
        self._missing = np.zeros(len(self._names), bool)

    def convert(self, known: Snapshot, onset: list[int], stamp: int, sigmas: float) -> list[Alarm]:
        """Events of the alarms of a snapshot that name a sensor.

        Parameters
        ----------
        known : Snapshot
            What is known at the sample.
        onset : list of int
            Of each alarm [ns].
        stamp : int
            Of the sample [ns].
        sigmas : float
            Standard deviations in a bound.

        Returns
        -------
        list of Alarm
            In the order in which they were found.
        """
        events = []
        for alarm, begin in zip(known.alarms, onset):
            if not alarm.sensor:
                continue
            basis = GUARANTEED if alarm.guaranteed else STATISTICAL
            i = self._names.index(alarm.sensor)
            events.append(Alarm(
                AlarmEvent[alarm.event.upper()], i, alarm.sensor, begin, stamp, alarm.size,
                sigmas * alarm.sigma, alarm.kind, confidence(alarm), basis=basis,
                unit=self._units[i], rate=alarm.rate))  # fmt: skip
            if alarm.kind != _RATE_BIAS:
                self._raised[i] = alarm.event != 'cleared'
        return events

    def dropouts(self, missing: BoolArray, since: IntArray, stamp: int) -> list[Alarm]:
        """Events of sensors that fail to deliver, or deliver again.

        Parameters
        ----------
        missing : ndarray of bool, shape (n,)
            Which sensors have failed to deliver for long.
        since : ndarray of int, shape (n,)
            When their readings began to be missing [ns].
        stamp : int
            Of the sample [ns].

        Returns
        -------
        list of Alarm
            The end of a dropout does not clear another fault of the sensor.
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
