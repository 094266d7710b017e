"""From fault estimates to alarms: bound, dwell, hysteresis, per physical sensor."""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from lpv_core.arm import G_1, G_2
from lpv_core.dynamics import coupling
from lpv_core.joints import JointMap
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


class ErrorBound:
    """Bound on the fault-estimate error of a healthy arm, by configuration.

    A torque that the model does not know, Delta Q, is explained by the observer as an angle
    error Delta Q / (G cos theta): gravity is the only absolute reference.  Unknown torques are
    the mean disturbance Xi Bd d, the model error times the gravity torque, and a share of the
    Coulomb friction.  Noise adds ``sigmas`` times the designed standard deviation.  The bound
    follows the configuration at the certified decay rate, as the estimate's error does, and
    grows where a link is held.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Supplies noise bound and decay rate.
    parameters : DiagnosisParameters
        Tuning.
    """

    def __init__(self, arm, gains, parameters):
        self._arm = arm
        self._constants = arm.constants()
        self._parameters = parameters
        self._decay = gains.observer.decay
        self._noise = parameters.sigmas * np.asarray(gains.observer.fault_sigma)
        self._spread = np.abs(JointMap(arm).sensor_matrix)
        self._angle_error = None

    def reset(self):
        """Forget the configurations seen so far."""
        self._angle_error = None

    def static(self, theta):
        """Angle error in equilibrium at one configuration [rad].

        Parameters
        ----------
        theta : ndarray, shape (2,)
            Absolute angles [rad].

        Returns
        -------
        ndarray, shape (2,)
            Bound on each absolute angle's error without noise; the slope is clipped to the
            certified region.
        """
        arm, c = self._arm, self._constants
        off = coupling(theta[0], theta[1], c)
        push = np.abs(arm.disturbance_mean * np.asarray(arm.disturbance_direction))
        unknown = np.array([[c[0], abs(off)], [abs(off), c[2]]]) @ push
        gravity = c[[G_1, G_2]]
        unknown += arm.model_error * gravity * np.abs(np.sin(theta))
        share = self._parameters.friction_uncertainty
        unknown += share * np.array([arm.coulomb[0] + arm.coulomb[1], arm.coulomb[1]])
        slope = np.maximum(np.abs(np.cos(theta)), arm.cos_min)
        return unknown / (gravity * slope)

    def update(self, estimate):
        """Follow the configuration and return the bound per physical sensor.

        Parameters
        ----------
        estimate : Estimate
            Latest estimate.

        Returns
        -------
        ndarray, shape (2,)
            Bound on abs(f^ - f) [rad].
        """
        target = self.static(estimate.absolute_position)
        if self._angle_error is None:
            self._angle_error = target
        else:
            # Rises at once, falls with the observer's slowest mode; not while a link is held.
            fall = math.exp(-self._decay * estimate.interval)
            lagged = target + np.where(estimate.held, 1.0, fall) * (self._angle_error - target)
            self._angle_error = np.maximum(target, lagged)
            drift = self._arm.velocity_noise * math.sqrt(self._arm.sample_time)
            growth = drift * math.sqrt(estimate.interval) + 0.01 * estimate.interval
            self._angle_error = self._angle_error + np.where(estimate.held, growth, 0.0)
        return self._spread @ self._angle_error + self._noise


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
        self.bound = ErrorBound(arm, gains, self.parameters)
        self.sensors = [SensorStatus(), SensorStatus()]
        self._stamp = None

    def retune(self, parameters):
        """Change the tuning while running; alarms stay as they are.

        Parameters
        ----------
        parameters : DiagnosisParameters
            The new tuning.
        """
        angle_error = self.bound._angle_error
        self.parameters = parameters
        self.bound = ErrorBound(self._arm, self._gains, parameters)
        self.bound._angle_error = angle_error

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
        return (self.bound._spread @ estimate.held) > 0

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
