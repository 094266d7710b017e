"""The observer as nodes and replay use it: joint-space samples in, estimates out.

All bad input ends here, in a stated degraded mode: see :meth:`UnknownInputObserver.update`.
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from lpv_core.dynamics import acceleration
from lpv_core.errors import SampleError
from lpv_core.joints import JointMap
from lpv_core.recursion import RECURSIONS

NANOSECONDS = 1_000_000_000

_LARGEST_ANGLE = 1e4
"""A position sensor that reads more [rad] is taken as silent; floats lose microradians there."""
_EFFORT_MARGIN = 10.0
"""A torque so many times above the arm's limit is no torque of this arm."""


class Mode(IntEnum):
    """What the last estimate rests on; values as in lpv_msgs/StateEstimate."""

    OBSERVING = 0
    HOLDING = 1
    INITIALISING = 2
    STALE = 3
    NO_ESTIMATE = 4


@dataclass
class Counters:
    """How many samples were not usable as they came.

    Attributes
    ----------
    duplicates, out_of_order, restarts, not_finite, implausible, gaps, late_steps : int
        Samples with an old stamp; clock set back; NaN or infinite values; values that no arm of
        this kind can have; intervals longer than the limit; intervals of several sample times
        (lost samples) that were bridged.
    """

    duplicates: int = 0
    out_of_order: int = 0
    restarts: int = 0
    not_finite: int = 0
    implausible: int = 0
    gaps: int = 0
    late_steps: int = 0


@dataclass
class Estimate:
    """One estimate.

    Attributes
    ----------
    stamp : int
        Time of the measurement [ns].
    position, velocity : ndarray, shape (2,)
        Estimated joint positions and rates, ROS joint coordinates [rad], [rad/s].
    measured_position, measured_velocity : ndarray, shape (2,)
        The measurement it belongs to, joint coordinates.
    fault : ndarray, shape (2,)
        f^ of the physical position sensors [rad].
    absolute_position : ndarray, shape (2,)
        Estimated absolute angles theta^ [rad].
    sensor_position : ndarray, shape (2,)
        Readings of the physical position sensors [rad].
    held : ndarray of bool, shape (2,)
        Links whose configuration carries no gravity information: dead reckoning.
    missing : ndarray of bool, shape (2,)
        Position sensors that delivered no finite value; their fault estimate is held.
    interval : float
        Time since the previous estimate [s].
    absolute_velocity, absolute_acceleration : ndarray, shape (2,)
        Measured theta' and the model's theta'' at the estimate [rad/s], [rad/s2].
    innovation : ndarray, shape (2,)
        Estimated minus measured theta' [rad/s].
    mode : Mode
        Summary.
    """

    stamp: int
    position: np.ndarray
    velocity: np.ndarray
    measured_position: np.ndarray
    measured_velocity: np.ndarray
    fault: np.ndarray
    absolute_position: np.ndarray
    sensor_position: np.ndarray
    held: np.ndarray
    missing: np.ndarray
    interval: float
    absolute_velocity: np.ndarray
    absolute_acceleration: np.ndarray
    innovation: np.ndarray
    mode: Mode = field(default=Mode.OBSERVING)


class UnknownInputObserver:
    """Sampled unknown-input observer, eqs. (38)-(53).

    Parameters
    ----------
    arm : ArmParameters
        The arm; its hash must match the gains.
    gains : Gains
        Designed gains.
    initial_samples : int, optional
        Samples over which the start value is averaged.  The observer takes their mean for free of
        faults: a constant bias at the start is only learnt at the certified decay rate.
    max_gap : float, optional
        Longest interval that is integrated [s]; longer ones re-anchor the estimate on the
        encoder's increment and hold the fault estimate.

    Raises
    ------
    ConfigError
        If the gains belong to another arm.
    """

    def __init__(self, arm, gains, initial_samples=1, max_gap=0.1):
        gains.check_arm(arm)
        self.arm = arm
        self.joints = JointMap(arm)
        self.counters = Counters()
        self.method = gains.observer.method
        self._max_gap = max_gap
        self._initial_samples = max(1, int(initial_samples))
        self._s = self.joints.sensor_matrix
        self._s_inv = np.linalg.inv(self._s)
        self._constants = arm.constants()
        self._recursion = RECURSIONS[self.method](arm, gains.observer)
        self._x, self._held = self._recursion.x, self._recursion.held
        self._y = np.zeros(4)
        self._torque = np.zeros(2)
        self.reset()

    def reset(self):
        """Forget everything but the counters; the next sample starts anew."""
        self._stamp = None
        self._started = 0
        self._held[:] = False

    @property
    def stamp(self):
        """Stamp of the last accepted sample [ns], or None."""
        return self._stamp

    def update(self, stamp, position, velocity, effort):
        """Take one measurement and return the estimate at its time.

        Degraded modes: a duplicate or older stamp is dropped and counted; a stamp more than 1 s
        back means that time restarted, and so does the observer; a position that is not finite,
        or absurd, is bridged with the last fault estimate of that sensor (the state estimate does
        not need it); a velocity or effort that is not finite, or beyond what the arm can do, drops
        the sample; an interval above ``max_gap`` re-anchors the estimate.

        Parameters
        ----------
        stamp : int
            Time of measurement [ns].
        position, velocity : sequence of two floats
            Joint positions [rad] and rates [rad/s] as in ``sensor_msgs/JointState``, in the
            order of the arm file.
        effort : sequence of two floats
            Joint torques that acted over the interval that ends at ``stamp`` [N m].

        Returns
        -------
        Estimate or None
            None if the sample was dropped.

        Raises
        ------
        SampleError
            If a vector has not two elements.
        """
        position, velocity, effort = (_two(position, 'position'), _two(velocity, 'velocity'),
                                      _two(effort, 'effort'))
        if not self._usable(velocity, effort):
            return None
        interval = self._interval(stamp)
        if interval is None:
            return None
        y, missing = self._outputs(position, velocity)
        fault = self._x[4:].copy()
        self._torque[:] = self.joints.absolute_torque(effort)
        if self._stamp is None:
            if missing.any():
                return None  # a start value needs both sensors
            self._start(y)
        elif interval > self._max_gap:
            self._bridge(y)
        else:
            self._advance(y, interval)
        if missing.any():
            self._keep_fault(y, missing, fault)
        if self._started < self._initial_samples:
            self._average_start(y)
        if not np.isfinite(self._x).all():
            # Can only follow from absurd input (1e300 rad/s); never let it out.
            self.counters.not_finite += 1
            self.reset()
            return None
        self._stamp = stamp
        self._y[:] = y
        self._started += 1
        return self._result(stamp, y, missing, interval)

    def _interval(self, stamp):
        if self._stamp is None:
            return 0.0
        delta = stamp - self._stamp
        if delta > 0:
            return delta / NANOSECONDS
        if delta < -NANOSECONDS:
            self.counters.restarts += 1
            self.reset()
            return 0.0
        if delta == 0:
            self.counters.duplicates += 1
        else:
            self.counters.out_of_order += 1
        return None

    def _outputs(self, position, velocity):
        y = np.empty(4)
        y[:2] = self.joints.sensor_position(position)
        y[2:] = self.joints.sensor_velocity(velocity)
        missing = ~(np.abs(y[:2]) <= _LARGEST_ANGLE)
        if missing.any():
            if np.isfinite(y[:2]).all():
                self.counters.implausible += 1
            else:
                self.counters.not_finite += 1
            y[:2] = np.where(missing, self._y[:2], y[:2])
        return y, missing

    def _usable(self, velocity, effort):
        if not (np.isfinite(velocity).all() and np.isfinite(effort).all()):
            self.counters.not_finite += 1
            return False
        possible = (np.abs(velocity) <= self.arm.velocity_limit).all() and (
            np.abs(effort) <= _EFFORT_MARGIN * np.asarray(self.arm.torque_limit)).all()
        self.counters.implausible += not possible
        return possible

    def _keep_fault(self, y, missing, fault):
        """A silent sensor reads S theta^ + f^, as if its fault stayed what it was."""
        self._x[4:] = np.where(missing, fault, self._x[4:])
        y[:2] = np.where(missing, self._s @ self._x[:2] + fault, y[:2])
        self._recursion.place(y)

    def _average_start(self, y):
        """Move the start value to the mean of the samples so far; their mean fault is zero."""
        share = self._x[4:] / (self._started + 1)
        self._x[:2] += self._s_inv @ share
        self._x[4:] -= share
        self._recursion.place(y)

    def _start(self, y):
        theta = self._s_inv @ y[:2]
        self._x[:] = np.concatenate([theta, self._s_inv @ y[2:], np.zeros(2)])
        self._recursion.place(y)
        self._y[:] = y
        self._started = 0

    def _bridge(self, y):
        """Re-anchor after a gap: the encoder's increment is all that is known of it."""
        self.counters.gaps += 1
        theta = self._s_inv @ (y[:2] - self._x[4:])
        self._x[:2], self._x[2:4] = theta, self._s_inv @ y[2:]
        self._recursion.place(y)

    def _advance(self, y, interval):
        steps = max(1, math.ceil(interval / (1.5 * self.arm.sample_time)))
        if steps > 1:
            self.counters.late_steps += 1
        before = self._y.copy()
        dt = interval / steps
        for i in range(1, steps + 1):
            after = y if i == steps else before + (y - self._y) / steps
            self._recursion.advance(before, after, self._torque, dt)
            before = after

    def _result(self, stamp, y, missing, interval):
        if self._started <= self._initial_samples:
            mode = Mode.INITIALISING
        else:
            mode = Mode.HOLDING if self._held.any() else Mode.OBSERVING
        x, rate = self._x, self._s_inv @ y[2:]
        return Estimate(
            stamp=stamp, position=self.joints.joint_position(x[:2]),
            velocity=self.joints.joint_velocity(x[2:4]),
            measured_position=self.joints.joint_from_sensor(y[:2]),
            measured_velocity=self.joints.joint_velocity_from_sensor(y[2:]),
            fault=x[4:].copy(), absolute_position=x[:2].copy(), sensor_position=y[:2].copy(),
            held=self._held.copy(), missing=missing, interval=interval, absolute_velocity=rate,
            absolute_acceleration=np.array(acceleration(
                x[0], x[1], rate[0], rate[1], self._torque[0], self._torque[1],
                self._constants)), innovation=x[2:4] - rate, mode=mode)


def _two(values, name):
    array = np.asarray(values, dtype=float)
    if array.shape != (2,):
        raise SampleError(f'{name} must have 2 values, one a joint, got shape {array.shape}')
    return array
