"""A simulated arm with its sensors: plant, disturbance, noise and faults, step by step.

All compiled functions take constants (`plant_type`) and state (`state_type`).
"""

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.serial_arm.chain import OFFSET, Chain, FloatArray, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.newton_euler import gravity_torque
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.serial_arm.simulation import integration_step, plant_scratch, plant_step
from lpv.core.simulation.faults import (
    FaultInjector,
    apply_faults,
    draw_chances,
    is_frozen,
    rate_bias,
)
from lpv.core.simulation.mujoco_chain import MujocoChain
from lpv.core.simulation.paper_plant import PaperPlant
from lpv.core.simulation.scenario import PAPER_PLANTS, PLANTS, Scenario, disturbance_of
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import memory, new_record, record_type


def plant_type(joints: int) -> np.dtype:
    """Record type of the constants."""
    return record_type(
        ('sample_time', 'f8'),  # [s]
        ('step', 'f8'),  # of integration [s]
        ('substeps', 'i8'),  # steps per sample
        ('torque_limit', 'f8', (joints,)),  # [N m]
        ('effort_gain', 'f8', (joints,)),  # joint torque per unit of effort [N m/unit]
        ('position_noise', 'f8', (joints,)),  # standard deviation, 0 without noise [rad]
        ('velocity_noise', 'f8', (joints,)),  # of independent rates [rad/s]
        ('quantization', 'f8', (joints,)),  # step of the readings, 0: none [rad]
        ('derived', 'u1', (joints,)),  # 1: the rate is the difference of the readings
        ('sensor', 'f8', (joints, joints)),  # S of y = S q + f
        ('to_joint', 'f8', (joints, joints)),  # S^-1
        ('direction', 'f8', (joints,)),  # accelerations per unit of the disturbance d [rad/s2]
        ('push_mean', 'f8'),  # of d
        ('push_deviation', 'f8'),  # standard deviation of d
    )


def state_type(joints: int) -> np.dtype:
    """Record type of the state."""
    return record_type(
        ('motion', 'f8', (2, joints)),  # true joint positions and rates [rad], [rad/s]
        ('step_count', 'i8'),  # number of the present sample
        ('torque', 'f8', (joints,)),  # joint torque over the step before [N m]
        ('position', 'f8', (joints,)),  # true, at the last reading [rad]
        ('velocity', 'f8', (joints,)),  # true, at the last reading [rad/s]
        ('measured_position', 'f8', (joints,)),  # [rad]
        ('measured_velocity', 'f8', (joints,)),  # [rad/s]
        ('fault', 'f8', (joints,)),  # of the sensors, NaN in a dropout [rad]
        ('reading', 'f8', (joints,)),  # of the sensors [rad]
        ('rate', 'f8', (joints,)),  # of the sensors [rad/s]
        ('before', 'f8', (joints,)),  # readings of the sample before [rad]
        ('disturbance', 'f8'),  # d over the step before
        ('push', 'f8', (joints,)),  # accelerations by d over the step before [rad/s2]
        ('effort', 'f8', (joints,)),  # measured, in its own unit
        ('draw', 'f8', (joints, 2)),  # standard normal numbers for the noise of readings and rates
        ('failed', '?'),  # the mass matrix was not positive definite
    )


class Engine(Protocol):
    """Integrates an arm in place of `integrate`."""

    def advance(
        self, motion: FloatArray, torque: FloatArray, push: FloatArray, interval: float, steps: int
    ) -> None:
        """Advance positions and rates, shape (2, n), over an interval [s] in so many steps.

        ``torque`` of the drives and the accelerations ``push`` of a disturbance are held, shape
        (n,) [N m], [rad/s2].
        """


@njit
def set_torque(
    params: np.record, state: np.record, torque: FloatArray, generator: np.random.Generator
) -> None:
    """Set joint torques [N m] for the coming step, within limits, and draw the disturbance."""
    draw = generator.standard_normal() if params.push_deviation > 0.0 else 0.0
    state.disturbance = params.push_mean + params.push_deviation * draw
    for i in range(torque.shape[0]):
        limit = params.torque_limit[i]
        state.torque[i] = min(max(torque[i], -limit), limit)
        state.push[i] = params.direction[i] * state.disturbance


@njit
def integrate(
    chain: Chain, params: np.record, state: np.record, scratch: FloatArray, matrix: FloatArray
) -> None:
    """Advance the plant by one sample time; scratch memory as of `plant_step`."""
    if not plant_step(
        chain, state.motion, state.torque, params.step, params.substeps, scratch, matrix, state.push
    ):
        state.failed = True
    state.step_count += 1


@njit
def brake(chain: Chain, state: np.record, work: FloatArray) -> None:
    """Let one sample time pass with the brakes engaged; efforts then read what holds the arm."""
    n = state.torque.shape[0]
    for i in range(n):
        state.motion[1, i] = 0.0
    gravity_torque(chain, state.motion[0], work, state.torque)
    for i in range(n):
        state.torque[i] += chain.friction[i, OFFSET]
    state.disturbance = 0.0
    state.step_count += 1


@njit
def read_sensors(
    params: np.record,
    state: np.record,
    faults: np.ndarray,
    noise: np.random.Generator,
    chance: np.random.Generator,
) -> None:
    """Read the sensors at the present sample, with noise and faults from two generators."""
    # Drawn with or without noise, so that both runs share the later numbers.
    for i in range(state.draw.shape[0]):
        state.draw[i, 0], state.draw[i, 1] = noise.standard_normal(), noise.standard_normal()
    draw_chances(faults, state.step_count * params.sample_time, chance)
    _take_readings(params, state, faults)


@njit
def _take_readings(params: np.record, state: np.record, faults: np.ndarray) -> None:
    """Read the sensors with the random numbers that have been drawn."""
    time, reading = state.step_count * params.sample_time, state.reading
    n = reading.shape[0]
    for i in range(n):
        state.position[i], state.velocity[i] = state.motion[0, i], state.motion[1, i]
        state.before[i] = reading[i]
        state.effort[i] = state.torque[i] / params.effort_gain[i]
    map_vector(params.sensor, state.position, reading)
    map_vector(params.sensor, state.velocity, state.rate)
    for i in range(n):
        state.fault[i] = reading[i]
    apply_faults(faults, time, reading, params.sample_time)
    for i in range(n):
        state.fault[i] = reading[i] - state.fault[i]
        if not is_frozen(faults, i, time):
            reading[i] += params.position_noise[i] * state.draw[i, 0]
        quantum = params.quantization[i]
        if quantum > 0.0:
            reading[i] = np.round(reading[i] / quantum) * quantum
        rate = state.rate[i] + rate_bias(faults, i, time)
        if not params.derived[i]:
            rate += params.velocity_noise[i] * state.draw[i, 1]
        elif state.step_count > 0 and not math.isnan(state.before[i]):
            rate += (reading[i] - state.before[i]) / params.sample_time - state.rate[i]
        elif math.isnan(reading[i]):
            rate = math.nan
        state.rate[i] = rate
    map_vector(params.to_joint, reading, state.measured_position)
    map_vector(params.to_joint, state.rate, state.measured_velocity)


@njit
def _sense(params: np.ndarray, state: np.ndarray, faults: np.ndarray) -> None:
    """For Python: with the memory of records."""
    _take_readings(params[0], state[0], faults)


SIGNALS = ('position', 'velocity', 'fault', 'measured_position', 'measured_velocity', 'effort')


class ArmSimulator:
    """Plant and sensors of one scenario.

    Parameters
    ----------
    arm : SerialArm
        Nominal arm (sensors, limits).
    scenario : Scenario
        Path, plant, noise and faults.
    substeps : int, optional
        Least number of Runge-Kutta steps per sample; stiff friction gets more.

    Attributes
    ----------
    injector : FaultInjector
        Faults, scheduled and injected while running.
    chain : Chain
        The true arm.
    constants, state : numpy.record
        Of `plant_type` and `state_type`.
    noise : numpy.random.Generator
        Of the sensors' noise.
    push : numpy.random.Generator
        Of the disturbance.
    engine : Engine or None
        Integrates the arm in place of `integrate`.
    scratch, matrix : ndarray
        Scratch memory of `integrate`.
    signals : dict
        Arrays of shape (n,), the disturbance's of (1,), that `read` writes, with the fields of
        `state_type`: true ``position``, ``velocity``, ``fault`` and ``disturbance``;
        ``measured_position``, ``measured_velocity`` and ``effort``.
    """

    def __init__(self, arm: SerialArm, scenario: Scenario, substeps: int = 2) -> None:
        self.arm, self.scenario = arm, scenario
        self.sample_time = arm.sample_time
        self.chain = scenario.true_chain(arm)
        streams = np.random.SeedSequence(scenario.seed).spawn(3)
        # One stream per purpose: injecting a fault must not change noise and disturbance.
        self.noise, self.push, chance = (np.random.default_rng(stream) for stream in streams)
        self.injector = FaultInjector(arm.sensor_names, scenario.faults, chance)
        n = len(arm.joints)
        self.constants = plant_constants(arm, scenario, self.chain, substeps)
        self.state = new_record(state_type(n))
        self.state.motion[0] = scenario.path(arm).sample(0.0).position
        self.engine = _engine(arm, scenario, self.chain)
        self.scratch, self.matrix = plant_scratch(self.chain), np.empty((n, n))
        self._work = workspace(self.chain)
        self._memory = memory(self.constants), memory(self.state)
        self.signals = {name: memory(self.state)[name][0] for name in SIGNALS}
        self.signals['disturbance'] = self._memory[1]['disturbance']
        self._sensed = False

    @property
    def step_count(self) -> int:
        """Number of the present sample."""
        return int(self._memory[1]['step_count'][0])

    @property
    def time(self) -> float:
        """Time of the present sample [s]."""
        return self.step_count * self.sample_time

    def step(self, joint_torque: ArrayLike) -> None:
        """Apply a torque over one sample time.

        Parameters
        ----------
        joint_torque : array_like, shape (n,)
            Commanded joint torques [N m]; clipped to the arm's limits.

        Raises
        ------
        ValueError
            If a torque is not finite.
        ConfigError
            If the true arm is not physical.
        """
        torque = np.asarray(joint_torque, float)
        if torque.shape != self.state.torque.shape or not np.isfinite(torque).all():
            raise ValueError(
                f'torque must be {len(self.state.torque)} finite numbers, got {joint_torque!r}'
            )
        set_torque(self.constants, self.state, torque, self.push)
        self.advance()
        self._sensed = False

    def advance(self) -> None:
        """Advance the plant by one sample time under the torque that was set.

        Raises
        ------
        ConfigError
            If the true arm is not physical.
        """
        params, state = self.constants, self.state
        if self.engine is None:
            integrate(self.chain, params, state, self.scratch, self.matrix)
        else:
            self.engine.advance(
                state.motion,
                state.torque,
                state.push,
                float(params.sample_time),
                int(params.substeps),
            )
            state.step_count += 1
        if state.failed:
            raise ConfigError('plant', 'has a mass matrix that is not positive definite')

    def hold(self) -> None:
        """Let one sample time pass with the brakes engaged, see `brake`."""
        brake(self.chain, self.state, self._work)
        self._sensed = False

    def sense(self) -> dict[str, np.ndarray]:
        """Copies of `signals` at the present sample; the same ones when asked again."""
        self.read()
        return {name: values.copy() for name, values in self.signals.items()}

    def read(self) -> None:
        """Read the sensors into `signals`, if that was not done at the present sample."""
        if not self._sensed:
            self.noise.standard_normal(out=self._memory[1]['draw'][0])
            self.injector.draw(self.time)
            _sense(*self._memory, self.injector.records)
            self._sensed = True


def _engine(arm: SerialArm, scenario: Scenario, chain: Chain) -> Engine | None:
    """What integrates the arm in place of `integrate`, if the scenario asks for it."""
    if scenario.plant == 'nonlinear':
        return None
    if scenario.plant == 'mujoco':
        return MujocoChain(chain)
    if scenario.plant in PAPER_PLANTS:
        return PaperPlant(scenario.true_arm(arm), scenario)
    raise ConfigError('plant.model', f'must be one of {", ".join(PLANTS)}, got {scenario.plant!r}')


def plant_constants(
    arm: SerialArm, scenario: Scenario, chain: Chain, substeps: int = 1
) -> np.record:
    """Constants of `plant_type` for a true arm; ``substeps`` as of `ArmSimulator`."""
    joints = arm.joints
    _, needed = integration_step(chain, arm.sample_time)
    count, noise = max(substeps, needed), scenario.noise_factor if scenario.noise else 0.0
    direction, mean, deviation = disturbance_of(arm, scenario)
    return new_record(
        plant_type(len(joints)),
        sample_time=arm.sample_time,
        step=arm.sample_time / count,
        substeps=count,
        torque_limit=arm.torque_limit,
        effort_gain=[joint.torque_gain for joint in joints],
        position_noise=[noise * joint.sensors.position_noise for joint in joints],
        velocity_noise=[noise * joint.sensors.velocity_noise for joint in joints],
        quantization=[joint.sensors.quantization for joint in joints],
        derived=[joint.sensors.rates != 'independent' for joint in joints],
        sensor=arm.joints_to_sensors(),
        to_joint=arm.sensors_to_joints(),
        direction=direction,
        push_mean=mean,
        push_deviation=deviation,
    )
