"""A simulated serial arm with its sensors, step by step; the interface is `ArmSimulator`'s.

All compiled functions take constants (`serial_plant_type`) and state (`serial_state_type`).
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from lpv_core.serial_arm.chain import OFFSET, Chain, FloatArray, workspace
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.dynamics.newton_euler import gravity_torque
from lpv_core.serial_arm.simulation import integration_step, plant_scratch, plant_step
from lpv_core.simulation.arm_simulator import SIGNALS, Measurement, Truth, copy_signals
from lpv_core.simulation.faults import (
    FaultInjector,
    apply_faults,
    draw_chances,
    is_frozen,
    rate_bias,
)
from lpv_core.simulation.mujoco_chain import MujocoChain
from lpv_core.simulation.serial_scenario import SerialScenario
from lpv_core.support.errors import ConfigError
from lpv_core.support.jit import njit_in_place as njit
from lpv_core.support.records import memory, new_record, record_type


def serial_plant_type(joints: int) -> np.dtype:
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
    )


def serial_state_type(joints: int) -> np.dtype:
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
        ('before', 'f8', (joints,)),  # readings of the sample before [rad]
        ('effort', 'f8', (joints,)),  # measured, in its own unit
        ('draw', 'f8', (joints, 2)),  # standard normal numbers for the noise of readings and rates
        ('failed', '?'),  # the mass matrix was not positive definite
    )


@njit
def set_torque(params: np.record, state: np.record, torque: FloatArray) -> None:
    """Set joint torques [N m] for the coming step, within limits."""
    for i in range(torque.shape[0]):
        limit = params.torque_limit[i]
        state.torque[i] = min(max(torque[i], -limit), limit)


@njit
def integrate(
    chain: Chain, params: np.record, state: np.record, scratch: FloatArray, matrix: FloatArray
) -> None:
    """Advance the plant by one sample time; scratch memory as of `plant_step`."""
    if not plant_step(
        chain, state.motion, state.torque, params.step, params.substeps, scratch, matrix
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
    time, reading = state.step_count * params.sample_time, state.measured_position
    n = reading.shape[0]
    for i in range(n):
        state.position[i], state.velocity[i] = state.motion[0, i], state.motion[1, i]
        state.before[i], reading[i] = reading[i], state.position[i]
    apply_faults(faults, time, reading, params.sample_time)
    for i in range(n):
        state.fault[i] = reading[i] - state.position[i]
        state.effort[i] = state.torque[i] / params.effort_gain[i]
        if not is_frozen(faults, i, time):
            reading[i] += params.position_noise[i] * state.draw[i, 0]
        quantum = params.quantization[i]
        if quantum > 0.0:
            reading[i] = np.round(reading[i] / quantum) * quantum
        rate = state.velocity[i] + rate_bias(faults, i, time)
        if not params.derived[i]:
            rate += params.velocity_noise[i] * state.draw[i, 1]
        elif state.step_count > 0 and not math.isnan(state.before[i]):
            rate += (reading[i] - state.before[i]) / params.sample_time - state.velocity[i]
        elif math.isnan(reading[i]):
            rate = math.nan
        state.measured_velocity[i] = rate


@njit
def _sense(params: np.ndarray, state: np.ndarray, faults: np.ndarray) -> None:
    """For Python: with the memory of records."""
    _take_readings(params[0], state[0], faults)


class SerialArmSimulator:
    """Plant and sensors of one scenario.

    Parameters
    ----------
    arm : SerialArm
        Nominal arm (sensors, limits).
    scenario : SerialScenario
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
        Of `serial_plant_type` and `serial_state_type`.
    noise : numpy.random.Generator
        Of the sensors' noise.
    engine : MujocoChain or None
        Integrates the arm in place of `integrate`.
    scratch, matrix : ndarray
        Scratch memory of `integrate`.
    signals : dict
        As `lpv_core.simulation.arm_simulator.ArmSimulator.signals`, of shape (n,).
    """

    def __init__(self, arm: SerialArm, scenario: SerialScenario, substeps: int = 2) -> None:
        self.arm, self.scenario = arm, scenario
        self.sample_time = arm.sample_time
        self.chain = scenario.true_arm(arm)
        streams = np.random.SeedSequence(scenario.seed).spawn(3)
        # One stream per purpose: injecting a fault must not change the noise.
        self.noise, fault_stream = np.random.default_rng(streams[0]), streams[2]
        self.injector = FaultInjector(
            arm.sensor_names, scenario.faults, np.random.default_rng(fault_stream)
        )
        n = len(arm.joints)
        self.constants = _constants(arm, scenario, self.chain, substeps)
        self.state = new_record(serial_state_type(n))
        self.state.motion[0] = scenario.path(arm).sample(0.0).position
        self.engine = MujocoChain(self.chain) if scenario.plant == 'mujoco' else None
        self.scratch, self.matrix = plant_scratch(self.chain), np.empty((n, n))
        self._work = workspace(self.chain)
        self._memory = memory(self.constants), memory(self.state)
        self.signals = {name: memory(self.state)[name][0] for name in (*SIGNALS, 'effort')}
        self.signals['disturbance'] = np.zeros(1)
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
        set_torque(self.constants, self.state, torque)
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
                state.motion, state.torque, float(params.sample_time), int(params.substeps)
            )
            state.step_count += 1
        if state.failed:
            raise ConfigError('plant', 'has a mass matrix that is not positive definite')

    def hold(self) -> None:
        """Let one sample time pass with the brakes engaged, see `brake`."""
        brake(self.chain, self.state, self._work)
        self._sensed = False

    def sense(self) -> tuple[Measurement, Truth]:
        """Readings and truth at the present sample; the same ones when asked again."""
        self.read()
        return copy_signals(self.signals)

    def read(self) -> None:
        """Read the sensors into `signals`, if that was not done at the present sample."""
        if not self._sensed:
            self.noise.standard_normal(out=self._memory[1]['draw'][0])
            self.injector.draw(self.time)
            _sense(*self._memory, self.injector.records)
            self._sensed = True


def _constants(arm: SerialArm, scenario: SerialScenario, chain: Chain, substeps: int) -> np.record:
    joints = arm.joints
    _, needed = integration_step(chain, arm.sample_time)
    count, noise = max(substeps, needed), scenario.noise_factor if scenario.noise else 0.0
    return new_record(
        serial_plant_type(len(joints)),
        sample_time=arm.sample_time,
        step=arm.sample_time / count,
        substeps=count,
        torque_limit=arm.torque_limit,
        effort_gain=[joint.torque_gain for joint in joints],
        position_noise=[noise * joint.sensors.position_noise for joint in joints],
        velocity_noise=[noise * joint.sensors.velocity_noise for joint in joints],
        quantization=[joint.sensors.quantization for joint in joints],
        derived=[joint.sensors.rates != 'independent' for joint in joints],
    )
