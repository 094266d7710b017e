"""The proof that gains carry: every inequality rebuilt from the gains and the arm alone.

No solver is needed, and none is trusted: what counts are the numbers in the gains file.  Nodes
refuse gains that do not verify.
"""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
from scipy.linalg import expm

from lpv.core.support.inequalities import SAME, Check, largest_eigenvalue, require_all
from lpv.core.uio.certificate.error_system import link_errors
from lpv.core.uio.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    PaperObserverGains,
    gains_checksum,
)
from lpv.core.uio.certificate.lmi import disc, paper_inequalities
from lpv.core.uio.certificate.noise import covariance_margin, exact_fault_sigma, paper_fault_sigma
from lpv.core.uio.certificate.sampled_motion import sampled_loop
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.polytope import exact_vertices, sinc_box, state_spaces, vertex_matrices
from lpv.core.uio.model.state_space import Descriptor


def verify(arm: ArmParameters, gains: Gains) -> list[Check]:
    """Rebuild every inequality that gains claim to satisfy; ConfigError for another arm's gains."""
    return list(_checks(arm, gains))


def _checks(arm: ArmParameters, gains: Gains) -> Iterator[Check]:
    """All checks, those first that cost least."""
    gains.check_arm(arm)
    observer = gains.observer
    if gains.checksum:
        same = gains.checksum == gains_checksum(gains)
        yield Check('gains file: numbers are those of the design', -1.0 if same else 1.0)
    if isinstance(observer, ExactObserverGains):
        yield from exact_observer_checks(arm, observer)
    else:
        yield from paper_observer_checks(arm, observer)
    yield from _noise_checks(arm, observer)
    yield from controller_checks(arm, gains.controller)
    yield from _together(arm, gains)


def require(arm: ArmParameters, gains: Gains, source: str = 'gains') -> None:
    """Refuse gains whose certificate does not hold: ConfigError names the inequality that fails."""
    require_all(_checks(arm, gains), 'gains', 'design the gains again', source)


def _noise_checks(
    arm: ArmParameters, observer: ExactObserverGains | PaperObserverGains
) -> list[Check]:
    """The standard deviation that thresholds rest on, recomputed."""
    checks = []
    if isinstance(observer, ExactObserverGains):
        checks = [
            Check(
                f'observer, link {i + 1}: covariance under the noise of the arm file',
                covariance_margin(arm, observer, i),
            )
            for i in range(2)
        ]
        sigma = exact_fault_sigma(arm, observer.lyapunov)
    else:
        sigma = paper_fault_sigma(arm, observer)
    away = float(np.abs(observer.fault_sigma / sigma - 1.0).max())
    return [*checks, Check('observer: standard deviation of f^ as recomputed', away - SAME)]


def _symmetric(matrix: np.ndarray) -> bool:
    """A Lyapunov matrix that is not symmetric proves nothing; NaN fails every check."""
    scale = np.abs(matrix).max(initial=0.0)
    return np.abs(matrix - matrix.T).max() <= 1e-9 * scale


def _lyapunov_check(name: str, p: np.ndarray) -> Check:
    return Check(
        f'{name}: P > 0 and symmetric', largest_eigenvalue(-p) if _symmetric(p) else np.nan
    )


def exact_observer_checks(arm: ArmParameters, observer: ExactObserverGains) -> list[Check]:
    """Checks of method ``exact``, link by link.

    The inequalities are affine in the slope, so that its two ends prove them for every slope in
    between, constant or changing: disc for the error's poles, a common quadratic function for the
    sampled Heun recursion (whose matrix is affine in the slope, too), and real poles, which the
    comparison system of the error bound needs.
    """
    q, r = (0.5 * (observer.fastest + sign * observer.decay) for sign in (1.0, -1.0))
    checks = []
    for link in link_errors(arm):
        kappa, mu = observer.kappa[link.index], observer.mu[link.index]
        p, name = observer.lyapunov[link.index], f'observer, link {link.index + 1}'
        closed = [link.closed(slope, kappa, mu) for slope in link.slopes]
        sampled = [heun(n, arm.sample_time) for n in closed]
        checks += [
            _lyapunov_check(name, p),
            Check(
                f'{name}: poles between {observer.decay:g} and {observer.fastest:g}/s',
                max(largest_eigenvalue(disc(p, p @ n, q, r)) for n in closed),
            ),
            Check(
                f'{name}: sampled recursion contracts',
                max(largest_eigenvalue(a.T @ p @ a - p) for a in sampled),
            ),
            Check(f'{name}: real poles at every slope', 4.0 * kappa * link.slopes[1] / mu**2 - 1.0),
        ]
    return checks


def heun(n: np.ndarray, dt: Any) -> np.ndarray:
    """Matrix of one Heun step of x' = N x."""
    return np.eye(len(n), dtype=int) + dt * n + dt**2 / 2 * (n @ n)


def paper_observer_checks(arm: ArmParameters, observer: PaperObserverGains) -> list[Check]:
    """Checks of method ``paper``: LMI (54) or (55) at the eight vertices, and constraint (41)."""
    d = Descriptor(*vertex_matrices(observer.box, arm.numbers()), arm)
    p, t1 = observer.lyapunov, observer.t1
    decoupled = np.abs(t1 @ d.e + observer.t2 @ d.c - np.eye(6)).max()
    matrices = paper_inequalities(
        d, p, p @ t1, p @ observer.k, observer.gamma**2, observer.q, observer.r, observer.lmi
    )
    return [
        _lyapunov_check('observer', p),
        Check('observer: decoupling (41)', float(decoupled) - 1e-9),
        Check(
            f'observer: LMI ({observer.lmi}) at 8 vertices', max(map(largest_eigenvalue, matrices))
        ),
    ]


def controller_loop(
    arm: ArmParameters, method: str, sinc_min: float = -0.2, number: Callable[[Any], Any] = float
) -> tuple[np.ndarray, ...]:
    """Augmented vertices A_c, B_c of eq. (64), in floats or in exact fractions."""
    if method == 'paper':
        box = [[number(value) for value in row] for row in sinc_box(sinc_min)]
        return augment(*vertex_matrices(np.array(box), arm.numbers(number)))
    return augment(*state_spaces(exact_vertices(arm, number), arm.numbers(number)))


def augment(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, ...]:
    """Augmented vertices of eq. (64) with eps' = w - theta."""
    h = len(a)
    a_c, b_c = np.zeros((h, 6, 6), a.dtype), np.zeros((h, 6, 2), b.dtype)
    a_c[:, :4, :4] = a
    a_c[:, 4:, :2] = -np.eye(2, dtype=int)
    b_c[:, :4] = b
    return a_c, b_c


def controller_checks(arm: ArmParameters, controller: ControllerGains) -> list[Check]:
    """Checks of the tracking loop: LMI (67), and poles that the sample time can carry."""
    loop = controller_loop(arm, controller.method, controller.sinc_min)
    m, p = np.hstack([controller.m1, controller.m2]), controller.lyapunov
    closed = [a + b @ m for a, b in zip(*loop)]
    # P spans many decades; a congruence with its own factor makes margins comparable.
    positive = _lyapunov_check('controller', p)
    factor = np.linalg.inv(np.linalg.cholesky(p)) if positive.holds else np.eye(6)
    worst = max(
        largest_eigenvalue(factor @ (p @ n + n.T @ p + 2.0 * controller.decay * p) @ factor.T)
        for n in closed
    )
    radius = max(delayed_radius(*discretised(a, b, arm.sample_time), m) for a, b in zip(*loop))
    return [
        positive,
        Check(f'controller: LMI (67), alpha {controller.decay:g}/s, {len(closed)} vertices', worst),
        Check('controller: sampled loop with one sample of delay', radius - 1.0),
        *motion_checks(arm, controller),
        *_robustness(arm, controller, m, p, factor),
    ]


def motion_checks(arm: ArmParameters, controller: ControllerGains) -> list[Check]:
    """The sampled loop in motion: one P for every motion up to the stated link rate."""
    motion = controller.motion
    if motion is None:
        return []
    loop = controller_loop(arm, controller.method, controller.sinc_min)
    m = np.hstack([controller.m1, controller.m2])
    contraction = np.nan
    if _symmetric(motion.lyapunov):
        contraction = sampled_loop(arm, loop, m, motion.rate).contraction(motion.lyapunov)
    return [
        Check(
            f'controller: sampled loop with one sample of delay, in motion up to '
            f'{motion.rate:g} rad/s, {motion.decay:g}/s',
            contraction - np.exp(-motion.decay * arm.sample_time),
        )
    ]


def _robustness(
    arm: ArmParameters,
    controller: ControllerGains,
    m: np.ndarray,
    p: np.ndarray,
    factor: np.ndarray,
) -> list[Check]:
    """The same P and half the decay for arms with other masses, inertias and payloads."""
    # Between the corners, which are checked, Xi^-1 is not affine: this is evidence and no proof.
    if controller.method != 'exact' or not (arm.model_error or arm.payload):
        return []
    alpha, worst, radius = 0.5 * controller.decay, -np.inf, 0.0
    arms = corner_arms(arm)
    for other in arms:
        for a, b in zip(*controller_loop(other, 'exact')):
            n = a + b @ m
            worst = max(
                worst, largest_eigenvalue(factor @ (p @ n + n.T @ p + 2.0 * alpha * p) @ factor.T)
            )
            radius = max(radius, delayed_radius(*discretised(a, b, arm.sample_time), m))
    text = f'{len(arms)} arms at the corners of model error and payload'
    return [
        Check(f'controller: {text}, alpha {alpha:g}/s', worst),
        Check(f'controller: {text}, sampled with delay', radius - 1.0),
    ]


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


def _together(arm: ArmParameters, gains: Gains) -> list[Check]:
    """Sampled loop of arm, controller and observer, closed on estimates and on measurements."""
    observer = gains.observer
    if not isinstance(observer, ExactObserverGains) or gains.controller.method != 'exact':
        return []
    m = np.hstack([gains.controller.m1, gains.controller.m2])
    links, checks = link_errors(arm), []
    for compensated, name in ((1.0, 'with'), (0.0, 'without')):
        radius = 0.0
        for (a, b), vertex in zip(zip(*controller_loop(arm, 'exact')), exact_vertices(arm)):
            slopes = np.abs(vertex[2:])
            error = np.zeros((4, 4))
            for link, slope in zip(links, slopes):
                i = link.index
                error[np.ix_([i, 2 + i], [i, 2 + i])] = link.closed(
                    link.gravity * slope, observer.kappa[i], observer.mu[i]
                )
            # Rates are fed back as estimated: e' = Xi^-1 diag(Xi_ii) r, and B holds Xi^-1.
            rates = b[2:4] @ np.diag([link.inertia for link in links]) * arm.sign
            seen = np.block(
                [
                    [compensated * np.eye(2), np.zeros((2, 2))],
                    [np.zeros((2, 2)), rates],
                    [np.zeros((2, 4))],
                ]
            )
            whole = np.block([[a, np.zeros((6, 4))], [np.zeros((4, 6)), error]])
            whole[4:6, 6:8] = -compensated * np.eye(2)
            inputs = np.vstack([b, np.zeros((4, 2))])
            sampled, feedback = (
                discretised(whole, inputs, arm.sample_time),
                np.hstack([m, m @ seen]),
            )
            radius = max(radius, delayed_radius(*sampled, feedback))
        checks.append(
            Check(
                f'observer and controller together, {name} compensation, sampled with delay',
                radius - 1.0,
            )
        )
    return checks


def discretised(a: np.ndarray, b: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold over a sample [s]: exp([[A, B], [0, 0]] dt)."""
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
