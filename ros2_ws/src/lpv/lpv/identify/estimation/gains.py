"""Joint torque per unit of effort, where efforts are currents or have no known unit."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lpv.core.serial_arm.description import N_INERTIAL, SerialArm
from lpv.identify.estimation.assembly import with_joint_values, with_parameters
from lpv.identify.estimation.regression import Problem, Rows, fit_parameters
from lpv.identify.estimation.robust import normal_equations, predicted, solve_normal
from lpv.identify.model.friction import TERMS
from lpv.identify.model.prior import Prior
from lpv.identify.recordings.motion import Bandwidths

_ROUNDS = 12  # most: (1 + _STEP)^12 = 57 times a gain
_STEP = 0.4  # largest relative change of a gain in a round
_SEEN = 0.5  # correlation of torques with efforts above which they show the gain
_WIDTH = 0.5  # of the logarithm of a gain about that at which the masses given fit
_HELD = 0.01  # the same of a joint whose links' torques do not show


def estimate_gains(rows: Sequence[Rows], bands: Bandwidths, prior: Prior) -> np.ndarray:
    """Factors k that turn efforts into torques, of either sign, shape (n,) [N m per unit]."""
    # Links couple the joints, which fixes ratios: Gauss-Newton on i = (1/k) tau(phi), errors being
    # those of currents.  The common scale is not in the data: it is that at which torques of links
    # are as large as those of the masses given; a prior alone would shrink it down to nothing.
    n = rows[0].effort.shape[1]
    start, seen = _start(rows, prior)
    gains, held = start, np.where(seen, _WIDTH, _HELD) ** -2
    expected = link_sizes(rows, prior.mean)
    for _ in range(_ROUNDS):
        scaled = [replace(one, effort=one.effort * gains) for one in rows]
        fit = fit_parameters(scaled, bands, prior)
        found = link_sizes(rows, fit.parameters)
        common = float(np.linalg.norm(expected) / max(float(np.linalg.norm(found)), 1e-12))
        problem = Problem(scaled, bands)
        design = problem.design(fit.slope, fit.parameters)
        full = np.concatenate([design, (design @ fit.parameters)[:, :, None] * np.eye(n)], axis=2)
        weight = problem.counts / fit.scale**2
        matrix, right = normal_equations(full, problem.effort, weight, prior)
        matrix[-n:, -n:] += np.diag(held)
        right[-n:] += held * np.log(gains / start)
        # Ratios only: the scale of all, by the joints that carry most, is held.
        share = found / max(float(found.sum()), 1e-12)
        matrix[-n:, -n:] += 1e3 * np.trace(matrix[-n:, -n:]) * np.outer(share, share)
        step = solve_normal(matrix, right)[-n:]
        change = np.clip(step, -_STEP, _STEP) - np.clip(np.log(common), -_STEP, _STEP)
        gains = gains * np.exp(-change)
        if np.max(np.abs(change)) < 1e-3:
            break
    return gains


def _link_torques(rows: Sequence[Rows], parameters: np.ndarray) -> np.ndarray:
    """Torques of the links, shape (samples, n) [N m]."""
    size = rows[0].base.shape[2]
    return np.concatenate([predicted(one.base, parameters[:size])[one.part] for one in rows])


def link_sizes(rows: Sequence[Rows], parameters: np.ndarray) -> np.ndarray:
    """Standard deviation of the links' torques of each joint, shape (n,) [N m]."""
    # Not their mean, as a lift's weight: an offset may stand for it.
    return np.std(_link_torques(rows, parameters), axis=0)


def _start(rows: Sequence[Rows], prior: Prior) -> tuple[np.ndarray, np.ndarray]:
    """Gains with which the prior's torques fit the efforts, and whether those torques show."""
    model = _link_torques(rows, prior.mean)
    effort = np.concatenate([one.effort[one.part] for one in rows])
    rates = np.concatenate([one.velocity[one.part] for one in rows])
    for j in range(effort.shape[1]):  # what is left beside friction
        friction = np.column_stack([np.ones(len(rates)), rates[:, j], np.sign(rates[:, j])])
        both = np.column_stack([model[:, j], effort[:, j]])
        rest = both - friction @ np.linalg.lstsq(friction, both, rcond=1e-9)[0]
        model[:, j], effort[:, j] = rest.T
    product, power = np.sum(model * effort, axis=0), np.sum(effort**2, axis=0)
    strength = np.sqrt(np.sum(model**2, axis=0) / np.maximum(power, 1e-12))
    correlation = product / np.sqrt(np.maximum(power * np.sum(model**2, axis=0), 1e-24))
    seen = np.abs(correlation) > _SEEN
    if seen.any():  # other drives are the best guess
        strength = np.where(seen, strength, np.median(strength[seen]))
    return np.where(correlation < -_SEEN, -1.0, 1.0) * np.maximum(strength, 1e-6), seen


def rescaled(arm: SerialArm, factor: float) -> SerialArm:
    """Arm whose torques, masses and inertias are all larger by a factor."""
    factors = np.full((N_INERTIAL + 1 + len(TERMS), len(arm.joints)), factor)
    factors[N_INERTIAL + 1 + TERMS.index('load')] = 1.0  # has no unit
    slope = np.array([joint.friction.coulomb_slope for joint in arm.joints])
    scaled = with_parameters(arm, factors.ravel() * arm.parameter_vector(), slope)
    tolerances = [joint.torque_tolerance for joint in arm.joints]
    scaled = with_joint_values(
        scaled,
        torque_gain=[factor * joint.torque_gain for joint in arm.joints],
        rotor_coupling=[factor * joint.rotor_coupling for joint in arm.joints],
        torque_tolerance=[
            replace(t, torque=tuple(factor * u for u in t.torque)) for t in tolerances
        ],
    )
    covariance = arm.covariance
    if covariance is not None:
        rows = np.array(covariance.factor) * factors.ravel()
        covariance = replace(covariance, factor=tuple(map(tuple, rows.tolist())))
    errors: dict[str, Any] = {
        name: tuple(factor * value for value in getattr(arm.uncertainty, name))
        for name in ('torque_error', 'torque_error_speed')
        if getattr(arm.uncertainty, name) is not None
    }
    uncertainty = replace(arm.uncertainty, **errors)
    return replace(scaled, covariance=covariance, uncertainty=uncertainty)
