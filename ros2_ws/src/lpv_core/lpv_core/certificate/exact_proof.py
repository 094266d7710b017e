"""The certificate's inequalities in exact rational arithmetic: rounding cannot hide a violation.

Every number of an arm file and of a gains file is a float and therefore a fraction; the
inequalities are polynomials in them, so that the sign of every pivot of a symmetric elimination is
decided without any rounding.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from lpv_core.certificate.error_system import LinkError
from lpv_core.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    PaperObserverGains,
)
from lpv_core.certificate.lmi import bounded_real, bounded_real_disc, disc
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap

_Point = tuple[Fraction, Fraction]
_Pairs = Sequence[Sequence[Fraction]] | np.ndarray


def exact(values: ArrayLike) -> np.ndarray:
    """Array of fractions that equal the given floats."""
    return np.vectorize(Fraction, otypes=[object])(np.asarray(values))


def is_positive_definite(matrix: np.ndarray) -> bool:
    """Sylvester's criterion by symmetric elimination over the fractions."""
    rest = exact(matrix)
    if not np.array_equal(rest, rest.T):
        return False
    for k in range(len(rest)):
        pivot = rest[k, k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(rest)):
            if rest[i, k] != 0:
                rest[i, k:] = rest[i, k:] - rest[k, k:] * (rest[i, k] / pivot)
    return True


def is_negative(matrix: np.ndarray) -> bool:
    """Whether sym(matrix) < 0."""
    matrix = exact(matrix)
    return is_positive_definite(-(matrix + matrix.T))


def _symmetrised(p: np.ndarray) -> np.ndarray:
    p = exact(p)
    return (p + p.T) / 2


def _constants(arm: ArmParameters) -> tuple[Fraction, ...]:
    """Xi11, b, Xi22, rotor coupling, G1, G2 as fractions; cf. ArmParameters.constants."""
    one, two = arm.links
    f = Fraction
    inertia_1, inertia_2 = f(one.inertia), f(two.inertia)
    if arm.inertia_reference == 'center_of_mass':
        inertia_1 += f(one.mass) * f(one.center_of_mass) ** 2
        inertia_2 += f(two.mass) * f(two.center_of_mass) ** 2
    ratio, rotor, g = f(arm.gear_ratio), f(arm.rotor_inertia), f(arm.gravity)
    return (
        inertia_1 + f(two.mass) * f(one.length) ** 2 + rotor * (2 * ratio**2 + 2 * ratio + 1),
        f(two.mass) * f(one.length) * f(two.center_of_mass),
        inertia_2 + rotor * ratio**2,
        -rotor * ratio * (ratio + 1),
        (f(one.mass) * f(one.center_of_mass) + f(two.mass) * f(one.length)) * g,
        f(two.mass) * f(two.center_of_mass) * g,
    )


def prove(arm: ArmParameters, gains: Gains) -> dict[str, bool]:
    """Prove the quadratic inequalities of a gains file.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : Gains
        Its gains.

    Returns
    -------
    dict of str to bool
        What was proved or refuted.  The sampled controller's spectral radius is not a definiteness
        and stays a matter of floats.
    """
    observer = gains.observer
    proved = (
        _prove_exact(arm, observer)
        if isinstance(observer, ExactObserverGains)
        else _prove_paper(arm, observer)
    )
    return {**proved, **_prove_controller(arm, gains.controller)}


def _prove_exact(arm: ArmParameters, observer: ExactObserverGains) -> dict[str, bool]:
    xi_11, b, xi_22, o, g_1, g_2 = _constants(arm)
    decay, fastest, dt = (Fraction(v) for v in (observer.decay, observer.fastest, arm.sample_time))
    q, r = (fastest + decay) / 2, (fastest - decay) / 2
    results = {}
    for i, (inertia, gravity) in enumerate(((xi_11, g_1), (xi_22, g_2))):
        kappa, mu = Fraction(observer.kappa[i]), Fraction(observer.mu[i])
        p, name = _symmetrised(observer.lyapunov[i]), f'observer, link {i + 1}'
        slopes = (gravity * Fraction(arm.cos_min[i]), gravity)
        closed = [
            np.array([[Fraction(0), -kappa * inertia], [slope / inertia, -mu]]) for slope in slopes
        ]
        sampled = [np.eye(2, dtype=int) + dt * n + dt**2 / 2 * n.dot(n) for n in closed]
        results[f'{name}: P > 0'] = is_positive_definite(p)
        results[f'{name}: poles in the disc'] = all(
            is_negative(disc(p, p.dot(n), q, r)) for n in closed
        )
        results[f'{name}: sampled recursion contracts'] = all(
            is_negative(a.T.dot(p).dot(a) - p) for a in sampled
        )
        results[f'{name}: real poles at every slope'] = 4 * kappa * slopes[1] < mu**2
        noises = [_noise(arm, i, (inertia, off), kappa, mu) for off in (o - b, o + b)]
        results[f'{name}: covariance under the noise of the arm file'] = all(
            is_positive_definite(-(p.dot(n) + p.dot(n).T + p.dot(noise).dot(p)))
            for n in closed
            for noise in noises
        )
    return results


def _noise(
    arm: ArmParameters, link: int, row: tuple[Fraction, Fraction], kappa: Fraction, mu: Fraction
) -> np.ndarray:
    """B B^T of the H2 inequality, in `LinkError.unit`: products of white inputs have no root.

    ``row`` is (Xi_ii, Xi12).  The inequality is affine in the slope and convex in Xi12, so that
    their ends prove it in between; cf. `lpv_core.certificate.noise.covariance_margin`.
    """
    inertia, off = row
    momentum = [inertia, off] if link == 0 else [off, inertia]
    sign, period = (1 if arm.sign > 0 else -1), Fraction(arm.sample_time)
    rates = exact(np.linalg.inv(JointMap(arm).sensor_matrix))  # of whole numbers
    total = np.full((2, 2), Fraction(0), dtype=object)
    for j in range(2):
        seen = sign * (momentum[0] * rates[0, j] + momentum[1] * rates[1, j]) / inertia
        b = np.array([rates[link, j] + kappa * inertia * seen, mu * seen])
        total += Fraction(arm.velocity_noise) ** 2 * period * np.outer(b, b)
        push = momentum[j] * Fraction(arm.disturbance_direction[j]) / inertia
        total[1, 1] += push**2 * Fraction(arm.disturbance_variance) * period
    return total / Fraction(LinkError.unit) ** 2


def _corners(constants: Sequence[Fraction]) -> tuple[_Point, ...]:
    """Quadrangle of (1/det Xi, Xi12/det Xi); cf. lpv_core.model.polytope."""
    xi_11, b, xi_22, o = constants[:4]
    low, high = o - b, o + b
    middle = (low + high) / 2

    def point(state: Fraction) -> _Point:
        det = xi_11 * xi_22 - state * state
        return 1 / det, state / det

    def tangent(state: Fraction) -> _Point:
        det = xi_11 * xi_22 - state * state
        return 2 * state / det**2, (det + 2 * state * state) / det**2

    def intersection(state: Fraction, r: Fraction) -> _Point:
        (p_x, p_y), (q_x, q_y), (a_x, a_y), (b_x, b_y) = (
            point(state),
            point(r),
            tangent(state),
            tangent(r),
        )
        step = ((q_x - p_x) * b_y - (q_y - p_y) * b_x) / (a_x * b_y - a_y * b_x)
        return p_x + step * a_x, p_y + step * a_y

    return point(low), intersection(low, middle), intersection(middle, high), point(high)


def _state_space(
    inverse: _Pairs, gravity: Sequence[Fraction], slopes: Sequence[Fraction]
) -> tuple[np.ndarray, np.ndarray]:
    """A (4, 4) and B (4, 2) for Xi^-1 and gravity torques G_i*slope_i."""
    a = np.full((4, 4), Fraction(0), dtype=object)
    a[0, 2] = a[1, 3] = Fraction(1)
    b = np.full((4, 2), Fraction(0), dtype=object)
    for i in range(2):
        for j in range(2):
            a[2 + i, j] = inverse[i][j] * gravity[j] * slopes[j]
            b[2 + i, j] = inverse[i][j]
    return a, b


def _exact_vertices(
    arm: ArmParameters, constants: Sequence[Fraction]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    xi_11, _, xi_22, _, g_1, g_2 = constants
    sign = 1 if arm.orientation == 'upright' else -1
    for x, y in _corners(constants):
        inverse = ((xi_22 * x, -y), (-y, xi_11 * x))
        for s_1 in (Fraction(arm.cos_min[0]), Fraction(1)):
            for s_2 in (Fraction(arm.cos_min[1]), Fraction(1)):
                yield _state_space(inverse, (g_1, g_2), (sign * s_1, sign * s_2))


def _paper_vertices(
    constants: Sequence[Fraction], box: _Pairs
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    xi_11, b, xi_22, o, g_1, g_2 = constants
    for phi_1 in box[0]:
        off = o + b * phi_1
        det = xi_11 * xi_22 - off * off
        inverse = ((xi_22 / det, -off / det), (-off / det, xi_11 / det))
        for phi_2 in box[1]:
            for phi_3 in box[2]:
                yield _state_space(inverse, (g_1, g_2), (phi_2, phi_3))


def _prove_controller(arm: ArmParameters, controller: ControllerGains) -> dict[str, bool]:
    constants = _constants(arm)
    if controller.method == 'paper':
        ends = [(Fraction(-1), Fraction(1)), *[(Fraction(controller.sinc_min), Fraction(1))] * 2]
        vertices = _paper_vertices(constants, ends)
    else:
        vertices = _exact_vertices(arm, constants)
    p = _symmetrised(controller.lyapunov)
    m, alpha = exact(np.hstack([controller.m1, controller.m2])), Fraction(controller.decay)
    holds = True
    for a, b in vertices:
        loop = np.full((6, 6), Fraction(0), dtype=object)
        loop[:4, :4] = a
        loop[4, 0] = loop[5, 1] = Fraction(-1)
        loop[:4] += b.dot(m)
        holds = holds and is_negative(p.dot(loop) + alpha * p)
    return {
        'controller: P > 0': is_positive_definite(p),
        f'controller: LMI (67), alpha {controller.decay:g}/s': holds,
    }


def _prove_paper(arm: ArmParameters, observer: PaperObserverGains) -> dict[str, bool]:
    from lpv_core.model.state_space import disturbance_matrix, output_matrices

    constants = _constants(arm)
    p, t1 = _symmetrised(observer.lyapunov), exact(observer.t1)
    c = exact(np.hstack(output_matrices(arm)))
    bd = t1.dot(exact(np.vstack([disturbance_matrix(arm), np.zeros((2, 1))])))
    bf = t1.dot(exact(np.vstack([np.zeros((4, 2)), np.eye(2)])))
    level, q, r = (Fraction(v) for v in (observer.gamma, observer.q, observer.r))
    holds = True
    for (a, _), k in zip(_paper_vertices(constants, exact(observer.box)), observer.k):
        augmented = np.full((6, 6), Fraction(0), dtype=object)
        augmented[:4, :4] = a
        augmented[4, 4] = augmented[5, 5] = Fraction(-1)
        pn = p.dot(t1.dot(augmented) + exact(k).dot(c))
        if observer.lmi == '55':
            matrices = [bounded_real_disc(p, pn, p.dot(bd), p.dot(bf), level**2, q, r)]
        else:
            matrices = [bounded_real(p, pn, p.dot(bd), p.dot(bf), level**2), disc(p, pn, q, r)]
        holds = holds and all(is_negative(m) for m in matrices)
    return {
        'observer: P > 0': is_positive_definite(p),
        f'observer: LMI ({observer.lmi}) at 8 vertices': holds,
    }
