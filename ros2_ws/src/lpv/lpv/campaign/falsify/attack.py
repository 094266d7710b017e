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
from scipy.signal import lfilter

from lpv.campaign.falsify import healthy_run
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import Chain, FloatArray, IntArray, compile_chain
from lpv.core.serial_arm.description import RATE_BIAS, SerialArm
from lpv.core.serial_arm.diagnosis.alarms import GUARANTEED, Alarm, SensorState
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.healthy_balance import generator_count
from lpv.core.serial_arm.diagnosis.healthy_set import LEAST_RESPONSE, offsets_beside
from lpv.core.serial_arm.diagnosis.parameter_set import (
    ParameterSet,
    is_stated,
    member,
    parameter_set,
    payload_generator,
)
from lpv.core.serial_arm.diagnosis.sampler import DELAY
from lpv.core.serial_arm.simulation import plant_scratch
from lpv.core.simulation.arm_simulator import PlantParts, plant_constants, plant_state
from lpv.core.simulation.faults import Fault, FaultInjector
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.errors import ConfigError
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
_MOTION, _SHARED, _APART = 4, 5, 3
"""Numbers of a candidate for each joint's motion; those of rest, switching and lost samples; shares
of a designed range that are none of its arm."""
_LOST = 0.3
"""Share of the samples that begin a run of lost ones, times its length."""


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
    # of each joint, + or - an interval: the sign of missed torques and friction at rest; else none
    signs: list[str]
    offsets: list[float]  # of sensors, which then are not judged [rad]
    seed: int  # of the noise
    lost: int = 0  # samples in a row that are lost now and then


@dataclass(frozen=True)
class Finding:
    """One evaluated attack."""

    # of each healthy sensor, the largest abs(f^)/threshold; 1 breaks the guarantee
    ratios: FloatArray
    thresholds: FloatArray  # then [rad]
    times: FloatArray  # when [s]
    blamed: bool  # whether an alarm of a healthy sensor was raised, guaranteed or not
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
        count = max(2, round(duration / arm.sample_time))
        # Efforts that are early or late tell of others.
        self._around, sensors = self.range.around, arm.sensors()
        self._samples = np.zeros((count + 2 * self._around, 3, n))
        self.samples = self._samples[self._around : self._around + count]
        self._per_interval = HorizonPlan.of(arm.sample_time).per_interval
        blocks = sensors.position_noise / 0.01  # of 10 ms
        self._still = 0.1 * np.minimum(sensors.velocity_noise, blocks)
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
        rest, switch, phase, rates, lost = shared
        attack = Attack(
            joints.tolist(),
            0.0,
            float(0.6 * (rest + 1.0) * len(self.samples) * self.arm.sample_time),
            0.0 if switch < -0.3 else float(_geometric(switch, _SLOW_SWITCH, _FAST_SWITCH)),
            float(np.pi * phase),
            float(rates > 0.3),
            [0.0] * self.range.count,
            [],
            self.range.offsets(own),
            seed,
            # Half of the attacks lose none; where more than ten are, all begins anew.
            max(0, int(np.ceil(12.0 * lost))),
        )
        mean = self.range.disturb(joints, own, np.zeros(self.range.count))
        attack = replace(attack, joints=joints.tolist(), disturbance=mean)
        shares, signs = self.range.aimed(own, attack, self)
        mean = self.range.disturb(joints, own, shares)
        attack = replace(attack, joints=joints.tolist(), disturbance=mean)
        return replace(attack, shares=shares.tolist(), signs=signs)

    def simulate(self, attack: Attack, count: int | None = None) -> bool:
        """Fill the first samples; False if the simulation diverged."""
        shares, arm, n = np.array(attack.shares), self.arm, self._samples.shape[2]
        samples = self._samples[: count and count + 2 * self._around]
        signs = [[1.0 if sign == '+' else -1.0 for sign in each] for each in attack.signs]
        course = healthy_run.Course(
            self.range.to_joint, np.array(attack.joints), self.range.tolerance,
            np.array(signs).reshape(n, -1).T.copy(), self._per_interval, self._still, self._around,
            attack.disturbance, attack.rest, attack.switch_speed, attack.switch_phase,
            attack.rate_switch)  # fmt: skip
        plant = self._plant._replace(chain=self.range.member(shares))
        noise = np.random.default_rng(attack.seed)
        good = bool(healthy_run.simulate(plant, course, noise, samples))
        # Courses take half of the limits, and what is far beyond them has diverged.  The first
        # difference is none.
        good = good and bool((np.abs(samples[1:, 1]) < 2.0 * np.array(arm.velocity_limit)).all())
        if good:
            samples[:, 0] += arm.sensors_to_joints() @ attack.offsets
            for i, (late, filtered) in enumerate(zip(*self.range.delays(shares))):
                samples[:, 2, i] = effort_of(samples[:, 2, i], late / arm.sample_time,
                                         filtered / arm.sample_time)  # fmt: skip
        return good

    def run(self, attack: Attack) -> Finding:
        """Simulate one attack, and look at the thresholds all along."""
        if self.simulate(attack):
            stamps, samples = self.received(attack)
            judged = self.range.judge(stamps, samples, np.array(attack.offsets))
            return Finding(*judged, attack)
        nothing = np.zeros(self.samples.shape[2])
        return Finding(nothing, nothing, nothing, False, attack)

    def received(self, attack: Attack, count: int | None = None) -> tuple[IntArray, FloatArray]:
        """Stamps [ns] and values of the first samples, without those that the attack loses.

        Derived rates are differences of what is left.
        """
        samples, arm = self.samples[:count], self.arm
        stamps = 10**9 + round(arm.sample_time * 1e9) * np.arange(len(samples))
        if attack.lost == 0:
            return stamps, samples
        chance = np.random.default_rng(attack.seed).random(len(self.samples))[: len(samples)]
        begins = chance < _LOST / attack.lost
        kept = np.convolve(begins, np.ones(min(attack.lost, len(samples))))[: len(samples)] < 0.5
        stamps, samples = stamps[kept], samples[kept]
        sensors = samples[:, :2] @ arm.joints_to_sensors().T
        ways = np.diff(sensors[:, 0], axis=0) / (np.diff(stamps) / NANOSECONDS)[:, None]
        sensors[1:, 1] = np.where(self._plant.constants.derived, ways, sensors[1:, 1])
        samples[:, :2] = sensors @ arm.sensors_to_joints().T
        return stamps, samples


def _geometric(share: FloatArray, low: float, high: float) -> FloatArray:
    return np.asarray(low * (high / low) ** (0.5 * (share + 1.0)))


def effort_of(efforts: FloatArray, late: float, filtered: float) -> FloatArray:
    """Efforts that are late, and low-passed by a time constant, both in samples."""
    at = np.arange(len(efforts))
    efforts = np.interp(at + 0.5 - late, at, efforts)  # means are half a sample late
    if filtered <= 0.0:
        return efforts
    keep = float(np.exp(-1.0 / filtered))
    start = [keep * efforts[0]]
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], efforts, zi=start)[0])


def _load(shares: FloatArray, sizes: ParameterSet, payload: float) -> None:
    """No payload is negative, and its place counts with its mass."""
    at_tip = payload_generator(sizes, payload)
    if at_tip >= 0:
        shares[at_tip] = max(shares[at_tip], 0.0)
        shares[at_tip + 1 : len(sizes.inertial)] *= shares[at_tip]


def _aim(own: FloatArray, sensors: int) -> int:
    """Sensor that a candidate aims at."""
    return min(int(0.5 * (own[-4] + 1.0) * sensors), sensors - 1)


class _DesignedRange:
    """Model error, payload, friction, disturbance and rate errors that gains are designed for."""

    def __init__(self, described: SerialArm, gains: Gains) -> None:
        self.arm, self.chain = planar_model(described), compile_chain(described)
        arm, uncertainty = self.arm, described.uncertainty
        stated = replace(uncertainty, friction=self.arm.friction_error)
        self._sizes = parameter_set(replace(described, uncertainty=stated), self.chain)
        self.around, self.tolerance = 0, np.zeros_like(self._sizes.tolerance)
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

    def offsets(self, own: FloatArray) -> list[float]:
        return [0.0, 0.0]

    def delays(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """None is allowed: efforts are means over the sample before."""
        return np.full(2, 0.5 * self.arm.sample_time), np.zeros(2)

    def aimed(
        self, own: FloatArray, attack: Attack, attacker: Attacker
    ) -> tuple[FloatArray, list[str]]:
        shares = np.clip(2.0 * own, -1.0, 1.0)  # corners are reached
        _load(shares[_APART:], self._sizes, self.arm.payload)
        return shares, []

    def disturb(self, joints: FloatArray, own: FloatArray, shares: FloatArray) -> float:
        """Write what disturbs a motion into its rows; the mean of d."""
        joints[healthy_run.RATE_SCALE] = self.arm.velocity_error * shares[1:_APART]
        joints[healthy_run.RATE_BIAS] = RATE_BIAS * self.arm.velocity_noise * shares[-2:]
        return float(abs(self.arm.disturbance_mean) * shares[0])

    def member(self, shares: FloatArray) -> Chain:
        return member(self.chain, self._sizes, shares[_APART:])

    def judge(
        self, stamps: IntArray, samples: FloatArray, offsets: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
        self._monitor.reset()
        answers = self._monitor.take_many(stamps, *np.ascontiguousarray(samples.swapaxes(0, 1)))
        # The bound is the threshold without its floor.  That the horizon learns little of an arm,
        # and calls its offsets not diagnosable, takes nothing from what the bound says.
        state, threshold = np.asarray(answers.fault.state), np.array(answers.fault.bound)
        judged = answers.has_fault[:, None] & (state != int(SensorState.STALE))
        judged &= (threshold > 0.0) & (threshold < _WIDEST)
        ratio = np.abs(answers.fault.estimate) / np.where(judged, threshold, np.inf)
        row, both = ratio.argmax(axis=0), np.arange(2)
        blamed = any(event.sensor for _, event in answers.events)
        times = (stamps[row] - stamps[0]) / NANOSECONDS
        return ratio[row, both], threshold[row, both], times, blamed


class _StatedRange:
    """What an arm file states in ``uncertainty`` and of its sensors."""

    def __init__(self, arm: SerialArm, monitored: SerialArm) -> None:
        for one in (arm, monitored):
            if not is_stated(one):
                raise ConfigError('uncertainty.model_error', 'is not stated: nothing is guaranteed')
        n, self.arm, self._told, self.chain = len(arm.joints), arm, monitored, compile_chain(arm)
        self._sizes = parameter_set(arm, self.chain)
        self.own, self.count, self.to_joint = 2 * n + 6, generator_count(self._sizes), np.eye(n)
        self.tolerance = self._sizes.tolerance
        delay = np.array([abs(joint.effort_delay) for joint in arm.joints])
        self._late = 0.5 * arm.sample_time + delay
        longest = self._late.max() + 5.0 / (2.0 * np.pi * arm.effort_bandwidth)
        self.around = 1 + int(np.ceil(longest / arm.sample_time))

    def motion(self, numbers: FloatArray) -> FloatArray:
        low, high = np.array([joint.range for joint in self.arm.joints]).T
        fastest = np.array([min(joint.limits.velocity, 4.0) for joint in self.arm.joints])
        away = numbers[0] * 0.5 * (high - low)
        swing = 0.5 * (numbers[1] + 1.0) * (0.5 * (high - low) - np.abs(away))
        speed = _geometric(numbers[2], _SLOWEST, _FASTEST)
        speed = np.minimum(speed, 0.7 * fastest / np.maximum(swing, 1e-3))
        return np.array([0.5 * (low + high) + away, swing, speed])

    def offsets(self, own: FloatArray) -> list[float]:
        """Of all sensors but that which is aimed at."""
        n = len(self.arm.joints)
        offsets = np.clip(2.0 * own[n : 2 * n], -1.0, 1.0) * (own[-6] > 0.5)
        offsets[_aim(own, n)] = 0.0
        shares = offsets / max(1.0, float(np.abs(offsets).sum()))
        return (shares * offsets_beside(self.arm)).tolist()

    def delays(self, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Delays and time constants of the efforts [s]."""
        share = shares[-2 * len(self._late) : -len(self._late)]
        filtered = np.maximum(share, 0.0) / (2.0 * np.pi * self.arm.effort_bandwidth)
        return share * self._late, filtered

    def aimed(
        self, own: FloatArray, attack: Attack, attacker: Attacker
    ) -> tuple[FloatArray, list[str]]:
        """The corner that the monitor's own factors point to at the moment that is aimed at.

        Signs of what may have any time profile are those of its weights.
        """
        (follow, _, late, sign, free), n = own[-5:], len(self.arm.joints)
        shares, signs = np.random.default_rng(attack.seed).choice([-1.0, 1.0], self.count), []
        if free < 0.8:
            sensor = _aim(own, n)
            count = max(int(max(0.1, 0.5 * (late + 1.0)) * len(attacker.samples)), 100)
            if attacker.simulate(attack, count):
                stamps, samples = attacker.received(attack, count)
                monitor = SerialSensorMonitor('', self._told)
                monitor.take_many(stamps, *samples.swapaxes(0, 1))
                found = monitor.guarantee()
                if found is not None:
                    shares = np.where(found.effects[sensor] * sign >= 0.0, 1.0, -1.0)
                if found is not None and follow < 0.2:
                    signs = self._signs(sign * found.weights[sensor], count)
        _load(shares, self._sizes, self.arm.uncertainty.largest_payload)
        return shares, signs

    def _signs(self, weights: FloatArray, count: int) -> list[str]:
        """Signs of the weights (b, n) of an interval, which is in two balances, until a sample."""
        each = np.vstack([weights, 0.0 * weights[:1]]) + np.vstack([0.0 * weights[:1], weights])
        length = HorizonPlan.of(self.arm.sample_time).per_interval
        before = max((count - 1 - DELAY) // length - len(each), 0)
        each = np.pad(each, ((before, 0), (0, 0)), 'edge')
        return [''.join('+' if one > 0.0 else '-' for one in column) for column in each.T]

    def disturb(self, joints: FloatArray, own: FloatArray, shares: FloatArray) -> float:
        n = len(self.arm.joints)
        joints[healthy_run.PUSH] = np.clip(2.0 * own[:n], -1.0, 1.0)
        joints[healthy_run.RATE_BIAS] = shares[-n:] * self._sizes.rate_bias
        return 0.0

    def member(self, shares: FloatArray) -> Chain:
        return member(self.chain, self._sizes, shares)

    def judge(
        self, stamps: IntArray, samples: FloatArray, offsets: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
        n = samples.shape[2]
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
            judged &= offsets == 0.0
            ratio = np.abs(found.estimate) / np.maximum(found.threshold, 1e-12)
            worse = np.where(judged, ratio, 0.0) > ratios
            ratios = np.where(worse, ratio, ratios)
            thresholds = np.where(worse, found.threshold, thresholds)
            times = np.where(worse, (stamps[end - 1] - stamps[0]) / NANOSECONDS, times)
        alarms = [alarm for alarm in alarms if offsets[alarm.sensor_index] == 0.0]
        for alarm in alarms:
            if alarm.basis == GUARANTEED:
                i, seconds = alarm.sensor_index, (alarm.detected - stamps[0]) / NANOSECONDS
                ratios[i], times[i] = max(float(ratios[i]), 1.0), seconds
        return ratios, thresholds, times, bool(alarms)
