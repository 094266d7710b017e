"""The simulated arm with its sensors: plant, disturbance, noise and faults, step by step.

All functions take constants (`PLANT_CONSTANTS`) and state (`PLANT_STATE`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.model.dynamics import inverse_dynamics, rk4_step
from lpv_core.model.joints import JOINT_MAP, JointMap, joint_angle, row_dot
from lpv_core.model.polytope import sinc_box
from lpv_core.model.state_space import LPV_PLANT, lpv_rk4_step, vertex_matrices
from lpv_core.simulation.faults import (
    FaultInjector,
    apply_faults,
    derived_rate_error,
    draw_chances,
    is_frozen,
    rate_bias,
)
from lpv_core.simulation.mujoco_plant import MujocoPlant
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.jit import njit
from lpv_core.support.records import memory, new_record, plain, record_type

PLANT_CONSTANTS = record_type(
    ('joints', JOINT_MAP),
    ('arm', ARM_CONSTANTS),  # constants of the true arm
    ('is_lpv', '?'),
    ('lpv', LPV_PLANT),  # the paper's plant
    ('sample_time', 'f8'),  # [s]
    ('substeps', 'i8'),  # Runge-Kutta steps per sample
    ('torque_limit', 'f8', (2,)),  # [N m]
    ('direction', 'f8', (2,)),  # Bd of the disturbance d
    ('push_mean', 'f8'),  # of d
    ('push_deviation', 'f8'),  # standard deviation of d
    ('disturbed', '?'),
    ('noisy', '?'),
    ('position_noise', 'f8'),  # standard deviation [rad]
    ('velocity_noise', 'f8'),  # standard deviation [rad/s]
    ('derived', '?'),  # rates are differences of the positions: faults are in both
)
SIGNALS = ('position', 'velocity', 'fault', 'measured_position', 'measured_velocity')
PLANT_STATE = record_type(
    ('state', 'f8', (4,)),  # absolute angles and rates [rad], [rad/s]
    ('step_count', 'i8'),  # number of the present sample
    ('torque', 'f8', (2,)),  # joint torque over the step before [N m]
    ('disturbance', 'f8'),  # d over the step before
    ('position', 'f8', (2,)),  # true joint positions [rad]
    ('velocity', 'f8', (2,)),  # true joint rates [rad/s]
    ('measured_position', 'f8', (2,)),  # [rad]
    ('measured_velocity', 'f8', (2,)),  # [rad/s]
    ('fault', 'f8', (2,)),  # of the physical sensors, NaN in a dropout [rad]
    ('reading', 'f8', (2,)),  # work space: readings of the physical sensors [rad]
    ('draw', 'f8', (4,)),  # standard normal numbers for the noise of the present readings
    ('rho', 'f8', (8,)),  # work space of the LPV plant
)


@njit
def set_torque(
    params: np.record,
    state: np.record,
    torque_1: float,
    torque_2: float,
    generator: np.random.Generator,
) -> None:
    """Set joint torques [N m] for the coming step, within limits, and draw the disturbance."""
    draw = generator.standard_normal() if params.disturbed else 0.0
    _set_inputs(params, state, torque_1, torque_2, draw)


@njit
def _set_inputs(
    params: np.record, state: np.record, torque_1: float, torque_2: float, draw: float
) -> None:
    state.torque[0] = min(max(torque_1, -params.torque_limit[0]), params.torque_limit[0])
    state.torque[1] = min(max(torque_2, -params.torque_limit[1]), params.torque_limit[1])
    state.disturbance = 0.0
    if params.disturbed:
        state.disturbance = params.push_mean + params.push_deviation * draw


@njit
def integrate(params: np.record, state: np.record) -> None:
    """Advance the plant by one sample time."""
    torque = state.torque[0] - state.torque[1], state.torque[1]  # Q = J^T tau
    d, x = state.disturbance, state.state
    push = params.direction[0] * d, params.direction[1] * d
    now, dt = (x[0], x[1], x[2], x[3]), params.sample_time / params.substeps
    for _ in range(params.substeps):
        if params.is_lpv:
            now = lpv_rk4_step(now, torque, push, dt, params.lpv, state.rho)
        else:
            now = rk4_step(now, torque, push, dt, params.arm)
    x[0], x[1], x[2], x[3] = now
    state.step_count += 1


@njit
def brake(params: np.record, state: np.record) -> None:
    """Let one sample time pass with the brakes engaged: no motion, no disturbance felt.

    The torque sensors then read what holds the arm.
    """
    x = state.state
    x[2] = x[3] = 0.0
    q_1, q_2 = inverse_dynamics(x[0], x[1], 0.0, 0.0, 0.0, 0.0, params.arm)
    state.torque[0], state.torque[1] = q_1 + q_2, q_2
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
    for i in range(4):
        state.draw[i] = noise.standard_normal()
    draw_chances(faults, state.step_count * params.sample_time, chance)
    _take_readings(params, state, faults)


@njit
def _take_readings(params: np.record, state: np.record, faults: np.ndarray) -> None:
    """Read the sensors with the random numbers that have been drawn."""
    x, joints, time = state.state, params.joints, state.step_count * params.sample_time
    for i in range(2):
        state.position[i] = joint_angle(joints, joints.j, i, x[0], x[1])
        state.velocity[i] = row_dot(joints.j, i, x[2], x[3])
        state.reading[i] = row_dot(joints.sensor, i, x[0], x[1])
    true_1, true_2 = state.reading[0], state.reading[1]
    before_1, before_2 = state.fault[0], state.fault[1]
    apply_faults(faults, time, state.reading, params.sample_time)
    state.fault[0], state.fault[1] = state.reading[0] - true_1, state.reading[1] - true_2
    rate_1 = row_dot(joints.sensor, 0, x[2], x[3]) + rate_bias(faults, 0, time)
    rate_2 = row_dot(joints.sensor, 1, x[2], x[3]) + rate_bias(faults, 1, time)
    if params.derived and state.step_count > 0:
        rate_1 += derived_rate_error(state.fault[0], before_1, params.sample_time)
        rate_2 += derived_rate_error(state.fault[1], before_2, params.sample_time)
    if params.noisy:
        if not is_frozen(faults, 0, time):
            state.reading[0] += params.position_noise * state.draw[0]
        if not is_frozen(faults, 1, time):
            state.reading[1] += params.position_noise * state.draw[1]
        rate_1 += params.velocity_noise * state.draw[2]
        rate_2 += params.velocity_noise * state.draw[3]
    for i in range(2):
        state.measured_position[i] = joint_angle(
            joints, joints.to_joint, i, state.reading[0], state.reading[1]
        )
        state.measured_velocity[i] = row_dot(joints.to_joint, i, rate_1, rate_2)


# Python calls the following with the memory of records: `lpv_core.support.records.memory`.


@njit
def _act(
    params: np.ndarray,
    state: np.ndarray,
    torque: tuple[float, float],
    draw: float,
    integrates: bool,
) -> None:
    _set_inputs(params[0], state[0], torque[0], torque[1], draw)
    if integrates:
        integrate(params[0], state[0])


@njit
def _brake(params: np.ndarray, state: np.ndarray) -> None:
    brake(params[0], state[0])


@njit
def _sense(params: np.ndarray, state: np.ndarray, faults: np.ndarray) -> None:
    _take_readings(params[0], state[0], faults)


@dataclass(frozen=True)
class Measurement:
    """Readings of the sensors, in ROS joint coordinates."""

    position: np.ndarray  # faulty, noisy joint positions, shape (2,) [rad]
    velocity: np.ndarray  # noisy joint rates, shape (2,) [rad/s]
    effort: np.ndarray  # joint torque that acted over the step before, shape (2,) [N m]


@dataclass(frozen=True)
class Truth:
    """True state of the arm, which no observer may know."""

    position: np.ndarray  # true joint positions, shape (2,) [rad]
    velocity: np.ndarray  # true joint rates, shape (2,) [rad/s]
    # reading minus truth before noise, of the physical sensors, shape (2,) [rad]; NaN in a dropout
    fault: np.ndarray
    disturbance: float  # d over the step before


class ArmSimulator:
    """Plant and sensors of one scenario.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm (sensors, limits, disturbance).
    scenario : Scenario
        Path, plant, noise, disturbance and faults.
    substeps : int, optional
        Runge-Kutta steps per sample.

    Attributes
    ----------
    injector : FaultInjector
        Faults, scheduled and injected while running.
    constants, state : numpy.record
        Of types `PLANT_CONSTANTS` and `PLANT_STATE`.
    noise, push : numpy.random.Generator
        Of the sensors' noise and of the disturbance.
    engine : MujocoPlant or None
        Integrates the arm in place of `integrate`.
    signals : dict
        Arrays of shape (2,), the disturbance's of (1,), that `read` writes: true ``position``,
        ``velocity``, ``fault`` and ``disturbance``, ``measured_position``,
        ``measured_velocity`` and ``effort``.
    """

    def __init__(self, arm: ArmParameters, scenario: Scenario, substeps: int = 2) -> None:
        self.arm, self.scenario = arm, scenario
        self.sample_time = arm.sample_time
        self.joints = JointMap(arm)
        streams = np.random.SeedSequence(scenario.seed).spawn(3)
        # One stream per purpose: injecting a fault must not change noise and disturbance.
        self.noise, self.push, fault_stream = (np.random.default_rng(s) for s in streams)
        self.injector = FaultInjector(arm.sensor_names, scenario.faults, fault_stream)
        true_arm = scenario.true_arm(arm)
        self.constants = _plant_constants(arm, true_arm, scenario, substeps)
        self.engine: MujocoPlant | None = None
        if scenario.plant == 'mujoco':
            self.engine = MujocoPlant(true_arm, scenario.coulomb)
        self.state = new_record(PLANT_STATE)
        self._memory, self._shown = (memory(self.constants), memory(self.state)), plain(self.state)
        self.signals = {name: memory(self.state)[name][0] for name in SIGNALS}
        self.signals['effort'] = self._shown['torque']
        self.signals['disturbance'] = memory(self.state)['disturbance']
        self.state.state[:2] = self.joints.absolute_position(
            scenario.path(arm).sample(0.0).position
        )
        self._step_count = memory(self.state)['step_count']
        self._disturbed = bool(self.constants.disturbed)
        self._sensed = False

    @property
    def step_count(self) -> int:
        """Number of the present sample."""
        return int(self._step_count[0])

    @property
    def time(self) -> float:
        """Time of the present sample [s]."""
        return self.step_count * self.sample_time

    def step(self, joint_torque: Sequence[float] | np.ndarray) -> None:
        """Apply a torque over one sample time.

        Parameters
        ----------
        joint_torque : sequence of float, shape (2,)
            Commanded joint torques [N m]; clipped to the arm's limits.

        Raises
        ------
        ValueError
            If a torque is not finite.
        """
        if len(joint_torque) != 2 or not all(map(math.isfinite, joint_torque)):
            raise ValueError(f'torque must be two finite numbers, got {joint_torque!r}')
        torque = float(joint_torque[0]), float(joint_torque[1])
        draw = self.push.standard_normal() if self._disturbed else 0.0
        _act(*self._memory, torque, draw, self.engine is None)
        if self.engine is not None:
            self.advance()
        self._sensed = False

    def advance(self) -> None:
        """Advance the plant by one sample time under the torque that was set."""
        params, state = self.constants, self.state
        if self.engine is None:
            integrate(params, state)
            return
        torque = self.joints.absolute_torque(state.torque)
        push = params.direction * state.disturbance
        state.state[:] = self.engine.advance(
            state.state, torque, push, self.sample_time, int(params.substeps)
        )
        state.step_count += 1

    def hold(self) -> None:
        """Let one sample time pass with the brakes engaged, see `brake`.

        Drives brake until the first command and after a safe stop.
        """
        _brake(*self._memory)
        self._sensed = False

    def sense(self) -> tuple[Measurement, Truth]:
        """Readings and truth at the present sample; the same ones when asked again."""
        self.read()
        return copy_signals(self.signals)

    def read(self) -> None:
        """Read the sensors into `signals`, if that was not done at the present sample."""
        if not self._sensed:
            self.noise.standard_normal(out=self._shown['draw'])
            self.injector.draw(self.time)
            _sense(*self._memory, self.injector.records)
            self._sensed = True


def copy_signals(signals: dict[str, np.ndarray]) -> tuple[Measurement, Truth]:
    """Readings and truth of a simulator's `signals`."""
    now = {name: values.copy() for name, values in signals.items()}
    return (
        Measurement(now['measured_position'], now['measured_velocity'], now['effort']),
        Truth(now['position'], now['velocity'], now['fault'], float(now['disturbance'][0])),
    )


def _plant_constants(
    arm: ArmParameters, true_arm: ArmParameters, scenario: Scenario, substeps: int
) -> np.record:
    params = new_record(
        PLANT_CONSTANTS,
        joints=JointMap(arm).record(),
        arm=true_arm.constants(scenario.plant in ('nonlinear', 'mujoco')),
        sample_time=arm.sample_time,
        substeps=substeps,
        torque_limit=arm.torque_limit,
        direction=arm.disturbance_direction,
        push_mean=scenario.disturbance_factor * arm.disturbance_mean,
        push_deviation=scenario.disturbance_factor * math.sqrt(arm.disturbance_variance),
        disturbed=scenario.disturbance,
        noisy=scenario.noise,
        position_noise=scenario.noise_factor * arm.position_noise,
        velocity_noise=scenario.noise_factor * arm.velocity_noise,
        derived=arm.rates == 'derived',
    )
    if scenario.plant == 'lpv':
        box = sinc_box(scenario.sinc_min)
        a, b = vertex_matrices(box, true_arm.constants(False))
        params.is_lpv, params.lpv = True, new_record(LPV_PLANT, box=box, a=a, b=b)
    return params
