"""Attacks from numbers in [-1, 1]: everything that an arm file allows a healthy arm to do.

The estimate of a healthy arm is, nearly, linear in its parameters, and the monitor knows
with which factors.  So the attacker first runs the nominal arm, reads those factors at the moment
that it aims at, and then takes the corner of the arm file that they point to.  Against the bound of
a designed observer the corner is searched like everything else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpv.campaign.falsify import healthy_run
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain
from lpv.core.serial_arm.description import RATE_BIAS, SerialArm
from lpv.core.serial_arm.diagnosis.alarms import GUARANTEED, Alarm, SensorState
from lpv.core.serial_arm.diagnosis.healthy_balance import generator_count
from lpv.core.serial_arm.diagnosis.healthy_set import LEAST_RESPONSE
from lpv.core.serial_arm.diagnosis.parameter_set import (
    ParameterSet,
    is_stated,
    member,
    parameter_set,
    payload_generator,
)
from lpv.core.serial_arm.simulation import plant_scratch
from lpv.core.simulation.arm_simulator import PlantParts, plant_constants, plant_state
from lpv.core.simulation.faults import Fault, FaultInjector
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import LARGEST
from lpv.core.support.timestamps import NANOSECONDS
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.joints import J, JointMap
from lpv.core.uio.planar import planar_model

_WIDEST = DiagnosisParameters.safe_stop_bound
"""Thresholds above are no evidence [rad]."""
_LOOK_EVERY = 0.25
"""Time between two looks at a horizon's thresholds, three in a period of the fastest motion [s]."""
_SLOWEST, _FASTEST = 0.2, 8.0
"""Circular frequencies of the motion [rad/s]."""
_SLOW_SWITCH, _FAST_SWITCH = 0.3, 60.0
"""Circular frequencies of bang-bang time profiles [rad/s]."""
_REACH, _SPEED = 0.97, 0.5
"""Shares of a certified region and velocity limit that motions use."""
_MOTION, _SHARED, _APART = 4, 4, 3
"""Numbers of a candidate for each joint's motion; those of rest and switching; shares of a designed
range that are none of its arm."""


@dataclass(frozen=True)
class Attack:
    """A motion, a true arm and time profiles that the arm file allows; see `Course`."""

    joints: list[list[float]]
    disturbance: float
    rest: float
    switch_speed: float
    switch_phase: float
    rate_switch: float
    shares: list[float]  # of what the file allows of the true arm, in [-1, 1]
    seed: int  # of the noise


@dataclass(frozen=True)
class Finding:
    """One evaluated attack."""

    ratios: FloatArray  # of each sensor, the largest abs(f^)/threshold; 1 breaks the guarantee
    thresholds: FloatArray  # then [rad]
    times: FloatArray  # when [s]
    blamed: bool  # whether an alarm was raised, guaranteed or not
    attack: Attack  # what was done

    @property
    def sensor(self) -> int:
        """The sensor of the largest ratio."""
        return int(self.ratios.argmax())

    @property
    def ratio(self) -> float:
        """The largest one."""
        return float(self.ratios.max())


class Attacker:
    """Healthy runs of one arm, of some length [s], against the thresholds of ``monitored``."""

    def __init__(
        self, arm: SerialArm, duration: float, gains: Gains | None = None, monitored: Any = None
    ) -> None:
        self.arm = arm
        self.range: _DesignedRange | _StatedRange = (
            _StatedRange(arm, monitored or arm) if gains is None else _DesignedRange(arm, gains)
        )
        n = len(arm.joint_names)
        self.numbers = _MOTION * n + _SHARED + self.range.own
        self.samples = np.zeros((max(2, round(duration / arm.sample_time)), 3, n))
        chain = self.range.chain
        scenario = Scenario('attack', duration, 0, (), (), disturbance=gains is not None)
        constants = plant_constants(arm, scenario, chain, margin=2)  # corners are stiffer
        if gains is not None:  # they are of rates with sensors of their own
            constants.derived[:] = 0
        faults = (Fault(name, 'rate_bias', 0.0, size=1.0) for name in arm.sensor_names)
        records = FaultInjector(arm.sensor_names, faults, np.random.default_rng(0)).records
        rest = records, plant_scratch(chain), np.empty((n, n))
        self._plant = PlantParts(chain, constants, plant_state(n), *rest)

    def structured(self, rng: np.random.Generator) -> list[FloatArray]:
        """Candidates that an engineer would try: rest, slow and fast motion, corners of the arm."""
        n, found = len(self.arm.joint_names), []
        for swing in (-1.0, 0.0, 1.0):
            for corner in (-1.0, 1.0):
                for joint in range(n + 2):
                    candidate = rng.uniform(-1.0, 1.0, self.numbers)
                    candidate[n : 2 * n] = swing
                    candidate[_MOTION * n + _SHARED :] = corner
                    if joint < n:  # rest at the edge of one joint, or aim at it
                        candidate[joint] = 0.9
                        candidate[-4:-1] = (2.0 * joint + 1.0) / n - 1.0, 1.0, corner
                    found.append(candidate)
        return found

    def attack(self, candidate: FloatArray, seed: int) -> Attack:
        """Attack of a candidate."""
        n = len(self.arm.joint_names)
        numbers = np.clip(candidate, -1.0, 1.0)
        motion, shared = (
            numbers[: _MOTION * n].reshape(_MOTION, n),
            numbers[_MOTION * n :][:_SHARED],
        )
        own = numbers[_MOTION * n + _SHARED :]
        joints = np.zeros((healthy_run.RATE_SCALE + 1, n))
        moves = [healthy_run.CENTRE, healthy_run.SWING, healthy_run.SPEED]
        joints[moves] = self.range.motion(motion)
        joints[healthy_run.PHASE] = np.pi * motion[3]
        rest, switch, phase, rates = shared
        attack = Attack(
            joints.tolist(),
            0.0,
            float(0.6 * (rest + 1.0) * len(self.samples) * self.arm.sample_time),
            0.0 if switch < -0.3 else float(_geometric(switch, _SLOW_SWITCH, _FAST_SWITCH)),
            float(np.pi * phase),
            float(rates > 0.3),
            [0.0] * self.range.count,
            seed,
        )
        mean = self.range.disturb(joints, own, np.zeros(self.range.count))
        attack = replace(attack, joints=joints.tolist(), disturbance=mean)
        shares = self.range.shares(own, attack, self)
        mean = self.range.disturb(joints, own, shares)
        return replace(attack, joints=joints.tolist(), disturbance=mean, shares=shares.tolist())

    def simulate(self, attack: Attack, count: int | None = None) -> bool:
        """Fill the first samples; False if the simulation diverged."""
        samples, shares = self.samples[:count], np.array(attack.shares)
        course = healthy_run.Course(
            self.range.to_joint, np.array(attack.joints), attack.disturbance, attack.rest,
            attack.switch_speed, attack.switch_phase, attack.rate_switch)  # fmt: skip
        plant = self._plant._replace(chain=self.range.member(shares))
        noise = np.random.default_rng(attack.seed)
        good = bool(healthy_run.simulate(plant, course, noise, samples))
        return good and bool(np.abs(samples).max() < LARGEST)

    def run(self, attack: Attack) -> Finding:
        """Simulate one attack, and look at the thresholds all along."""
        if self.simulate(attack):
            return Finding(*self.range.judge(self.samples), attack)
        nothing = np.zeros(self.samples.shape[2])
        return Finding(nothing, nothing, nothing, False, attack)


def _geometric(share: FloatArray, low: float, high: float) -> FloatArray:
    return np.asarray(low * (high / low) ** (0.5 * (share + 1.0)))


def _load(shares: FloatArray, sizes: ParameterSet, payload: float) -> None:
    """No payload is negative, and its place counts with its mass."""
    at_tip = payload_generator(sizes, payload)
    if at_tip >= 0:
        shares[at_tip] = max(shares[at_tip], 0.0)
        shares[at_tip + 1 : len(sizes.inertial)] *= shares[at_tip]


def stamps_of(samples: FloatArray, period: float) -> np.ndarray:
    """Stamps of the samples of a run [ns]."""
    return 10**9 + round(period * 1e9) * np.arange(len(samples))


class _DesignedRange:
    """Model error, payload, friction, disturbance and rate errors that gains are designed for."""

    def __init__(self, described: SerialArm, gains: Gains) -> None:
        self.arm, self.chain = planar_model(described), compile_chain(described)
        arm, uncertainty = self.arm, described.uncertainty
        stated = replace(uncertainty, friction=self.arm.friction_error)
        self._sizes = parameter_set(replace(described, uncertainty=stated), self.chain)
        # Shares of mean disturbance and scales of the rates, and of the file's set of arms.
        self.own = self.count = _APART + generator_count(self._sizes)
        joints = JointMap(arm)
        # Motions are those of the absolute angles, which the certified region is of.
        self.to_joint = J
        self._reach = _REACH * np.arccos(arm.cos_min)
        # Joint positions are linear in the absolute angles but for their zero.
        upright = 0.0 if arm.sign > 0 else np.pi
        self._monitor = SerialSensorMonitor('', described, gains=gains, observer='uio')
        self._middle = np.linalg.solve(J, joints.joint_position(np.full(2, upright)))

    def motion(self, numbers: FloatArray) -> FloatArray:
        away = numbers[0] * self._reach
        swing = 0.5 * (numbers[1] + 1.0) * (self._reach - np.abs(away))
        speed = _geometric(numbers[2], _SLOWEST, _FASTEST)
        fastest = (swing * speed).sum() / (_SPEED * min(self.arm.velocity_limit))
        return np.array([self._middle + away, swing, speed / max(1.0, fastest)])

    def shares(self, own: FloatArray, attack: Attack, attacker: Attacker) -> FloatArray:
        shares = np.clip(2.0 * own, -1.0, 1.0)  # corners are reached
        _load(shares[_APART:], self._sizes, self.arm.payload)
        return shares

    def disturb(self, joints: FloatArray, own: FloatArray, shares: FloatArray) -> float:
        """Write what disturbs a motion into its rows; the mean of d."""
        joints[healthy_run.RATE_SCALE] = self.arm.velocity_error * shares[1:_APART]
        joints[healthy_run.RATE_BIAS] = RATE_BIAS * self.arm.velocity_noise * shares[-2:]
        return float(abs(self.arm.disturbance_mean) * shares[0])

    def member(self, shares: FloatArray) -> Chain:
        return member(self.chain, self._sizes, shares[_APART:])

    def judge(self, samples: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
        self._monitor.reset()
        answers = self._monitor.take_many(
            stamps_of(samples, self.arm.sample_time), *np.ascontiguousarray(samples.swapaxes(0, 1))
        )
        # The bound is the threshold without its floor.
        state, threshold = np.asarray(answers.fault.state), np.array(answers.fault.bound)
        judged = answers.has_fault[:, None] & (state <= int(SensorState.ERROR))
        judged &= (threshold > 0.0) & (threshold < _WIDEST)
        ratio = np.abs(answers.fault.estimate) / np.where(judged, threshold, np.inf)
        row, both = ratio.argmax(axis=0), np.arange(2)
        blamed = any(event.sensor for _, event in answers.events)
        return ratio[row, both], threshold[row, both], row * self.arm.sample_time, blamed


class _StatedRange:
    """What an arm file states in ``uncertainty`` and of its sensors."""

    def __init__(self, arm: SerialArm, monitored: SerialArm) -> None:
        for one in (arm, monitored):
            if not is_stated(one):
                raise ConfigError('uncertainty.model_error', 'is not stated: nothing is guaranteed')
        n, self.arm, self._told, self.chain = len(arm.joints), arm, monitored, compile_chain(arm)
        self._sizes = parameter_set(arm, self.chain)
        self.own, self.count, self.to_joint = n + 4, generator_count(self._sizes), np.eye(n)

    def motion(self, numbers: FloatArray) -> FloatArray:
        low, high = np.array([joint.range for joint in self.arm.joints]).T
        fastest = np.array([min(joint.limits.velocity, 4.0) for joint in self.arm.joints])
        away = numbers[0] * 0.5 * (high - low)
        swing = 0.5 * (numbers[1] + 1.0) * (0.5 * (high - low) - np.abs(away))
        speed = _geometric(numbers[2], _SLOWEST, _FASTEST)
        speed = np.minimum(speed, 0.7 * fastest / np.maximum(swing, 1e-3))
        return np.array([0.5 * (low + high) + away, swing, speed])

    def shares(self, own: FloatArray, attack: Attack, attacker: Attacker) -> FloatArray:
        """The corner that the monitor's own factors point to at the moment that is aimed at."""
        (aim, late, sign, free), n = own[-4:], len(self.arm.joints)
        shares = np.random.default_rng(attack.seed).choice([-1.0, 1.0], self.count)
        if free < 0.8:
            joint = min(int(0.5 * (aim + 1.0) * n), n - 1)
            count = max(int(max(0.1, 0.5 * (late + 1.0)) * len(attacker.samples)), 100)
            if attacker.simulate(attack, count):
                samples, monitor = attacker.samples[:count], SerialSensorMonitor('', self._told)
                stamps = stamps_of(samples, self.arm.sample_time)
                monitor.take_many(stamps, *samples.swapaxes(0, 1))
                found = monitor.guarantee()
                if found is not None:
                    shares = np.where(found.effects[joint] * sign >= 0.0, 1.0, -1.0)
        _load(shares, self._sizes, self.arm.uncertainty.largest_payload)
        return shares

    def disturb(self, joints: FloatArray, own: FloatArray, shares: FloatArray) -> float:
        # Torques that the model misses are what it may miss at any speed.
        missed = np.array([min(joint.torque_tolerance.torque) for joint in self.arm.joints])
        joints[healthy_run.PUSH] = np.clip(2.0 * own[:-4], -1.0, 1.0) * missed
        joints[healthy_run.RATE_BIAS] = shares[-len(missed) :] * self._sizes.rate_bias
        return 0.0

    def member(self, shares: FloatArray) -> Chain:
        return member(self.chain, self._sizes, shares)

    def judge(self, samples: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
        n, stamps = samples.shape[2], stamps_of(samples, self.arm.sample_time)
        ratios, thresholds, times = np.zeros(n), np.full(n, np.nan), np.zeros(n)
        monitor, alarms = SerialSensorMonitor('', self._told), list[Alarm]()
        chunk = max(1, round(_LOOK_EVERY / self.arm.sample_time))
        for begin in range(0, len(stamps), chunk):
            end = min(begin + chunk, len(stamps))
            answers = monitor.take_many(stamps[begin:end], *samples[begin:end].swapaxes(0, 1))
            alarms += [event for _, event in answers.events]
            found = monitor.guarantee()
            if found is None:
                continue
            judged = (found.response > LEAST_RESPONSE) & (found.threshold < _WIDEST)
            ratio = np.abs(found.estimate) / np.maximum(found.threshold, 1e-12)
            worse = np.where(judged, ratio, 0.0) > ratios
            ratios = np.where(worse, ratio, ratios)
            thresholds = np.where(worse, found.threshold, thresholds)
            times = np.where(worse, end * self.arm.sample_time, times)
        for alarm in alarms:
            if alarm.basis == GUARANTEED:
                i, seconds = alarm.sensor_index, (alarm.detected - stamps[0]) / NANOSECONDS
                ratios[i], times[i] = max(float(ratios[i]), 1.0), seconds
        return ratios, thresholds, times, bool(alarms)
