"""Estimators that reach the limit: a causal extended Kalman filter and a full-information smoother.

Both take what is known of arm and faults as the limit does; parameters of the arm are states.
"""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.arm_prior import ArmKnowledge
from lpv_campaign.limit.kalman_kernels import filter_extended
from lpv_campaign.limit.kalman_smoother import both_passes
from lpv_campaign.limit.linearisation import linearise, measurements, sampled_arm
from lpv_campaign.limit.problem import Problem
from lpv_core.model.joints import JointMap
from lpv_core.support.errors import LpvError

_ITERATIONS = 25
_ARM_HELD = 2
_HELD = 1e-3
"""In the first iterations the arm is nearly the nominal one: while angles are far off, its
parameters would explain them and run away."""
_CONVERGED = 1e-6
_ARM_CONVERGED = 1e-3
"""Largest steps at which iteration ends: of angles and faults [rad], of the arm's parameters over
their standard deviation before any data."""
_SHRINKING = 0.5
"""A step that is not shorter than the last one by so much is halved: Coulomb friction turns over
within a small fraction of a rad/s, about which full steps may swing."""


@dataclass(frozen=True)
class Smoothed:
    """Full-information estimate of one run."""

    angle: np.ndarray  # (n, 2) Absolute angles [rad]
    fault: np.ndarray  # (n, 2) Faults of the position sensors [rad]
    states: np.ndarray  # (n, N) All states, see `lpv_campaign.limit.linearisation`
    iterations: int  # Gauss-Newton steps
    converged: bool  # Whether the last one was small


def smooth(problem: Problem, iterations: int = _ITERATIONS) -> Smoothed:
    """Most probable trajectory of a run given all its data (iterated extended Kalman smoother).

    Each iteration linearises along the last result and solves for all samples at once: Gauss-Newton
    on the posterior, started from the observer's estimate.

    Parameters
    ----------
    problem : Problem
        The run and what is known.
    iterations : int, optional
        At most so many.

    Returns
    -------
    Smoothed
        The estimate.

    Raises
    ------
    LpvError
        If iteration diverged.
    """
    knowledge = problem.knowledge
    states, readings = _first_guess(problem), measurements(problem.arm, problem.run)
    before = np.inf
    for count in range(1, iterations + 1):
        system = linearise(problem, states)
        if count <= _ARM_HELD:
            system.deviation[4 : problem.first_fault] *= _HELD
        defect = np.zeros_like(states)
        defect[:-1] = system.memory * states[:-1] - states[1:]
        defect[:-1, :4] = system.moved[:-1] - states[1:, :4]
        step = both_passes(
            system, readings - system.readings, defect, system.start - states[0]
        ).smoothed
        if not np.isfinite(step).all():
            raise LpvError(f'the smoother diverged in iteration {count}')
        length = _length(step, knowledge)
        if count > _ARM_HELD + 1 and length > _SHRINKING * before:
            step *= 0.5
        states, before = states + step, length
        if count > _ARM_HELD and length < 1.0:
            break
    fault = np.einsum('kqj,kj->kq', system.fault[:, :, 4:], states[:, 4:])
    return Smoothed(states[:, :2], fault, states, count, bool(length < 1.0))


def _length(step: np.ndarray, knowledge: ArmKnowledge) -> float:
    """Largest element of a step over what is small."""
    p = 4 + len(knowledge.deviation)
    moved = np.abs(step).max(axis=0)
    small = np.full(len(moved), _CONVERGED)
    small[4:p] = _ARM_CONVERGED * knowledge.deviation
    return float(np.delete(moved / small, (2, 3)).max())


def _first_guess(problem: Problem) -> np.ndarray:
    joints, states = JointMap(problem.arm), problem.new_states()
    states[:, :2] = joints.absolute_position(problem.run.estimate)
    states[:, 2:4] = joints.absolute_velocity(problem.run.estimated_velocity)
    return states


def filter_adaptively(problem: Problem) -> tuple[np.ndarray, ...]:
    """Causal extended Kalman filter that learns the arm's parameters.

    Given `lpv_campaign.limit.fault_prior.anything`, position sensors serve it for the first sample
    only: like our observer, no position fault reaches its angles.

    Parameters
    ----------
    problem : Problem
        The run and what is known; its faults are additive ones and those of rates.

    Returns
    -------
    tuple of ndarray
        Faults of the position sensors and absolute angles, each (n, 2) [rad].

    Raises
    ------
    LpvError
        If the filter diverged.
    """
    arm, run = problem.arm, problem.run
    system = linearise(problem, problem.new_states())
    system.r[:, 4:] = np.inf  # not linear in the angles
    states = filter_extended(
        JointMap(arm).absolute_torque(run.torque),
        np.ascontiguousarray(run.braked),
        sampled_arm(problem),
        system.noise,
        measurements(arm, run),
        system.start,
        system.deviation,
    )
    if not np.isfinite(states).all():
        raise LpvError('the adaptive filter diverged')
    return np.einsum('kqj,kj->kq', system.fault, states), states[:, :2]
