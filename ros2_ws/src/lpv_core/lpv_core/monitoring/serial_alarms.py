"""Alarms of a serial arm in the form of the messages."""

import math

import numpy as np
import numpy.typing as npt

from lpv_core.decision.diagnosis import GUARANTEED, STATISTICAL, Alarm, AlarmEvent
from lpv_core.monitoring.stepped_monitor import Snapshot
from lpv_core.serial_arm.chain import IntArray
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.monitor import MonitorSettings, SerialAlarm

BoolArray = npt.NDArray[np.bool_]

_STATISTICAL = 1.0 - 1e-9
"""Largest confidence that is not a guarantee."""
_SPIKE, _BIAS, _DRIFT, _DROPOUT = 'spike', 'bias', 'drift', 'dropout'
_OWN_SIZE = (_SPIKE, _BIAS, 'rate_bias', 'torque_offset', 'torque_gain')
"""Kinds whose alarms hold the fault's size, not a position error that grows."""


class AlarmConverter:
    """Alarm events of one arm.

    Parameters
    ----------
    arm : SerialArm
        Names of the sensors.
    """

    def __init__(self, arm: SerialArm) -> None:
        self._names = arm.sensor_names
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
            In the order in which they were found; a spike is raised and cleared at once.
        """
        events = []
        for alarm, begin in zip(known.alarms, onset):
            if not alarm.sensor:
                continue
            i = self._names.index(alarm.sensor)
            event = AlarmEvent.UPDATED if self._raised[i] else AlarmEvent.RAISED
            size, sigma = _fault_at(alarm, known, i)
            fields = (
                i, alarm.sensor, begin, stamp, size, sigmas * sigma, alarm.kind,
                confidence(alarm),
            )  # fmt: skip
            basis = GUARANTEED if alarm.guaranteed else STATISTICAL
            if alarm.kind == _SPIKE:
                if not self._raised[i]:
                    events += [
                        Alarm(one, *fields, basis=basis) for one in (event, AlarmEvent.CLEARED)
                    ]
                continue
            self._raised[i] = True
            events.append(Alarm(event, *fields, basis=basis))
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


def _fault_at(alarm: SerialAlarm, known: Snapshot, i: int) -> tuple[float, float]:
    """Size of a fault and its standard deviation when it is named, in the unit of its kind."""
    if alarm.kind in _OWN_SIZE:
        return alarm.size, alarm.sigma
    size, sigma = float(known.fault[i]), float(known.sigma[i])
    grown = known.time - alarm.onset
    if alarm.kind == _DRIFT:  # its size is a rate
        return size + alarm.size * grown, math.hypot(sigma, alarm.sigma * grown)
    return size, sigma


def confidence(alarm: SerialAlarm) -> float:
    """One minus the probability of an alarm like this on a healthy arm, as far as sigmas hold.

    One, exactly, where no healthy arm inside its file shows it.
    """
    if alarm.guaranteed:
        return 1.0
    if alarm.kind == _BIAS and alarm.sigma > 0.0:
        return min(math.erf(abs(alarm.size) / alarm.sigma / math.sqrt(2.0)), _STATISTICAL)
    return 1.0 - math.exp(-MonitorSettings().evidence)
