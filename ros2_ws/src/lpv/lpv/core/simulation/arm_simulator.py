"""A simulated arm with its sensors: plant, disturbance, noise and faults, step by step."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lpv.core.serial_arm.chain import OFFSET, BoolArray, Chain, FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
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
from lpv.core.support.jit import Entries
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import memory, new_record, record_type


class PlantConstants(NamedTuple):
    """Constants of plant and sensors."""

    sample_time: float  # [s]
    step: float  # of integration [s]
    substeps: int  # steps per sample
    push_deviation: float  # standard deviation of the disturbance d
    torque_limit: FloatArray  # (n,) [N m]
    effort_gain: FloatArray  # (n,) joint torque per unit of effort [N m/unit]
    position_noise: FloatArray  # (n,) standard deviation, 0 without noise [rad]
    velocity_noise: FloatArray  # (n,) of independent rates [rad/s]
    quantization: FloatArray  # (n,) step of the readings, 0: none [rad]
    derived: BoolArray  # (n,) whether the rate is the difference of the readings
    sensor: FloatArray  # (n, n) S of y = S q + f
    to_joint: FloatArray  # (n, n) S^-1
    direction: FloatArray  # (n,) accelerations per unit of d [rad/s2]


PLANT_STATE = record_type(
    ('step_count', 'i8'),  # number of the present sample
    ('push_mean', 'f8'),  # of the disturbance d
    ('disturbance', 'f8'),  # d over the step before
    ('failed', '?'),  # the mass matrix was not positive definite
)


class PlantState(NamedTuple):
    """State of plant and sensors."""

    own: np.ndarray  # memory of a record of `PLANT_STATE`
    motion: FloatArray  # (2, n) true joint positions and rates [rad], [rad/s]
    draw: FloatArray  # (n, 2) standard normal numbers for the noise of readings and rates
    torque: FloatArray  # (n,) joint torque over the step before [N m], as all that follow
    position: FloatArray  # true, at the last reading [rad]
    velocity: FloatArray  # true, at the last reading [rad/s]
    measured_position: FloatArray  # [rad]
    measured_velocity: FloatArray  # [rad/s]
    fault: FloatArray  # of the sensors, NaN in a dropout [rad]
    reading: FloatArray  # of the sensors [rad]
    rate: FloatArray  # of the sensors [rad/s]
    before: FloatArray  # readings of the sample before [rad]
    push: FloatArray  # accelerations by d over the step before [rad/s2]
    effort: FloatArray  # measured, in its own unit


class PlantParts(NamedTuple):
    """What the compiled functions take."""

    chain: Chain  # the true arm
    constants: PlantConstants
    state: PlantState
    faults: np.ndarray  # records of `FaultInjector`
    scratch: FloatArray  # of `plant_step`, as the next one
    matrix: FloatArray


class Chances(NamedTuple):
    """One stream of random numbers for each purpose: a fault must not change noise or disturbance.

    Where Python calls compiled functions, a generator costs as much as all the rest.
    """

    noise: np.random.Generator  # of the sensors
    push: np.random.Generator  # of the disturbance
    fault: np.random.Generator


@njit
def set_torque(plant: PlantParts, torque: FloatArray, generator: np.random.Generator) -> None:
    """Set joint torques [N m] for the coming step, within limits, and draw the disturbance."""
    params, state, own = plant.constants, plant.state, plant.state.own[0]
    draw = generator.standard_normal() if params.push_deviation > 0.0 else 0.0
    own.disturbance = own.push_mean + params.push_deviation * draw
    for i in range(torque.shape[0]):
        limit = params.torque_limit[i]
        state.torque[i] = min(max(torque[i], -limit), limit)
        state.push[i] = params.direction[i] * own.disturbance


@njit
def integrate(plant: PlantParts, torque: FloatArray) -> None:
    """Advance the plant by one sample time with torques of drives and from outside [N m]."""
    params, state = plant.constants, plant.state
    if not plant_step(
        plant.chain, state.motion, torque, params.step, params.substeps, plant.scratch,
        plant.matrix, state.push,
    ):  # fmt: skip
        state.own[0].failed = True
    state.own[0].step_count += 1


@njit
def drive(plant: PlantParts, torque: FloatArray, generator: np.random.Generator) -> None:
    """Let one sample time pass with torques of the drives [N m], see `set_torque`."""
    set_torque(plant, torque, generator)
    integrate(plant, plant.state.torque)


@njit
def brake(plant: PlantParts) -> None:
    """Let one sample time pass with the brakes engaged; efforts then read what holds the arm."""
    chain, state = plant.chain, plant.state
    n, position, still = state.torque.shape[0], state.motion[0], state.motion[1]
    still[:] = 0.0
    inverse_dynamics(chain, position, still, still, plant.scratch[:n], state.torque)
    for i in range(n):
        state.torque[i] += chain.friction[i, OFFSET]
    state.own[0].disturbance = 0.0
    state.own[0].step_count += 1


@njit
def read_sensors(
    plant: PlantParts, noise: np.random.Generator, chance: np.random.Generator
) -> None:
    """Read the sensors at the present sample, with noise and faults from two generators."""
    params, state, faults = plant.constants, plant.state, plant.faults
    # Drawn with or without noise, so that both runs share the later numbers.
    for i in range(state.draw.shape[0]):
        state.draw[i, 0], state.draw[i, 1] = noise.standard_normal(), noise.standard_normal()
    reading, n = state.reading, state.reading.shape[0]
    time = state.own[0].step_count * params.sample_time
    draw_chances(faults, time, chance)
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
        elif not math.isnan(state.before[i]):
            rate += (reading[i] - state.before[i]) / params.sample_time - state.rate[i]
        elif math.isnan(reading[i]):
            rate = math.nan
        state.rate[i] = rate
    map_vector(params.to_joint, reading, state.measured_position)
    map_vector(params.to_joint, state.rate, state.measured_velocity)


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
    state : PlantState
        Of plant and sensors.
    chances : Chances
        Of the run.
    engine : MujocoChain, PaperPlant or None
        Integrates the arm in place of `integrate`.
    signals : dict
        Arrays of shape (n,), the disturbance's of (1,), that `read` writes, with the fields of
        `state`: true ``position``, ``velocity``, ``fault`` and ``disturbance``;
        ``measured_position``, ``measured_velocity`` and ``effort``.
    """

    def __init__(self, arm: SerialArm, scenario: Scenario, substeps: int = 2) -> None:
        self.sample_time, n, chain = arm.sample_time, len(arm.joints), scenario.true_chain(arm)
        streams = np.random.SeedSequence(scenario.seed).spawn(3)
        self.chances = Chances(*(np.random.default_rng(stream) for stream in streams))
        self.injector = FaultInjector(arm.sensor_names, scenario.faults, self.chances.fault)
        constants = plant_constants(arm, scenario, chain, substeps)
        self.state = plant_state(n, disturbance_of(arm, scenario)[1])
        self.state.motion[0] = scenario.path(arm).sample(0.0).position
        self.engine = _engine(arm, scenario, chain)
        rest = self.injector.records, plant_scratch(chain), np.empty((n, n))
        self._parts = PlantParts(chain, constants, self.state, *rest)
        self.signals = {name: getattr(self.state, name) for name in SIGNALS}
        self.signals['disturbance'] = self.state.own['disturbance']
        self._sensed, self._call = False, Entries()

    @property
    def parts(self) -> PlantParts:
        """For loops that call the compiled functions, until a fault is injected or cleared."""
        if self._parts.faults is not self.injector.records:
            self._parts = self._parts._replace(faults=self.injector.records)
        return self._parts

    @property
    def step_count(self) -> int:
        """Number of the present sample."""
        return int(self.state.own['step_count'][0])

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
        torque = np.ascontiguousarray(joint_torque, float)
        if torque.shape != self.state.torque.shape or not np.isfinite(torque).all():
            raise ValueError(
                f'torque must be {len(self.state.torque)} finite numbers, got {joint_torque!r}'
            )
        act = drive if self.engine is None else set_torque
        self._call(act, self.parts, torque, self.chances.push)
        self.advance()
        self._sensed = False

    def advance(self) -> None:
        """Let the engine, if there is one, advance the plant by one sample time.

        Raises
        ------
        ConfigError
            If the true arm is not physical.
        """
        state, steps = self.state, self._parts.constants.substeps
        if self.engine is not None:
            self.engine.advance(state.motion, state.torque, state.push, self.sample_time, steps)
            state.own['step_count'] += 1
        refuse_failure(state)

    def hold(self) -> None:
        """Let one sample time pass with the brakes engaged, see `brake`."""
        self._call(brake, self.parts)
        self._sensed = False

    def sense(self) -> dict[str, np.ndarray]:
        """Copies of `signals` at the present sample; the same ones when asked again."""
        self.read()
        return {name: values.copy() for name, values in self.signals.items()}

    def read(self) -> None:
        """Read the sensors into `signals`, if that was not done at the present sample."""
        if not self._sensed:
            self._call(read_sensors, self.parts, self.chances.noise, self.chances.fault)
            self._sensed = True


def refuse_failure(state: PlantState) -> None:
    """Raise `ConfigError` if the true arm could not be moved on."""
    if not state.own['failed'][0]:
        return
    fastest = np.abs(state.motion[1]).max()
    raise ConfigError(
        'plant',
        'has a mass matrix that is not positive definite, or its joints, the fastest of which is at'
        f' {fastest:.3g} rad/s (m/s), are too light for steps of that length: give rotor inertias',
    )


def _engine(arm: SerialArm, scenario: Scenario, chain: Chain) -> MujocoChain | PaperPlant | None:
    """What integrates the arm in place of `integrate`, if the scenario asks for it."""
    if scenario.plant == 'nonlinear':
        return None
    if scenario.plant == 'mujoco':
        return MujocoChain(chain)
    if scenario.plant in PAPER_PLANTS:
        return PaperPlant(scenario.true_arm(arm), scenario)
    raise ConfigError('plant.model', f'must be one of {", ".join(PLANTS)}, got {scenario.plant!r}')


def plant_constants(
    arm: SerialArm, scenario: Scenario, chain: Chain, substeps: int = 1, margin: int = 1
) -> PlantConstants:
    """Constants for a true arm; ``substeps`` as of `ArmSimulator`.

    ``margin`` times the steps that this arm needs are made: others may be simulated by them.
    """
    needed = margin * integration_step(chain, arm.sample_time)[1]
    count, noise = max(substeps, needed), scenario.noise_factor if scenario.noise else 0.0
    direction, _, deviation = disturbance_of(arm, scenario)
    sensors = arm.sensors()
    return PlantConstants(
        sample_time=float(arm.sample_time),
        step=float(arm.sample_time / count),
        substeps=int(count),
        push_deviation=float(deviation),
        torque_limit=np.array(arm.torque_limit, float),
        effort_gain=np.array(arm.torque_gain, float),
        position_noise=noise * sensors.position_noise,
        velocity_noise=noise * sensors.velocity_noise,
        quantization=sensors.quantization,
        derived=~sensors.independent,
        sensor=arm.joints_to_sensors(),
        to_joint=arm.sensors_to_joints(),
        direction=np.array(direction, float),
    )


def plant_state(joints: int, push_mean: float = 0.0) -> PlantState:
    """State of so many joints at rest at zero, without a reading."""
    own = memory(new_record(PLANT_STATE, push_mean=push_mean))
    state = PlantState(own, np.zeros((2, joints)), np.zeros((joints, 2)), *np.zeros((11, joints)))
    state.reading[:] = math.nan  # none was taken yet
    return state
