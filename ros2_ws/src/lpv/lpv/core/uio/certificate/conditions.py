"""The proof that gains carry: every inequality rebuilt from the gains and the arm alone.

No solver is needed, and none is trusted: what counts are the numbers in the gains file.  Nodes
refuse gains that do not verify.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.certified import Inequalities, judged
from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.entries import array, entry, part, positive
from lpv.core.support.inequalities import SAME, Check, NumberType, array_of, largest_eigenvalue
from lpv.core.uio.certificate.error_system import exact_fault_sigma, link_errors, paper_fault_sigma
from lpv.core.uio.certificate.lmi import disc, paper_inequalities
from lpv.core.uio.certificate.sampled_motion import MotionCertificate, sampled_loop
from lpv.core.uio.model.polytope import (
    exact_vertices,
    paper_descriptor,
    sinc_box,
    state_spaces,
    vertex_matrices,
)
from lpv.core.uio.observer.exact_observer import ExactObserverGains
from lpv.core.uio.observer.paper_observer import PaperObserverGains
from lpv.core.uio.observer.sampled_observer import ObserverGains

METHODS = ('paper', 'exact')
"""Of observers and controllers."""


@dataclass(frozen=True)
class ControllerGains:
    """State feedback with integral action, eq. (65), and its certificate, eqs. (67) and (68).

    Method ``paper`` is u = M1 x + M2 eps; ``exact`` adds reference feed-forward.
    """

    method: str = entry('text', choices=METHODS)
    m1: np.ndarray = array(2, 4)  # M1, absolute coordinates, row by row [N m/rad], [N m s/rad]
    m2: np.ndarray = array(2, 2)  # M2, absolute coordinates, row by row [N m/(rad s)]
    lyapunov: np.ndarray = array(6, 6)  # P = Q^-1 of the certificate, eq. (68), row by row
    decay: float = positive()  # certified alpha of eq. (67) [1/s]
    # lower end of the box of method paper [1]
    sinc_min: float = entry('number', default=-0.2, low=-0.3, high=0.99)
    # of the sampled loop in motion (method ``exact``), where there is one
    motion: MotionCertificate | None = part(MotionCertificate, default=None)

    @property
    def feedback(self) -> np.ndarray:
        """(M1, M2) of eq. (65), shape (2, 6)."""
        return np.hstack([self.m1, self.m2])


def _lyapunov(p: np.ndarray, number: NumberType) -> np.ndarray:
    """A Lyapunov matrix, in fractions symmetric to the last bit.

    One that is not symmetric, or not finite, proves nothing: it is as good as a negative one.
    """
    array, scale = array_of(number), np.abs(p).max(initial=0.0)
    if not np.abs(p - p.T).max() <= 1e-9 * scale:
        return array(-np.eye(len(p)))
    p = array(p)
    return p if number is float else (p + p.T) / 2


def observer_inequalities(
    arm: ArmParameters, observer: ObserverGains, number: NumberType = float
) -> Inequalities:
    """Names, and matrices of floats or fractions that must be negative definite.

    Method ``paper``: LMI (54) or (55) at the eight vertices, and constraint (41).  Method
    ``exact``, link by link: disc for the error's poles, a common quadratic function for the sampled
    Heun recursion, real poles, which the comparison system of the error bound needs, and P^-1 as a
    bound of the error's covariance under the noise that the arm file states.  These are affine in
    the slope, the recursion in those at both ends of a step, and the last one convex in Xi12: what
    holds at all ends holds for every slope in between, constant or changing.
    """
    if isinstance(observer, PaperObserverGains):
        array, d = array_of(number), paper_descriptor(arm, observer.box, number)
        p = _lyapunov(observer.lyapunov, number)
        level, q, r = (number(v) for v in (observer.gamma, observer.q, observer.r))
        t1, t2 = array(observer.t1), array(observer.t2)
        decoupled = np.abs(t1 @ d.e + t2 @ d.c - np.eye(6, dtype=int)).max()
        yield 'observer: P > 0 and symmetric', [-p]
        yield 'observer: decoupling (41)', [np.array([[decoupled - number(1e-9)]])]
        yield (
            f'observer: LMI ({observer.lmi}) at 8 vertices',
            paper_inequalities(d, p, p @ t1, p @ array(observer.k), level**2, q, r, observer.lmi),
        )
        return
    decay, fastest, dt = (number(v) for v in (observer.decay, observer.fastest, arm.sample_time))
    q, r = (fastest + decay) / 2, (fastest - decay) / 2
    for link in link_errors(arm, number):
        i, name = link.index, f'observer, link {link.index + 1}'
        kappa, mu = number(observer.kappa[i]), number(observer.mu[i])
        p = _lyapunov(observer.lyapunov[i], number)
        closed = [link.closed(slope, kappa, mu) for slope in link.slopes]
        sampled = [heun(*ends, dt) for ends in product(closed, closed)]
        yield f'{name}: P > 0 and symmetric', [-p]
        poles = f'{name}: poles between {observer.decay:g} and {observer.fastest:g}/s'
        yield poles, [disc(p, p @ n, q, r) for n in closed]
        yield f'{name}: sampled recursion contracts', [a.T @ p @ a - p for a in sampled]
        damping = 4 * kappa * link.slopes[1] / mu**2
        yield f'{name}: real poles at every slope', [np.array([[damping - 1]])]
        yield (
            f'{name}: covariance under the noise of the arm file',
            # P^-1 bounds it: sym(P N) + P B B^T P < 0.
            [2 * p @ n + p @ b @ p for n in closed for b in link.input_covariances(kappa, mu)],
        )


def observer_margin(arm: ArmParameters, observer: ObserverGains) -> float:
    """Largest eigenvalue of all `observer_inequalities`; negative if they hold."""
    claims = observer_inequalities(arm, observer)
    return largest_eigenvalue(*(matrix for _, matrices in claims for matrix in matrices))


def observer_checks(arm: ArmParameters, observer: ObserverGains) -> Iterator[Check]:
    """Checks of the observer: its inequalities, and the deviation of its estimates."""
    yield from judged(observer_inequalities(arm, observer))
    if isinstance(observer, ExactObserverGains):
        sigma = exact_fault_sigma(arm, observer.lyapunov)
    else:
        sigma = paper_fault_sigma(arm, observer)
    away = float(np.abs(observer.fault_sigma / sigma - 1.0).max())
    yield Check('observer: standard deviation of f^ as recomputed', away - SAME)


def heun(begin: np.ndarray, end: np.ndarray, dt: Any) -> np.ndarray:
    """Matrix of one Heun step of x' = N x, with N at both ends of it."""
    return np.eye(len(end), dtype=int) + dt / 2 * (begin + end) + dt**2 / 2 * (end @ begin)


def controller_loop(
    arm: ArmParameters, method: str, sinc_min: float = -0.2, number: NumberType = float
) -> tuple[np.ndarray, ...]:
    """Augmented vertices A_c, B_c of eq. (64) with eps' = w - theta, in floats or in exact
    fractions."""
    numbers = arm.numbers(number)
    if method == 'paper':
        a, b = vertex_matrices(array_of(number)(sinc_box(sinc_min)), numbers)
    else:
        a, b = state_spaces(exact_vertices(arm, number), numbers)
    a_c, b_c = (np.zeros((len(a), 6, columns), a.dtype) for columns in (6, 2))
    a_c[:, :4, :4], a_c[:, 4:, :2], b_c[:, :4] = a, -np.eye(2, dtype=int), b
    return a_c, b_c


def controller_inequalities(
    arm: ArmParameters, controller: ControllerGains, number: NumberType = float
) -> Inequalities:
    """Names, and matrices of floats or fractions that must be negative definite: LMI (67)."""
    p, m = _lyapunov(controller.lyapunov, number), array_of(number)(controller.feedback)
    loop = controller_loop(arm, controller.method, controller.sinc_min, number)
    yield 'controller: P > 0 and symmetric', [-p]
    name = f'controller: LMI (67), alpha {controller.decay:g}/s, {len(loop[0])} vertices'
    yield name, _decays(loop, m, p, number(controller.decay))


def _decays(loop: tuple[np.ndarray, ...], m: np.ndarray, p: np.ndarray, alpha: Any) -> list[Any]:
    """LMI (67) at the vertices of a loop, with P = Q^-1."""
    matrices = [p @ n + n.T @ p + 2 * alpha * p for n in (a + b @ m for a, b in zip(*loop))]
    if p.dtype == object or not largest_eigenvalue(-p) < 0.0:
        return matrices
    # P spans many decades; a congruence with its own factor makes margins comparable.
    factor = np.linalg.inv(np.linalg.cholesky(p))
    return [factor @ matrix @ factor.T for matrix in matrices]


def decay_margin(loop: tuple[np.ndarray, ...], m: np.ndarray, p: np.ndarray, alpha: float) -> float:
    """Largest eigenvalue of LMI (67) at the vertices of a loop, for gains M and P = Q^-1 > 0."""
    return largest_eigenvalue(*_decays(loop, m, p, alpha))


def _sampled_radius(arm: ArmParameters, loop: tuple[np.ndarray, ...], m: np.ndarray) -> float:
    """Largest spectral radius of the sampled loop with one sample of delay, of all vertices."""
    return max(delayed_radius(*discretised(a, b, arm.sample_time), m) for a, b in zip(*loop))


def controller_checks(arm: ArmParameters, controller: ControllerGains) -> Iterator[Check]:
    """Checks of the tracking loop: LMI (67), and poles that the sample time can carry."""
    m, p = controller.feedback, _lyapunov(controller.lyapunov, float)
    loop = controller_loop(arm, controller.method, controller.sinc_min)
    yield from judged(controller_inequalities(arm, controller))
    radius = _sampled_radius(arm, loop, m)
    yield Check('controller: sampled loop with one sample of delay', radius - 1.0)
    if (motion := controller.motion) is not None:
        sampled = sampled_loop(arm, loop, m, motion.rate)
        contraction = sampled.contraction(_lyapunov(motion.lyapunov, float))
        yield Check(
            f'controller: sampled loop with one sample of delay, in motion up to '
            f'{motion.rate:g} rad/s, {motion.decay:g}/s',
            contraction - np.exp(-motion.decay * arm.sample_time),
        )
    # The same P and half the decay for arms with other masses, inertias and payloads.  Between the
    # corners, which are checked, Xi^-1 is not affine: this is evidence and no proof.
    if controller.method == 'exact' and (arm.model_error or arm.payload):
        alpha = 0.5 * controller.decay
        loops = [controller_loop(other, 'exact') for other in corner_arms(arm)]
        text = f'controller: {len(loops)} arms at the corners of model error and payload'
        decays = (matrix for loop in loops for matrix in _decays(loop, m, p, alpha))
        yield Check(f'{text}, alpha {alpha:g}/s', largest_eigenvalue(*decays))
        radius = max(_sampled_radius(arm, loop, m) for loop in loops)
        yield Check(f'{text}, sampled with delay', radius - 1.0)


def corner_arms(arm: ArmParameters) -> list[ArmParameters]:
    """Arms at the corners of the stated model error and payload."""
    ends = (1.0 - arm.model_error, 1.0 + arm.model_error)
    arms = []
    for factors in product(ends, repeat=4):
        for payload in sorted({0.0, arm.payload}):
            other = arm.scaled(factors[:2], factors[2:]).with_payload(payload)
            if other.is_physical():
                arms.append(other)
    return arms


def discretised(a: np.ndarray, b: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold over a sample [s]: exp([[A, B], [0, 0]] dt)."""
    from scipy.linalg import expm  # here: most nodes check no certificate

    n, k = b.shape
    block = np.zeros((n + k, n + k))
    block[:n] = dt * np.hstack([a, b])
    held = expm(block)
    return held[:n, :n], held[:n, n:]


def delayed_radius(a: np.ndarray, b: np.ndarray, m: np.ndarray, delay: int = 1) -> float:
    """Spectral radius of a `discretised` loop whose torque M x acts some samples late."""
    n, k = b.shape
    loop = np.zeros((n + k * delay, n + k * delay))
    loop[:n, :n], loop[:n, -k:] = a, b
    loop[n : n + k, :n] = m
    loop[n + k :, n:-k] = np.eye(k * (delay - 1))
    return float(np.abs(np.linalg.eigvals(loop)).max())
