"""A run as a time-varying linear Gaussian system: sampled dynamics and sensors along a trajectory.

State: absolute angles (2), rates (2), parameters of the arm (p), numbers of the fault models (K).
Along the true trajectory its Kalman covariance is the posterior Cramer-Rao bound; along an
estimate it is one Gauss-Newton step of a smoother.
"""

import math
from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.arm_prior import ArmKnowledge
from lpv_campaign.limit.fault_prior import RATE, SCALE, acting
from lpv_campaign.limit.kalman_kernels import Noise, SampledArm, move_and_derive
from lpv_campaign.limit.problem import Problem
from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters, vector_slice
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.errors import ConfigError
from lpv_core.support.records import new_record

READINGS = 6
"""Two positions, two rates, and two generalised torques that hold a braked arm."""
_LEAST_NOISE = 1e-9
"""Noise of a sensor without noise [rad], [rad/s]: variances must stay numerically positive."""
_HOLDING_NOISE = 1e-3
"""The same of the torque that holds a braked arm [N m]."""
_REST = 1e-6
"""Standard deviation of the rates of an arm at rest [rad/s]."""


@dataclass(frozen=True)
class LinearSystem:
    """One run, linearised; n samples, N states."""

    moved: np.ndarray  # (n, 4) Mechanical state one sample after the trajectory's
    f: np.ndarray  # (n, 4, N) Jacobian of that
    g: np.ndarray  # (n, 4) Its derivative by the disturbance d [rad], [rad/s]
    mean: float  # Mean of d
    push: np.ndarray  # (n,) Variance of d
    memory: np.ndarray  # (N,) Factor of each other state per sample; first four entries unused
    growth: np.ndarray  # (N,) Variance that each other state gains per sample; first four unused
    h: np.ndarray  # (n, 6, N) Jacobian of the readings
    readings: np.ndarray  # (n, 6) What the trajectory would read without noise
    r: np.ndarray  # (n, 6) Variance of the readings; infinite for what is not there
    fault: np.ndarray  # (n, 2, N) Jacobian of the position sensors' faults
    start: np.ndarray  # (N,) State before any data
    deviation: np.ndarray  # (N,) its standard deviation

    @property
    def noise(self) -> Noise:
        """What the recursions need to know of noise and sensors."""
        return Noise(self.push, self.memory, self.growth, self.h, self.r)


def linearise(problem: Problem, states: np.ndarray) -> LinearSystem:
    """Linearise a run along a trajectory.

    Parameters
    ----------
    problem : Problem
        The run and what is known.
    states : ndarray, shape (n, N)
        Trajectory.

    Returns
    -------
    LinearSystem
        The system.

    Raises
    ------
    ConfigError
        If the plant is no rigid-body arm.
    """
    arm, scenario, run = problem.arm, problem.scenario, problem.run
    knowledge, faults = problem.knowledge, problem.faults
    if scenario.plant == 'lpv':
        raise ConfigError(
            'plant.model', "must be a rigid-body arm for a limit of accuracy, got 'lpv'"
        )
    size = states.shape[1]
    torques = JointMap(arm).absolute_torque(run.torque)
    sampled = sampled_arm(problem)
    moved, f, g = move_and_derive(
        np.ascontiguousarray(states), torques, np.ascontiguousarray(run.braked), sampled
    )
    push = disturbance_variance(arm, scenario) * ~run.braked
    memory, growth = np.ones(size), np.zeros(size)
    memory[problem.first_fault :] = [model.memory for model in faults]
    growth[problem.first_fault :] = [model.growth for model in faults]
    h, readings, fault = _sensors(problem, states)
    start = np.zeros(size)
    start[:2] = JointMap(arm).absolute_position(run.measured[0])
    deviation = np.concatenate(
        [[1.0, 1.0, _REST, _REST], knowledge.deviation, [model.deviation for model in faults]]
    )
    return LinearSystem(
        moved,
        f,
        g,
        sampled.mean,
        push,
        memory,
        growth,
        h,
        readings,
        _variances(arm, scenario, run),
        fault,
        start,
        deviation,
    )


def sampled_arm(problem: Problem) -> SampledArm:
    """The arm of a problem as the compiled recursions take it."""
    arm, scenario = problem.arm, problem.scenario
    mean = scenario.disturbance_factor * arm.disturbance_mean if scenario.disturbance else 0.0
    direction = np.asarray(arm.disturbance_direction, float)
    return SampledArm(
        problem.knowledge.constants,
        problem.knowledge.sensitivity,
        direction,
        mean,
        arm.sample_time,
        problem.substeps,
        new_record(ARM_CONSTANTS),
    )


def disturbance_variance(arm: ArmParameters, scenario: Scenario) -> float:
    """Variance of d in a scenario."""
    return (
        arm.disturbance_variance * scenario.disturbance_factor**2 if scenario.disturbance else 0.0
    )


def noise_deviations(arm: ArmParameters, scenario: Scenario) -> tuple[float, float]:
    """Standard deviations of the noise of positions [rad] and rates [rad/s] in a scenario."""
    factor = scenario.noise_factor if scenario.noise else 0.0
    return (
        max(factor * arm.position_noise, _LEAST_NOISE),
        max(factor * arm.velocity_noise, _LEAST_NOISE),
    )


def _sensors(problem: Problem, states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Jacobians and values of the readings, Jacobians of the faults."""
    n, size = states.shape
    s, first = JointMap(problem.arm).sensor_matrix, problem.first_fault
    angles, rates = states[:, :2] @ s.T, states[:, 2:4] @ s.T
    h, fault = np.zeros((n, READINGS, size)), np.zeros((n, 2, size))
    readings = np.concatenate([angles, rates, np.zeros((n, 2))], axis=1)
    h[:, :2, :2] = s
    h[:, 2:4, 2:4] = s
    for column, model in enumerate(problem.faults, first):
        i, number = model.sensor, states[:, column]
        if model.kind == RATE:
            h[:, 2 + i, column] = model.shape
            readings[:, 2 + i] += model.shape * number
            continue
        effect = model.shape * (angles[:, i] if model.kind == SCALE else 1.0)
        fault[:, i, column] = effect
        readings[:, i] += effect * number
        if model.kind == SCALE:
            fault[:, i, :2] += (model.shape * number)[:, None] * s[i]
    h[:, :2] += fault
    _holding(problem.knowledge, states, h, readings)
    return h, readings, fault


def _holding(
    knowledge: ArmKnowledge, states: np.ndarray, h: np.ndarray, readings: np.ndarray
) -> None:
    """Torques that hold a braked arm against gravity: Q_i = -G_i sin theta_i."""
    p = len(knowledge.deviation)
    constants = knowledge.constants + states[:, 4 : 4 + p] @ knowledge.sensitivity
    first = vector_slice('gravity').start
    for i, entry in enumerate((first, first + 1)):
        sine = np.sin(states[:, i])
        h[:, 4 + i, i] = -constants[:, entry] * np.cos(states[:, i])
        h[:, 4 + i, 4 : 4 + p] = -sine[:, None] * knowledge.sensitivity[:, entry]
        readings[:, 4 + i] = -constants[:, entry] * sine


def measurements(arm: ArmParameters, run: Run) -> np.ndarray:
    """What was read: positions and rates of the physical sensors, torques that held the arm.

    Returns ndarray of shape (n, 6): [rad], [rad/s], [N m]; NaN for a dropout.
    """
    joints = JointMap(arm)
    torques = joints.absolute_torque(run.torque)
    return np.concatenate(
        [
            joints.sensor_position(run.measured),
            joints.sensor_velocity(run.measured_velocity),
            np.vstack([np.zeros(2), torques[:-1]]),
        ],
        axis=1,
    )


def _variances(arm: ArmParameters, scenario: Scenario, run: Run) -> np.ndarray:
    position, rate = noise_deviations(arm, scenario)
    r = np.empty((len(run.time), READINGS))
    r[:, :2], r[:, 2:4], r[:, 4:] = position**2, rate**2, math.inf
    for fault in scenario.faults:
        if fault.kind == 'stuck':  # the frozen value carries no noise
            sensor = arm.sensor_names.index(fault.sensor)
            r[acting(fault, run.time), sensor] = _LEAST_NOISE**2
    # The message after a braked step carries the torque that held the arm.
    r[1:, 4:][run.braked[:-1]] = _HOLDING_NOISE**2
    r[~np.isfinite(measurements(arm, run))] = math.inf
    r[run.lost] = math.inf
    return r
