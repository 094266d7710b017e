"""From fault estimates to alarms: bound, dwell, hysteresis, per physical sensor."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.error_bound import make_bound
from lpv_core.observer import NANOSECONDS, Mode


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
    """

    threshold_factor: float = 1.0
    minimum_threshold: float = 0.02
    dwell: float = 0.01
    clear_dwell: float = 0.2
    hysteresis: float = 0.7
    sigmas: float = 4.0
    friction_uncertainty: float = 0.3


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
        Fault estimate and bound of its error at the event [rad].
    kind : str
        ``unclassified`` until a kind is identified.
    confidence : float
        One minus the probability of a healthy estimate this large, taking the bound as
        ``sigmas`` standard deviations of a normal error.
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
class SensorStatus:
    """Running decision of one sensor.

    Attributes
    ----------
    alarm : bool
        Whether a fault is confirmed.
    above_since, below_since : int or None
        Stamps of the current excursion [ns].
    onset, detected : int
        Of the present or last alarm [ns].
    reported : float
        Fault estimate of its latest event [rad].
    """

    alarm: bool = False
    above_since: int = None
    below_since: int = None
    onset: int = 0
    detected: int = 0
    reported: float = 0.0


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
        Fault estimates of confirmed sensors, zero elsewhere [rad].
    events : list of Alarm
        What changed at this sample.
    """

    bound: np.ndarray
    threshold: np.ndarray
    state: list
    alarm: np.ndarray
    confirmed_fault: np.ndarray
    events: list


class Diagnoser:
    """Threshold test with dwell and hysteresis on each fault estimate.

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
        self.parameters = parameters or DiagnosisParameters()
        self._arm = arm
        self._gains = gains
        self.bound = self._make_bound()
        self.sensors = [SensorStatus(), SensorStatus()]
        self._stamp = None

    def retune(self, parameters):
        """Change the tuning while running; alarms stay as they are.

        Parameters
        ----------
        parameters : DiagnosisParameters
            The new tuning.
        """
        self.parameters = parameters
        before, self.bound = self.bound, self._make_bound()
        self.bound.adopt(before)

    def _make_bound(self):
        return make_bound(self._arm, self._gains, self.parameters.sigmas,
                          self.parameters.friction_uncertainty)

    def reset(self):
        """Clear alarms and history."""
        self.bound.reset()
        self._stamp = None
        self.sensors = [SensorStatus(), SensorStatus()]

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
            for sensor in self.sensors:  # time restarted: stamps of before mean nothing
                sensor.above_since = sensor.below_since = None
        self._stamp = estimate.stamp
        bound = self.bound.update(estimate)
        threshold = np.maximum(self.parameters.threshold_factor * bound,
                               self.parameters.minimum_threshold)
        events, state = [], []
        lost = self._lost(estimate)
        for i, sensor in enumerate(self.sensors):
            size = abs(float(estimate.fault[i]))
            if lost[i] or estimate.missing[i]:
                sensor.above_since = sensor.below_since = None  # what comes next is new evidence
            else:
                events += self._decide(i, sensor, estimate, size, bound[i], threshold[i])
            state.append(self._state(sensor, size, threshold[i], lost[i], estimate.missing[i]))
        alarm = np.array([s.alarm for s in self.sensors])
        confirmed = np.where(alarm, estimate.fault, 0.0)
        return Diagnosis(bound, threshold, state, alarm, confirmed, events)

    def _lost(self, estimate):
        """Sensors that see a held link: their estimate is not renewed by gravity."""
        if estimate.mode == Mode.INITIALISING:
            return np.array([True, True])
        return (self.bound.spread @ estimate.held) > 0

    def _state(self, sensor, size, threshold, lost, missing):
        if missing:
            return SensorState.STALE
        if sensor.alarm:
            return SensorState.ERROR
        if lost:
            return SensorState.NOT_DIAGNOSABLE
        return SensorState.WARN if size > threshold else SensorState.OK

    def _decide(self, index, sensor, estimate, size, bound, threshold):
        now, p = estimate.stamp, self.parameters
        if size > threshold:
            sensor.below_since = None
            if sensor.above_since is None:
                sensor.above_since = now
            if not sensor.alarm and now - sensor.above_since >= p.dwell * NANOSECONDS:
                sensor.alarm, sensor.onset, sensor.detected = True, sensor.above_since, now
                return [self._alarm(AlarmEvent.RAISED, index, estimate, bound)]
            if sensor.alarm and abs(estimate.fault[index] - sensor.reported) > bound:
                return [self._alarm(AlarmEvent.UPDATED, index, estimate, bound)]
        else:
            sensor.above_since = None
            if not sensor.alarm or size > p.hysteresis * threshold:
                sensor.below_since = None
            elif sensor.below_since is None:
                sensor.below_since = now
            elif now - sensor.below_since >= p.clear_dwell * NANOSECONDS:
                sensor.alarm, sensor.below_since = False, None
                return [self._alarm(AlarmEvent.CLEARED, index, estimate, bound)]
        return []

    def _alarm(self, event, index, estimate, bound):
        sensor = self.sensors[index]
        sensor.reported = size = float(estimate.fault[index])
        normalised = self.parameters.sigmas * abs(size) / max(float(bound), 1e-12)
        return Alarm(event, index, self._arm.sensor_names[index], sensor.onset, sensor.detected,
                     size, float(bound), 'unclassified', math.erf(normalised / math.sqrt(2.0)))
