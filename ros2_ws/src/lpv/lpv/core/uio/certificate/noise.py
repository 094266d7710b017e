"""Noise of the fault estimates, recomputed from gains and arm."""

import math
from fractions import Fraction

import numpy as np

from lpv.core.support.inequalities import exact, is_negative, largest_eigenvalue
from lpv.core.uio.certificate.error_system import LinkError, link_errors
from lpv.core.uio.certificate.gains import ExactObserverGains, PaperObserverGains
from lpv.core.uio.certificate.lmi import covariance
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.state_space import paper_descriptor


def stated_acceleration_noise(arm: ArmParameters) -> np.ndarray:
    """Independent white accelerations whose covariance bounds that of the arm file's disturbance,
    per axis [rad/s2/sqrt(Hz)]."""
    # One d drives both axes: (a d_1 + b d_2)^2 <= 2 (a^2 d_1^2 + b^2 d_2^2).
    axes = np.count_nonzero(arm.disturbance_direction)
    intensity = math.sqrt(axes * arm.disturbance_variance * arm.sample_time)
    return intensity * np.abs(np.asarray(arm.disturbance_direction, float))


def exact_fault_sigma(arm: ArmParameters, lyapunov: np.ndarray) -> np.ndarray:
    """Bound on the standard deviation of f^ of method ``exact``, per sensor [rad].

    P^-1 bounds the covariance of each link's error; sensors add those of their links.
    """
    with np.errstate(invalid='ignore'):  # of a P that is not positive: NaN fails every check
        angle = np.array(
            [
                link.unit * np.sqrt(np.linalg.inv(p)[0, 0])
                for link, p in zip(link_errors(arm), lyapunov)
            ]
        )
    spread = np.abs(JointMap(arm).sensor_matrix) @ angle
    return np.hypot(spread, arm.position_noise)


def covariance_margin(arm: ArmParameters, observer: ExactObserverGains, index: int) -> float:
    """Largest eigenvalue of the H2 inequality of one link for the noise that the arm file states.

    It is affine in the slope and convex in Xi12, so that their ends prove it in between.
    """
    link, p = link_errors(arm)[index], observer.lyapunov[index]
    kappa, mu = observer.kappa[index], observer.mu[index]
    injection = -np.array([[kappa * link.inertia], [mu]])
    worst = -math.inf
    for slope in link.slopes:
        pn = p @ link.closed(slope, kappa, mu)
        for noise in link.noises(stated_acceleration_noise(arm).tolist(), 0.0):
            pb = p @ (noise.direct + injection @ noise.measured) / link.unit
            worst = max(worst, largest_eigenvalue(covariance(pn, pb)))
    return worst


def prove_covariance(
    arm: ArmParameters, observer: ExactObserverGains, index: int, p: np.ndarray
) -> bool:
    """Whether that inequality holds in exact arithmetic, with P in fractions."""
    link = link_errors(arm, Fraction)[index]
    kappa, mu = Fraction(observer.kappa[index]), Fraction(observer.mu[index])
    inputs = [_exact_noise(arm, link, row, kappa, mu) for row in link.rows]
    closed = [link.closed(slope, kappa, mu) for slope in link.slopes]
    return all(is_negative(2 * p @ n + p @ noise @ p) for n in closed for noise in inputs)


def _exact_noise(
    arm: ArmParameters, link: LinkError, row: np.ndarray, kappa: Fraction, mu: Fraction
) -> np.ndarray:
    """B B^T of the H2 inequality, in `LinkError.unit`: products of white inputs have no root."""
    period = Fraction(arm.sample_time)
    rates = exact(np.linalg.inv(JointMap(arm).sensor_matrix))  # of whole numbers
    total = np.full((2, 2), Fraction(0), dtype=object)
    axes = np.count_nonzero(arm.disturbance_direction)  # as of `stated_acceleration_noise`
    for j in range(2):
        seen = (row @ rates[:, j]) / link.inertia
        b = np.array([rates[link.index, j] + kappa * link.inertia * seen, mu * seen])
        total += Fraction(arm.velocity_noise) ** 2 * period * np.outer(b, b)
        push = row[j] * Fraction(arm.disturbance_direction[j]) / link.inertia
        total[1, 1] += int(axes) * push**2 * Fraction(arm.disturbance_variance) * period
    return total / Fraction(LinkError.unit) ** 2


def paper_fault_sigma(arm: ArmParameters, observer: PaperObserverGains) -> np.ndarray:
    """Largest standard deviation of f^ of method ``paper`` over the vertices, per sensor [rad]."""
    d = paper_descriptor(arm, observer.box)
    root = math.sqrt(arm.sample_time)
    noise = np.diag([arm.position_noise] * 2 + [arm.velocity_noise] * 2)
    t1, t2, sigma = observer.t1, observer.t2, np.zeros(2)
    for a_i, k_i in zip(d.a, observer.k):
        n = t1 @ a_i + k_i @ d.c
        disturbance = t1 @ d.bd * math.sqrt(arm.disturbance_variance)
        inputs = root * np.hstack([disturbance, (n @ t2 - k_i) @ noise])
        spread = _stationary_covariance(n, inputs) + t2 @ noise @ noise @ t2.T
        sigma = np.maximum(sigma, np.sqrt(np.diag(spread)[4:]))
    return sigma


def _stationary_covariance(n: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """X of N X + X N^T + B B^T = 0."""
    size, eye = len(n), np.eye(len(n))
    operator = np.kron(n, eye) + np.kron(eye, n)
    return np.linalg.solve(operator, -(inputs @ inputs.T).ravel()).reshape(size, size)
