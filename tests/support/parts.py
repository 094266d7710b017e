"""Parts of the compiled diagnosis as objects, one by one: each holds what its functions work on."""

import math

import numpy as np

from lpv_core.bound import error_bound
from lpv_core.decision import fault_classification, fault_kinds, sensor_decision, sensor_state
from lpv_core.decision.diagnosis import diagnosis_constants
from lpv_core.model.dynamics import inverse_dynamics
from lpv_core.model.joints import JointMap
from lpv_core.observer.sampled_observer import ESTIMATE
from lpv_core.residual import change_detection, dead_reckoning, sample_buffer
from lpv_core.support.records import new_record


def make_estimate(**fields):
    """An estimate with some fields; the others are zero."""
    return new_record(ESTIMATE, **fields)


class History:
    """Buffer of one sensor."""

    def __init__(self, size):
        self.buffer = sample_buffer.buffer_of(sample_buffer.new_buffers(1, size), 0)

    def clear(self):
        sample_buffer.clear_buffer(self.buffer)

    @property
    def count(self):
        return int(self.buffer.used[0])

    def add(self, stamp, residual, reading, allowance=0.0, innovation=0.0):
        fields = dict(
            residual=residual, reading=reading, allowance=allowance, innovation=innovation
        )
        sample = new_record(sensor_state.SAMPLE, stamp=stamp, **fields)
        sample_buffer.add_sample(self.buffer, sample)

    def row(self, stamp):
        """Row of a stamp: the same wherever the search starts."""
        rows = {
            sample_buffer.index_at(self.buffer, stamp, guess)
            for guess in (-5, 0, self.count // 2, self.count, self.count + 7)
        }
        assert len(rows) == 1
        return rows.pop()

    def at(self, stamp):
        row, buffer = self.row(stamp), self.buffer
        return None if row < 0 else (buffer.stamps[row], buffer.values[row, sample_buffer.RESIDUAL])

    def median_at(self, stamp, count=5):
        return sample_buffer.median_before(self.buffer, self.row(stamp), count)

    def since(self, stamp):
        rows = slice(sample_buffer.first_since(self.buffer, stamp), self.count)
        return self.buffer.stamps[rows], self.buffer.values[rows]


class ChangeTest:
    """Limits of changes of one arm."""

    def __init__(self, arm, hours, smallest=0.0):
        self.constants = change_detection.change_test(arm, hours, smallest)

    def limit(self, window, error):
        return change_detection.change_limit(self.constants, window, error)

    def find(self, past, stamp, residual, allowance=0.0):
        """Window and residual before; None for no change."""
        sample = new_record(
            sensor_state.SAMPLE, stamp=stamp, residual=residual, allowance=allowance
        )
        window, _, before = change_detection.find_change(self.constants, past.buffer, sample)
        return None if window < 0 else (window, before)


class SensorDecision:
    """Decision about one sensor; fields of its alarm are attributes."""

    _WORDS = {
        sensor_decision.NOTHING: None,
        sensor_decision.RAISED: 'raised',
        sensor_decision.UPDATED: 'updated',
        sensor_decision.CLEARED: 'cleared',
    }

    def __init__(self, arm, gains, parameters):
        self.constants = diagnosis_constants(arm, gains, parameters).sensor
        self.state = new_record(sensor_state.SENSOR_STATE)
        self.past = History(round(1.5 / arm.sample_time))
        self.reset()

    def __getattr__(self, name):
        return getattr(self.state.alarm, name)

    @property
    def alarm(self):
        return bool(self.state.alarm.active)

    @property
    def kind(self):
        return fault_kinds.KINDS[self.state.alarm.kind]

    @property
    def baseline(self):
        return self.state.before.residual

    @property
    def compensable(self):
        return sensor_decision.is_compensable(self.state)

    @property
    def suspected(self):
        return sensor_decision.suspected(self.state)

    def reset(self):
        sensor_state.reset_sensor(self.state, self.past.buffer)

    def restart(self):
        sensor_state.restart_sensor(self.state, self.past.buffer)

    def update(self, **sample):
        for name, value in sample.items():
            self.state.sample[name] = value
        decided = sensor_decision.decide(self.constants, self.state, self.past.buffer)
        return self._WORDS[decided]


class ErrorBound:
    """Bound of one arm with its past."""

    def __init__(self, arm, gains, sigmas, friction_uncertainty):
        self.constants = error_bound.error_bound(arm, gains, sigmas, friction_uncertainty)
        self.state = new_record(error_bound.BOUND_STATE)
        self.reckoning = new_record(dead_reckoning.RECKONING_STATE)

    def static(self, theta):
        return error_bound.static_bound(self.constants, theta)

    def update(self, estimate):
        error_bound.update_bound(self.constants, self.state, estimate, self.reckoning)
        return self.state.bound.copy()


def classify(stamps, values, onset, baseline, noise):
    """Name of the kind of a time profile that fills a buffer."""
    buffer = sample_buffer.SampleBuffer(stamps, values, np.array([len(values)]))
    limits = new_record(sensor_state.SENSOR_LIMITS, noise=noise, scatter=noise)
    return fault_kinds.KINDS[fault_classification.classify(limits, buffer, 0, onset, baseline)]


class Swing:
    """A smooth motion about the vertical as joint-space samples with their exact torques."""

    def __init__(self, arm, pace=1.0):
        self.joints, self.c, self.pace = JointMap(arm), arm.constants(), pace
        self.rest = 0.0 if arm.orientation == 'upright' else math.pi

    def absolute(self, t):
        p, t = self.pace, self.pace * t
        return (
            self.rest + np.array([0.5 * math.sin(1.1 * t), 0.3 * math.sin(1.7 * t)]),
            p * np.array([0.55 * math.cos(1.1 * t), 0.51 * math.cos(1.7 * t)]),
            p * p * np.array([-0.605 * math.sin(1.1 * t), -0.867 * math.sin(1.7 * t)]),
        )

    def sample(self, t, dt=0.002, fault=(0.0, 0.0)):
        theta, rate, _ = self.absolute(t)
        reading = self.joints.sensor_position(self.joints.joint_position(theta)) + fault
        torque = inverse_dynamics(*np.concatenate(self.absolute(t - dt / 2)), self.c)
        return (
            self.joints.joint_from_sensor(reading),
            self.joints.joint_velocity(rate),
            self.joints.joint_torque(np.array(torque)),
        )

    def position(self, t):
        return self.joints.joint_position(self.absolute(t)[0])
