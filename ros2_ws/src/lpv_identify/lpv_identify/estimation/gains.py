"""Joint torque per unit of effort, where efforts are currents or have no known unit."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpv_core.serial_arm.description import SerialArm
from lpv_identify.estimation.regression import (
    Filters,
    Prior,
    Problem,
    Rows,
    fit_parameters,
    invert_normal,
    join_columns,
    normal_matrix,
)

_ROUNDS = 12
_STEP = 0.4  # largest relative change of a gain in a round


def estimate_gains(rows: Sequence[Rows], filters: Filters, prior: Prior) -> np.ndarray:
    """Factors k that turn efforts into torques, shape (n,) [N m per unit].

    Links couple the joints, which fixes the gains' ratios; their common scale is that of the masses
    in the prior, unless a tool of known mass is measured (`rescaled`).  Gauss-Newton on i = (1/k)
    tau(phi): errors are those of the currents, so that k = 0 is no solution.  A gain is negative
    where a driver counts the other way.
    """
    n = rows[0].effort.shape[1]
    gains = _start(rows, prior)
    for _ in range(_ROUNDS):
        scaled = [replace(one, effort=one.effort * gains) for one in rows]
        fit = fit_parameters(scaled, filters, np.zeros(n, bool), prior, sweeps=3)
        problem = Problem(scaled, filters, np.zeros(n, bool))
        design = join_columns(problem.base, problem.friction(fit.slope, None))
        column = (design @ fit.parameters)[:, :, None] * np.eye(n)
        full = np.concatenate([design, column], axis=2)
        weight = np.broadcast_to(1.0 / fit.scale**2, problem.effort.shape)
        matrix = normal_matrix(full, weight)
        right = np.einsum('ijk,ij->k', full, weight * problem.effort)
        size = len(fit.parameters)
        matrix[:size, :size] += prior.information
        right[:size] += prior.information @ prior.mean
        used = np.diag(matrix) > 0.0
        step = np.zeros(len(right))
        step[used] = invert_normal(matrix[np.ix_(used, used)]) @ right[used]
        change = np.clip(step[size:], -_STEP, _STEP)
        gains = gains / (1.0 + change)
        if np.max(np.abs(change)) < 1e-4:
            break
    return gains


def _start(rows: Sequence[Rows], prior: Prior) -> np.ndarray:
    """Gains with which the prior's torques fit the efforts, friction aside."""
    size = rows[0].base.shape[2]
    model = np.concatenate([(one.base @ prior.mean[:size])[one.part] for one in rows])
    effort = np.concatenate([one.effort[one.part] for one in rows])
    model, effort = model - model.mean(axis=0), effort - effort.mean(axis=0)
    product, power = np.sum(model * effort, axis=0), np.sum(effort**2, axis=0)
    strength = np.sqrt(np.sum(model**2, axis=0) / np.maximum(power, 1e-12))
    correlation = product / np.sqrt(np.maximum(power * np.sum(model**2, axis=0), 1e-24))
    # Friction hides the sign of a joint that carries no weight: it is taken as positive.
    sign = np.where(correlation < -0.3, -1.0, 1.0)
    return sign * np.maximum(strength, 1e-6)


def rescaled(arm: SerialArm, factor: float) -> SerialArm:
    """Arm whose torques, masses and inertias are all larger by a factor."""
    joints = []
    for joint in arm.joints:
        friction = joint.friction
        tolerance = joint.torque_tolerance
        joints.append(
            replace(
                joint,
                link=type(joint.link).from_vector(factor * joint.link.to_vector()),
                friction=replace(
                    friction,
                    offset=factor * friction.offset,
                    viscous=factor * friction.viscous,
                    coulomb=factor * friction.coulomb,
                ),
                rotor_inertia=factor * joint.rotor_inertia,
                torque_gain=factor * joint.torque_gain,
                torque_tolerance=replace(
                    tolerance, torque=tuple(factor * t for t in tolerance.torque)
                ),
            )
        )
    covariance = arm.covariance
    if covariance is not None:
        rows = np.array(covariance.factor) * factor
        n = len(joints)
        rows[:, 13 * n : 14 * n] /= factor  # load-dependent friction has no unit
        covariance = replace(covariance, factor=tuple(tuple(row) for row in rows.tolist()))
    return replace(arm, joints=tuple(joints), covariance=covariance)
