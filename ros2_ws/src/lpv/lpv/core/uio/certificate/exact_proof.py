"""The certificate's inequalities in exact rational arithmetic: rounding cannot hide a violation.

Every number of an arm file and of a gains file is a float and therefore a fraction; the
inequalities are polynomials in them, so that the sign of every pivot of a symmetric elimination is
decided without any rounding.
"""

from fractions import Fraction

import numpy as np

from lpv.core.support.inequalities import exact, is_negative, is_positive_definite
from lpv.core.uio.certificate.conditions import controller_loop, heun
from lpv.core.uio.certificate.error_system import LinkError, link_errors
from lpv.core.uio.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    PaperObserverGains,
)
from lpv.core.uio.certificate.lmi import disc, paper_inequalities
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import vertex_matrices
from lpv.core.uio.model.state_space import Descriptor


def prove(arm: ArmParameters, gains: Gains) -> dict[str, bool]:
    """What was proved or refuted of the quadratic inequalities of an arm's gains.

    The sampled controller's spectral radius is not a definiteness and stays a matter of floats.
    """
    observer = gains.observer
    proved = (
        _prove_exact(arm, observer)
        if isinstance(observer, ExactObserverGains)
        else _prove_paper(arm, observer)
    )
    return {**proved, **_prove_controller(arm, gains.controller)}


def _symmetrised(p: np.ndarray) -> np.ndarray:
    p = exact(p)
    return (p + p.T) / 2


def _prove_exact(arm: ArmParameters, observer: ExactObserverGains) -> dict[str, bool]:
    decay, fastest, dt = (Fraction(v) for v in (observer.decay, observer.fastest, arm.sample_time))
    q, r = (fastest + decay) / 2, (fastest - decay) / 2
    results = {}
    for link in link_errors(arm, Fraction):
        i = link.index
        kappa, mu = Fraction(observer.kappa[i]), Fraction(observer.mu[i])
        p, name = _symmetrised(observer.lyapunov[i]), f'observer, link {i + 1}'
        closed = [link.closed(slope, kappa, mu) for slope in link.slopes]
        results[f'{name}: P > 0'] = is_positive_definite(p)
        results[f'{name}: poles in the disc'] = all(
            is_negative(disc(p, p @ n, q, r)) for n in closed
        )
        results[f'{name}: sampled recursion contracts'] = all(
            is_negative(a.T @ p @ a - p) for a in (heun(n, dt) for n in closed)
        )
        results[f'{name}: real poles at every slope'] = 4 * kappa * link.slopes[1] < mu**2
        noises = [_noise(arm, link, row, kappa, mu) for row in link.rows]
        results[f'{name}: covariance under the noise of the arm file'] = all(
            is_negative(p @ n + (p @ n).T + p @ noise @ p) for n in closed for noise in noises
        )
    return results


def _noise(
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


def _prove_controller(arm: ArmParameters, controller: ControllerGains) -> dict[str, bool]:
    p, alpha = _symmetrised(controller.lyapunov), Fraction(controller.decay)
    m = exact(np.hstack([controller.m1, controller.m2]))
    loop = controller_loop(arm, controller.method, controller.sinc_min, Fraction)
    return {
        'controller: P > 0': is_positive_definite(p),
        f'controller: LMI (67), alpha {controller.decay:g}/s': all(
            is_negative(p @ (a + b @ m) + alpha * p) for a, b in zip(*loop)
        ),
    }


def _prove_paper(arm: ArmParameters, observer: PaperObserverGains) -> dict[str, bool]:
    d = Descriptor(*vertex_matrices(exact(observer.box), arm.numbers(Fraction)), arm)
    d.bd, d.bf, d.c = exact(d.bd), exact(d.bf), exact(d.c)
    p = _symmetrised(observer.lyapunov)
    level, q, r = (Fraction(v) for v in (observer.gamma, observer.q, observer.r))
    matrices = paper_inequalities(
        d, p, p @ exact(observer.t1), p @ exact(observer.k), level**2, q, r, observer.lmi
    )
    return {
        'observer: P > 0': is_positive_definite(p),
        f'observer: LMI ({observer.lmi}) at 8 vertices': all(map(is_negative, matrices)),
    }
