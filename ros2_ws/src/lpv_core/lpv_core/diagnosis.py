"""From fault estimates to alarms, to what is compensated, and to whether to go on at all."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.change_test import ChangeTest, sigmas_for
from lpv_core.consistency import ConsistencyTest
from lpv_core.error_bound import make_bound
from lpv_core.joints import JointMap
from lpv_core.observer import Mode
from lpv_core.sensor_decision import Sample, SensorDecision


class SensorState(IntEnum):
    """State of a sensor's diagnosis; values as in lpv_msgs/FaultEstimate."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
    NOT_DIAGNOSABLE = 4


class AlarmEvent(IntEnum):
    """Kinds of alarm events; values as in lpv_msgs/FaultAlarm."""

    RAISED = 0
    UPDATED = 1
    CLEARED = 2


@dataclass(frozen=True)
class DiagnosisParameters:
    """Tuning of the decision.

    Attributes
    ----------
    threshold_factor : float
        Threshold over bound; above 1 trades delay against false alarms.
    minimum_threshold : float
        No alarm below this size [rad].
    dwell : float
        How long an estimate must stay above its threshold before the alarm [s].
    clear_dwell : float
        How long it must stay below ``hysteresis`` times the threshold to clear [s].
    hysteresis : float
        Fraction of the threshold at which an alarm may clear.
    sigmas : float
        Multiple of the noise part in the bound.
    friction_uncertainty : float
        Relative uncertainty of Coulomb friction.
    false_alarm_hours : float
        Mean time between false alarms by noise, for the limits of changes [h].
    latch : bool
        Alarms stay until they are reset, even if the fault is over.
    compensation_rate : float
        How fast a compensation without a known step is faded in and out [rad/s].
    safe_stop_bound : float
        A confirmed fault with a wider bound than this cannot be compensated safely [rad].
    """

    threshold_factor: float = 1.0
    minimum_threshold: float = 0.02
    dwell: float = 0.01
    clear_dwell: float = 0.2
    hysteresis: float = 0.7
    sigmas: float = 4.0
    friction_uncertainty: float = 0.3
    false_alarm_hours: float = 1000.0
    latch: bool = False
    compensation_rate: float = 0.5
    safe_stop_bound: float = 1.5


@dataclass(frozen=True)
class Alarm:
    """One alarm event of one sensor.

    Attributes
    ----------
    event : AlarmEvent
        Raised, updated or cleared.
    sensor_index : int
        Index of the physical sensor.
    sensor : str
        Its name.
    onset, detected : int
        First sample above the threshold and time of the decision [ns].
    size, bound : float
        Fault at the event, with sign, and bound on the error of its level [rad]; a fault that was
        seen as a change is known better than that.
    kind : str
        One of `lpv_core.fault_kind.KINDS`.
    confidence : float
        One minus the probability of a healthy estimate like this: taking the bound as ``sigmas``
        standard deviations of a normal error, or from the mean time between false alarms.
    """

    event: AlarmEvent
    sensor_index: int
    sensor: str
    onset: int
    detected: int
    size: float
    bound: float
    kind: str
    confidence: float


@dataclass
class Diagnosis:
    """Decision at one sample.

    Attributes
    ----------
    bound, threshold : ndarray, shape (2,)
        Per physical sensor [rad].
    state : list of SensorState
        Per physical sensor.
    alarm : ndarray of bool, shape (2,)
        Confirmed faults.
    confirmed_fault : ndarray, shape (2,)
        What is to be removed from the readings: confirmed faults, faded in and out where their
        size was not known at once [rad].
    events : list of Alarm
        What changed at this sample.
    inconsistent : bool
        Rates, torques and model contradict each other; the cause is unknown.
    trustworthy : bool
        False if a confirmed fault cannot be compensated safely: the arm should stop.
    """

    bound: np.ndarray
    threshold: np.ndarray
    state: list
    alarm: np.ndarray
    confirmed_fault: np.ndarray
    events: list
    inconsistent: bool = False
    trustworthy: bool = True


class Diagnoser:
    """Bounds, decisions of both sensors, consistency, and what to compensate.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.
    parameters : DiagnosisParameters, optional
        Tuning.
    """

    def __init__(self, arm, gains, parameters=None):
        self._arm, self._gains = arm, gains
        self._tune(parameters or DiagnosisParameters())
        self.sensors = [SensorDecision(arm, self._changes, self.parameters) for _ in range(2)]
        self._sensor_matrix = JointMap(arm).sensor_matrix
        self._stamp = None
        self._applied = np.zeros(2)

    def _tune(self, parameters):
        self.parameters = parameters
        self.bound = make_bound(self._arm, self._gains, parameters.sigmas,
                                parameters.friction_uncertainty)
        self._changes = ChangeTest(self._arm, parameters.false_alarm_hours,
                                   parameters.minimum_threshold)
        self._consistency = None
        if self._gains.observer.method == 'exact':
            sigmas = sigmas_for(parameters.false_alarm_hours, self._arm.sample_time)
            self._consistency = ConsistencyTest(self._arm, self._gains, sigmas)

    def retune(self, parameters):
        """Change the tuning while running; alarms stay as they are.

        Parameters
        ----------
        parameters : DiagnosisParameters
            The new tuning.
        """
        before = self.bound
        self._tune(parameters)
        self.bound.adopt(before)
        for sensor in self.sensors:
            sensor.parameters, sensor.changes = parameters, self._changes

    def reset(self):
        """Clear alarms and history."""
        self.bound.reset()
        if self._consistency is not None:
            self._consistency.reset()
        for sensor in self.sensors:
            sensor.reset()
        self._stamp = None
        self._applied[:] = 0.0

    def update(self, estimate):
        """Decide on one estimate.

        Parameters
        ----------
        estimate : Estimate
            Latest estimate.

        Returns
        -------
        Diagnosis
            Bounds, states, alarms and events.
        """
        if self._stamp is not None and estimate.stamp < self._stamp:
            for sensor in self.sensors:
                sensor.restart()
        self._stamp = estimate.stamp
        bound = self.bound.update(estimate)
        threshold = np.maximum(self.parameters.threshold_factor * bound,
                               self.parameters.minimum_threshold)
        inconsistent = self._consistency is not None and self._consistency.update(
            estimate, self.bound.momentum())
        events, state = self._decide(estimate, bound, threshold, inconsistent)
        alarm = np.array([s.alarm for s in self.sensors])
        return Diagnosis(bound, threshold, state, alarm, self._compensate(estimate.interval),
                         events, inconsistent,
                         self._is_trustworthy(np.abs(estimate.fault) > threshold, bound))

    def _decide(self, estimate, bound, threshold, inconsistent):
        events, state = [], []
        rates = np.abs(self._sensor_matrix @ estimate.absolute_velocity)
        lost = self._lost(estimate, bound)
        speed = self.bound.speed() + self._arm.velocity_error * rates
        expected = self._sensor_matrix @ estimate.absolute_position
        for i, sensor in enumerate(self.sensors):
            sample = Sample(estimate.stamp, float(estimate.fault[i]),
                            float(estimate.sensor_position[i]), float(expected[i]),
                            float(threshold[i]), float(speed[i]), bool(estimate.missing[i]),
                            bool(lost[i]), inconsistent)
            decided = sensor.update(sample)
            if decided is not None:
                events.append(self._alarm(decided, i, bound[i], inconsistent))
            state.append(_state(sensor, sample))
        return events, state

    def _lost(self, estimate, bound):
        """Sensors whose level says nothing: gravity does not renew it, or not closely enough."""
        if estimate.mode == Mode.INITIALISING:
            return np.array([True, True])
        held = (self.bound.spread @ estimate.held) > 0
        return held | (bound > self.parameters.safe_stop_bound)

    def _compensate(self, interval):
        """Follow confirmed faults: at once where a step was seen, faded in and out otherwise."""
        step = self.parameters.compensation_rate * interval
        for i, sensor in enumerate(self.sensors):
            target = sensor.size if sensor.compensable else 0.0
            gap = target - self._applied[i]
            if not (sensor.compensable and (sensor.by_change or abs(gap) <= 2.0 * step)):
                gap = min(max(gap, -step), step)
            self._applied[i] += gap
        return self._applied.copy()

    def _is_trustworthy(self, above, bound):
        """Not where a level beyond its bound has an unknown cause, or no close enough bound."""
        for i, sensor in enumerate(self.sensors):
            if sensor.alarm and sensor.kind == 'inconsistent' and above[i]:
                return False
            wide = bound[i] > self.parameters.safe_stop_bound
            if sensor.compensable and not sensor.by_change and wide:
                return False
        return True

    def _alarm(self, event, index, bound, inconsistent):
        sensor = self.sensors[index]
        normalised = self.parameters.sigmas * abs(sensor.size) / max(float(bound), 1e-12)
        confidence = math.erf(normalised / math.sqrt(2.0))
        if sensor.by_change or sensor.kind == 'dropout':
            confidence = 1.0 - 1.0 / (3600.0 * self.parameters.false_alarm_hours)
        return Alarm(AlarmEvent[event.upper()], index, self._arm.sensor_names[index], sensor.onset,
                     sensor.detected, float(sensor.size), float(bound), sensor.kind,
                     0.5 * confidence if inconsistent and not sensor.by_change else confidence)


def _state(sensor, sample):
    if sample.missing:
        return SensorState.STALE
    if sensor.alarm:
        return SensorState.ERROR
    if sample.lost:
        return SensorState.NOT_DIAGNOSABLE
    above = abs(sample.fault) > sample.threshold
    return SensorState.WARN if above or sample.inconsistent else SensorState.OK
