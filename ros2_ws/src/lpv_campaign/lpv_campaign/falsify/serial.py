"""Attacks on the guaranteed thresholds of a serial arm.

The estimate of a healthy arm is, nearly, linear in its parameters, and the monitor knows with which
factors.  So the attacker first runs the nominal arm, reads those factors at the moment that it aims
at, and then takes the corner of the arm file that they point to: numbers that are searched are
those of the motion, the aim, and what varies in time.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lpv_campaign.falsify.search import Finding, FloatArray
from lpv_campaign.falsify.serial_run import Course, Sensing, simulate
from lpv_core.serial_arm.chain import compile_chain, workspace
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.healthy_balance import generator_count
from lpv_core.serial_arm.diagnosis.healthy_set import LEAST_RESPONSE, Guarantee
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.serial_arm.diagnosis.parameter_set import (
    is_stated,
    member,
    parameter_set,
    payload_generator,
)
from lpv_core.serial_arm.simulation import integration_step, plant_scratch
from lpv_core.support.errors import ConfigError

LARGEST = 1.5
"""Thresholds above are no evidence [rad]."""
_LOOK_EVERY = 0.25
"""Time between two looks at estimate and thresholds [s]."""
_SLOWEST, _FASTEST = 0.2, 8.0
"""Circular frequencies of the motion [rad/s]."""
_SLOW_SWITCH, _FAST_SWITCH = 0.3, 60.0
"""Circular frequencies of bang-bang time profiles [rad/s]."""
_LARGEST_VALUE = 1e6
"""Values beyond are of a simulation that diverged."""
_PER_JOINT = 5
_SHARED = 7


@dataclass(frozen=True)
class SerialAttack:
    """A motion, a true arm and time profiles that the arm file allows."""

    course: list[list[float]]  # as `Course.joints`, shape (6, n)
    rest: float  # as `Course.rest` [s]
    switch_speed: float  # as `Course.switch_speed` [rad/s]
    switch_phase: float  # as `Course.switch_phase` [rad]
    shares: list[float]  # of the generators, see `parameter_set.member`
    seed: int  # of the noise


class SerialAttacker:
    """Runs attacks on one serial arm.

    Parameters
    ----------
    arm : SerialArm
        What a healthy arm may be; its file states the ranges.
    duration : float
        Of a run [s].
    monitored : SerialArm, optional
        What the monitor is told; that of ``arm`` by default.

    Attributes
    ----------
    samples : ndarray, shape (N, 3, n)
        Of the last run.
    runs, blamed : int
        Simulated so far; of those, with an alarm of a sensor: statistical, or a ratio of 1 or more.

    Raises
    ------
    ConfigError
        If the file states no ranges.
    """

    def __init__(self, arm: SerialArm, duration: float, monitored: SerialArm | None = None) -> None:
        self.arm, self._monitored = arm, monitored or arm
        for one in (arm, self._monitored):
            if not is_stated(one):
                raise ConfigError('uncertainty.model_error', 'is not stated: nothing is guaranteed')
        n, sensors = len(arm.joints), [joint.sensors for joint in arm.joints]
        self.numbers = _PER_JOINT * n + _SHARED
        self.samples = np.zeros((max(2, round(duration / arm.sample_time)), 3, n))
        self.runs = self.blamed = 0
        self._chain = compile_chain(arm)
        self._sizes = parameter_set(arm, self._chain)
        self._sensing = Sensing(
            np.array([one.position_noise for one in sensors]),
            np.array([one.velocity_noise for one in sensors]),
            np.array([one.quantization for one in sensors]),
            np.array([float(one.rates != 'independent') for one in sensors]),
            arm.sample_time,
            np.array(arm.torque_limit),
        )
        step, count = integration_step(self._chain, arm.sample_time)
        self._substeps = (0.5 * step, 2 * count)  # corners are stiffer
        self._scratch = plant_scratch(self._chain), np.empty((n, n)), workspace(self._chain)

    def structured(self, rng: np.random.Generator) -> list[FloatArray]:
        """Rest, slow and fast motion, aimed at every joint, early and late."""
        n, found = len(self.arm.joints), []
        for joint in range(n):
            for swing in (-1.0, 0.0, 1.0):
                for late in (-0.5, 1.0):
                    candidate = rng.uniform(-1.0, 1.0, self.numbers)
                    candidate[n : 2 * n] = swing
                    candidate[-_SHARED : -_SHARED + 3] = 1.0, _centred(joint, n), late
                    candidate[-1] = 0.0
                    found.append(candidate)
        return found

    def attack(self, candidate: FloatArray, seed: int) -> SerialAttack:
        """Attack of a candidate: the corner that the monitor's own factors point to."""
        n = len(self.arm.joints)
        numbers = np.clip(candidate, -1.0, 1.0)
        rest, aim, late, sign, switch, phase, free = numbers[-_SHARED:]
        attack = SerialAttack(
            self._course(numbers[: _PER_JOINT * n].reshape(_PER_JOINT, n)).tolist(),
            float(0.6 * (rest + 1.0) * len(self.samples) * self.arm.sample_time),
            0.0 if switch < -0.3 else float(_geometric(switch, _SLOW_SWITCH, _FAST_SWITCH)),
            float(np.pi * phase),
            [0.0] * generator_count(self._sizes),
            seed,
        )
        rng = np.random.default_rng(seed)
        shares = rng.choice([-1.0, 1.0], generator_count(self._sizes))
        if free < 0.8:
            joint = min(int(0.5 * (aim + 1.0) * n), n - 1)
            count = max(0.1, 0.5 * (late + 1.0)) * len(self.samples)
            effects = self._effects(attack, max(int(count), 100))
            shares = np.where(effects[joint] * sign >= 0.0, 1.0, -1.0)
        return replace(attack, shares=self._allowed(shares).tolist())

    def _allowed(self, shares: FloatArray) -> FloatArray:
        """Shares of a payload that is not negative; its place counts with its mass."""
        at_tip = payload_generator(self._sizes, self.arm.uncertainty.payload)
        if at_tip >= 0:
            shares[at_tip] = max(shares[at_tip], 0.0)
            shares[at_tip + 1 : len(self._sizes.inertial)] *= shares[at_tip]
        return shares

    def _course(self, numbers: FloatArray) -> FloatArray:
        """Motion within the limits of the joints."""
        n = len(self.arm.joints)
        limits = [joint.limits for joint in self.arm.joints]
        low = np.array([max(one.lower, -np.pi) for one in limits])
        high = np.array([min(one.upper, np.pi) for one in limits])
        fastest = np.array([min(one.velocity, 4.0) for one in limits])
        room = 0.5 * (high - low)
        away = numbers[0] * room
        swing = 0.5 * (numbers[1] + 1.0) * (room - np.abs(away))
        speed = _geometric(numbers[2], _SLOWEST, _FASTEST)
        speed = np.minimum(speed, 0.7 * fastest / np.maximum(swing, 1e-3))
        missed = np.array([max(joint.torque_tolerance.torque) for joint in self.arm.joints])
        # Torques that the model misses are what it may miss at any speed.
        least = np.array([min(joint.torque_tolerance.torque) for joint in self.arm.joints])
        missed = np.minimum(missed, least)
        push = np.clip(2.0 * numbers[4], -1.0, 1.0) * missed
        return np.array([0.5 * (low + high) + away, swing, speed, np.pi * numbers[3], push,
                         np.zeros(n)])  # fmt: skip

    def _effects(self, attack: SerialAttack, count: int) -> FloatArray:
        """Factors of the estimate by every share, after so many samples of the nominal arm."""
        guarantee = None
        if self._simulate(attack, count):
            monitor = SerialMonitor(self._monitored)
            stamps = self._stamps()[:count]
            monitor.update_many(stamps, self.samples[:count])
            if monitor.healthy is not None:
                guarantee = monitor.healthy.evaluate()
        return np.zeros((len(self.arm.joints), 1)) if guarantee is None else guarantee.effects

    def _stamps(self) -> np.ndarray:
        return 10**9 + round(self.arm.sample_time * 1e9) * np.arange(len(self.samples))

    def _simulate(self, attack: SerialAttack, count: int) -> bool:
        n, shares = len(self.arm.joints), np.array(attack.shares)
        joints = np.array(attack.course)
        joints[5] = shares[-n:] * self._sizes.rate_bias
        course = Course(joints, attack.rest, attack.switch_speed, attack.switch_phase)
        good = bool(simulate(
            member(self._chain, self._sizes, shares), course, self._sensing, self._substeps,
            np.random.default_rng(attack.seed), self._scratch, self.samples[:count],
        ))  # fmt: skip
        self.samples[:count, 2] /= np.array([joint.torque_gain for joint in self.arm.joints])
        return good and bool(np.abs(self.samples[:count]).max() < _LARGEST_VALUE)

    def run(self, attack: SerialAttack) -> Finding:
        """Simulate one attack, and look at the thresholds all along."""
        n, stamps = len(self.arm.joints), self._stamps()
        ratios, thresholds, times = np.zeros(n), np.full(n, np.nan), np.zeros(n)
        self.runs += 1
        good = self._simulate(attack, len(self.samples))
        monitor = SerialMonitor(self._monitored)
        chunk = max(1, round(_LOOK_EVERY / self.arm.sample_time))
        for begin in range(0, len(stamps) if good else 0, chunk):
            end = min(begin + chunk, len(stamps))
            monitor.update_many(stamps[begin:end], self.samples[begin:end])
            if monitor.healthy is None or len(monitor.estimator) == 0:
                continue
            guarantee = monitor.healthy.evaluate()
            ratio = _ratio(guarantee)
            worse = ratio > ratios
            ratios = np.where(worse, ratio, ratios)
            thresholds = np.where(worse, guarantee.threshold, thresholds)
            times = np.where(worse, end * self.arm.sample_time, times)
        self.blamed += any(alarm.sensor for alarm in monitor.alarms)
        for alarm in monitor.alarms:
            if alarm.guaranteed:
                i = self.arm.sensor_names.index(alarm.sensor)
                ratios[i], times[i] = max(float(ratios[i]), 1.0), alarm.detected
        i = int(ratios.argmax())
        return Finding(
            float(ratios[i]), i, float(times[i]), float(thresholds[i]), attack,
            tuple(ratios.tolist()), tuple(thresholds.tolist()))  # fmt: skip

    def readings(self) -> FloatArray:
        """Readings, rates and efforts of the last run, shape (N, 3, n)."""
        return self.samples

    def as_dict(self, attack: SerialAttack) -> dict[str, Any]:
        """Plain numbers of an attack, for a file."""
        return asdict(attack)

    def from_dict(self, data: dict[str, Any]) -> SerialAttack:
        """Attack from `as_dict`."""
        attack = SerialAttack(**data)
        n = len(self.arm.joints)
        if np.shape(attack.course) != (6, n):
            raise ValueError(f'course must have shape (6, {n})')
        if np.shape(attack.shares) != (generator_count(self._sizes),):
            raise ValueError(f'shares must be {generator_count(self._sizes)} numbers')
        return attack


def _ratio(guarantee: Guarantee) -> FloatArray:
    """Estimates over thresholds, 0 where that says nothing."""
    judged = (guarantee.response > LEAST_RESPONSE) & (guarantee.threshold < LARGEST)
    return np.where(judged, np.abs(guarantee.estimate), 0.0) / np.maximum(
        guarantee.threshold, 1e-12
    )


def _geometric(share: FloatArray, low: float, high: float) -> FloatArray:
    return np.asarray(low * (high / low) ** (0.5 * (share + 1.0)))


def _centred(joint: int, joints: int) -> float:
    """Number in [-1, 1] that aims at a joint."""
    return (2.0 * joint + 1.0) / joints - 1.0
