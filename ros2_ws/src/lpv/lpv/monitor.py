"""Diagnosis of a stream of measurements, and of a whole bag: the very code of the node."""

import operator
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lpv.core.monitoring.parameters import DiagnosisParameters, check_parameters
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, SensorState
from lpv.core.support.errors import SampleError
from lpv.core.uio.certificate.gains import Gains
from lpv.recordings import recorded

_NAME = '/uio'


@dataclass(frozen=True)
class Update:
    """What one measurement tells of joints and sensors."""

    stamp: int  # of the measurement [ns]
    position: np.ndarray  # (joints,) estimated joint positions, free of sensor faults [rad]
    velocity: np.ndarray  # (joints,) estimated joint rates [rad/s]
    fault: np.ndarray  # (sensors,) estimated faults of the position sensors [rad]
    bound: np.ndarray  # (sensors,) on the errors of these estimates [rad]
    threshold: np.ndarray  # (sensors,) above which a fault estimate raises an alarm [rad]
    trustworthy: bool  # False: do not move the arm by this estimate
    states: tuple[SensorState, ...]  # of each sensor
    alarms: tuple[Alarm, ...]  # events of this measurement: raised, updated, cleared


@dataclass(frozen=True)
class Diagnosis:
    """What a recording tells of the sensors; one row per measurement that has an estimate."""

    stamp: np.ndarray  # (n,) [ns]
    position: np.ndarray  # (n, joints) estimated joint positions, free of sensor faults [rad]
    fault: np.ndarray  # (n, sensors) estimated faults [rad]
    bound: np.ndarray  # (n, sensors) on their errors [rad]
    threshold: np.ndarray  # (n, sensors) [rad]
    trustworthy: np.ndarray  # (n,) whether the arm may be moved by the estimate
    alarms: list[Alarm]  # events in their order


class Monitor:
    """Diagnosis of the position sensors of one arm, one measurement after the other.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    gains : Gains, optional
        Of an arm with designed gains.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.

    Raises
    ------
    ConfigError
        If gains and arm do not belong together, the certificate of the gains does not hold, or a
        parameter is out of range.

    Examples
    --------
    >>> monitor = lpv.Monitor(arm, gains)
    >>> for sample in lpv.read_bag('my_bag', arm):
    ...     update = monitor.update(sample.stamp, sample.position, sample.velocity, sample.effort)
    """

    def __init__(
        self,
        arm: SerialArm,
        gains: Gains | None = None,
        parameters: DiagnosisParameters | None = None,
    ) -> None:
        self._names = arm.joint_names
        self._monitor = _verified_monitor(arm, gains, parameters)

    def update(
        self,
        stamp: int,
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> Update | None:
        """Use one measurement.

        Parameters
        ----------
        stamp : int
            Time of the measurement [ns], increasing.
        position, velocity, effort : sequence of float, shape (joints,)
            Of the joints, in the order of the arm file [rad], [rad/s], [N m]; NaN where there is
            none.

        Returns
        -------
        Update or None
            None for a measurement that gives no estimate: its stamp is not newer than the last
            one, or nothing usable was measured yet.

        Raises
        ------
        SampleError
            If sizes or types are wrong.
        """
        message = SimpleNamespace(
            name=list(self._names), position=position, velocity=velocity, effort=effort
        )
        try:
            answer = self._monitor.take(operator.index(stamp), message)
        except (TypeError, ValueError, OverflowError, LookupError) as error:
            raise self._refusal(stamp, message) or error from None
        if answer is None or not answer.record['has_fault']:
            return None
        state, fault = answer.record['state'], answer.record['fault']
        return Update(
            stamp,
            state['position'],
            state['velocity'],
            fault['estimate'],
            fault['bound'],
            fault['threshold'],
            bool(state['trustworthy']),
            tuple(SensorState(one) for one in fault['state'].tolist()),
            tuple(answer.events),
        )

    def _refusal(self, stamp: Any, message: Any) -> SampleError | None:
        """What is wrong with a measurement that could not be used."""
        try:
            np.int64(operator.index(stamp))
        except (TypeError, OverflowError):
            return SampleError(f'stamp must be a whole number of nanoseconds, got {stamp!r}')
        count = len(self._names)
        for name in ('position', 'velocity', 'effort'):
            value = getattr(message, name)
            try:
                fits = np.shape(np.asarray(value, float)) == (count,)
            except (TypeError, ValueError):
                fits = False
            if not fits:
                told = f'must be {count} numbers, one a joint, got {reprlib.repr(value)}'
                return SampleError(f'{name} {told}')
        return None

    def reset(self) -> None:
        """Forget estimates and alarms, as after a restart of the arm."""
        self._monitor.reset()


def _verified_monitor(
    arm: SerialArm, gains: Gains | None, parameters: DiagnosisParameters | None
) -> SerialSensorMonitor:
    """A monitor whose gains, if there are any, have a certificate that holds."""
    check_parameters(parameters)
    if gains is not None:
        gains.require(arm)
    return SerialSensorMonitor(_NAME, arm, parameters, gains)


def diagnose(
    arm: SerialArm,
    gains: Gains | None,
    bag: str | Path,
    parameters: DiagnosisParameters | None = None,
) -> Diagnosis:
    """Diagnose a whole recording at once.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    gains : Gains or None
        Of an arm with designed gains, or None.
    bag : str or pathlib.Path
        As in `lpv.read_bag`.
    parameters : DiagnosisParameters, optional
        Tuning of the diagnosis.

    Returns
    -------
    Diagnosis
        Estimates and alarms, the same as of `Monitor` one by one.

    Raises
    ------
    LpvError
        If the bag cannot be read, arm and gains do not belong together, or a parameter is out of
        range.
    """
    monitor = _verified_monitor(arm, gains, parameters)
    stamps, position, velocity, effort = recorded(bag, arm)
    answers = monitor.take_many(stamps, position, velocity, effort)
    known = answers.answered & answers.has_fault
    return Diagnosis(
        stamps[known],
        answers.state.position[known],
        answers.fault.estimate[known],
        answers.fault.bound[known],
        answers.fault.threshold[known],
        answers.state.trustworthy[known].astype(bool),
        [event for _, event in answers.events],
    )
