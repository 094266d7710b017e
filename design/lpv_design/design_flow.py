"""From an arm and a requirement to gains that were checked."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from lpv_core.certificate.conditions import Check, controller_loop, verify
from lpv_core.certificate.error_system import link_errors
from lpv_core.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    PaperObserverGains,
)
from lpv_core.model.arm import ArmParameters, arm_from_json
from lpv_core.model.joints import JointMap
from lpv_design.controller import ControllerRequirement, check_loop, solve_loop
from lpv_design.detectability import undetectable_point
from lpv_design.exact_observer import ExactRequirement, solve_exact, torque_gains
from lpv_design.guarantee import Guarantee, guarantee
from lpv_design.paper_observer import PaperProblem, check_paper, paper_problem, solve_paper
from lpv_design.requirement import PaperRequirement, Requirement
from lpv_design.solve import SOLVER, InfeasibleError

SAMPLED_POLE_LIMIT = 0.5
"""Largest |pole| * Ts that a sampled loop with one sample of delay is asked to carry."""


class NotDetectableError(InfeasibleError):
    """A fault cannot be told from the state somewhere in the requested region."""


@dataclass
class DesignResult:
    """Gains and how they were checked.

    Attributes
    ----------
    gains : Gains
        Ready to be written.
    lines : list of str
        What the designer should read: margins, poles, bounds.
    guarantee : Guarantee
        Thresholds over the region.
    """

    gains: Gains
    lines: list
    guarantee: Guarantee


def design(arm: ArmParameters, requirement: Requirement) -> DesignResult:
    """Design observer and controller, and check both in NumPy.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    requirement : Requirement
        What to fulfil.

    Returns
    -------
    DesignResult
        Gains and report.

    Raises
    ------
    NotDetectableError
        If the region holds a configuration where a fault cannot be diagnosed.
    InfeasibleError
        If the rebuilt inequalities do not hold.
    """
    observer: ExactObserverGains | PaperObserverGains
    if isinstance(requirement.observer, ExactRequirement):
        observer, status = _exact_observer(arm, requirement.observer)
    else:
        observer, status = _paper_observer(arm, requirement.observer)
    controller, controller_status = _controller(arm, requirement)
    gains = Gains(arm.name, arm.sha256(), observer, controller)
    checks = verify(arm, gains)
    failed = [check for check in checks if not check.holds]
    if failed:
        raise InfeasibleError(
            f'{failed[0].name}: {failed[0].margin:.3g} is not negative '
            f'(solver: {status} and {controller_status}); ask for a slower '
            'decay or alpha, a smaller region or a larger fastest pole'
        )
    found = guarantee(arm, gains)
    gains.certificate.update(
        arm_json=arm.to_json(),
        margins={check.name: float(check.margin) for check in checks},
        guarantee=found.to_dict(),
        solver=SOLVER,
        observer_status=status,
        controller_status=controller_status,
        **_versions(),
    )
    return DesignResult(gains, [*_check_lines(checks), *_bound_lines(arm, gains, found)], found)


def _check_lines(checks: list[Check]) -> list[str]:
    return [f'holds ({check.margin:.3g} < 0): {check.name}' for check in checks]


def _bound_lines(arm: ArmParameters, gains: Gains, found: Guarantee) -> list[str]:
    sigma = gains.observer.fault_sigma
    middle = len(found.deviation) // 2
    finite = np.isfinite(found.bound).all(axis=2).mean()

    def pair(values: Iterable[float]) -> str:
        return ', '.join(f'{v:.3f}' for v in values) + ' rad'

    return [
        f'{" and ".join(arm.sensor_names)}:',
        f'  standard deviation of the fault estimates: at most {pair(sigma)}',
        '  at rest, both links vertical: alarm threshold '
        f'{pair(found.threshold[middle, middle])}, lasting faults are detected from '
        f'{pair(found.detectable[middle, middle])}',
        f'  an unknown torque of 1 N m shifts the estimated angles by at most '
        f'{pair(torque_gains(arm))} (H-infinity norm)',
        f'  at rest, lasting faults of both sensors are detected in {finite:.0%} of the region, '
        'elsewhere only changes: gravity tells too little there',
    ]


def _versions() -> dict[str, str]:
    found = {}
    for name in ('clarabel', 'cvxpy', 'numpy'):
        try:
            found[f'{name}_version'] = version(name)
        except PackageNotFoundError:
            found[f'{name}_version'] = 'unknown'
    return found


def _exact_observer(
    arm: ArmParameters, requirement: ExactRequirement
) -> tuple[ExactObserverGains, str]:
    gain = max(torque_gains(arm))
    if gain > requirement.torque_gain:
        raise InfeasibleError(
            f'observer: the H-infinity norm from an unknown torque to an angle error is {gain:.3g} '
            f'rad/(N m), 1/(G cos_min), not {requirement.torque_gain:g}; no observer changes '
            'that: ask for a smaller region'
        )
    kappa, mu, p, statuses = solve_exact(arm, requirement)
    if kappa is None:
        raise InfeasibleError(
            f'observer: no gains with decay {requirement.decay}/s and poles up to '
            f'{requirement.fastest}/s down to abs(cos theta) = {min(arm.cos_min)} '
            f'(solver: {", ".join(statuses)}); ask for a slower decay or a smaller region'
        )
    return ExactObserverGains(
        kappa, mu, p, requirement.decay, requirement.fastest, _exact_sigma(arm, p)
    ), ', '.join(statuses)


def _exact_sigma(arm: ArmParameters, p: np.ndarray) -> np.ndarray:
    """P^-1 bounds the covariance of each link's error; sensors add those of their links."""
    angle = np.array(
        [link.unit * np.sqrt(np.linalg.inv(p_i)[0, 0]) for link, p_i in zip(link_errors(arm), p)]
    )
    spread = np.abs(JointMap(arm).sensor_matrix) @ angle
    return np.hypot(spread, arm.position_noise)


def _paper_observer(
    arm: ArmParameters, requirement: PaperRequirement
) -> tuple[PaperObserverGains, str]:
    problem = paper_problem(arm, requirement.sinc_min, requirement.q, requirement.r)
    lost = undetectable_point(problem)
    if lost is not None:
        phi, eigenvalue, vector = lost
        shown = np.round(np.real(vector / vector[np.argmax(np.abs(vector))]), 6) + 0.0
        raise NotDetectableError(
            f'observer: at phi = {np.round(phi, 3).tolist()}, inside the box, the mode '
            f'{eigenvalue.real:+.2g} with vector {shown.tolist()} is not observable: without '
            'gravity torque a joint angle and a bias of its sensor cannot be told apart. '
            + _largest_box(arm, requirement)
        )
    k, p, _, status = solve_paper(problem, requirement.lmi, requirement.gamma)
    margin = np.inf if k is None else check_paper(problem, k, p, requirement.gamma, requirement.lmi)
    if not margin < 0.0:
        raise InfeasibleError(
            f'observer: LMI ({requirement.lmi}) with gamma = {requirement.gamma:g} has no '
            f'solution for phi2, phi3 in [{requirement.sinc_min:g}, 1] (solver: {status}, '
            f'largest eigenvalue {margin:.3g})'
        )
    return PaperObserverGains(
        problem.t1,
        problem.t2,
        k,
        p,
        problem.box,
        requirement.lmi,
        requirement.gamma,
        requirement.q,
        requirement.r,
        _paper_sigma(arm, problem, k),
    ), status


def _largest_box(arm: ArmParameters, requirement: PaperRequirement) -> str:
    """By bisection: on which box the same figures are feasible."""
    low, high = 0.5, 0.9999
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        problem = paper_problem(arm, middle, requirement.q, requirement.r)
        k, p, _, _ = solve_paper(problem, requirement.lmi, requirement.gamma)
        if k is not None and check_paper(problem, k, p, requirement.gamma, requirement.lmi) < 0.0:
            high = middle
        else:
            low = middle
    if high > 0.9998:
        return 'No box down to phi = 0.9999 is feasible with these figures'
    return (
        f'The largest box on which gamma = {requirement.gamma:g}, q = {requirement.q:g}, '
        f'r = {requirement.r:g} are feasible is phi2, phi3 in [{high:.3f}, 1]'
    )


def _paper_sigma(arm: ArmParameters, problem: PaperProblem, k: np.ndarray) -> np.ndarray:
    """Largest standard deviation of f^ over the vertices for white noise and disturbance."""
    d, root = problem.descriptor, np.sqrt(arm.sample_time)
    noise = np.diag([arm.position_noise] * 2 + [arm.velocity_noise] * 2)
    sigma = np.zeros(2)
    for a_i, k_i in zip(d.a, k):
        n = problem.t1 @ a_i + k_i @ d.c
        push = (
            np.hstack(
                [
                    problem.t1 @ d.bd * np.sqrt(arm.disturbance_variance),
                    (n @ problem.t2 - k_i) @ noise,
                ]
            )
            * root
        )
        spread = solve_continuous_lyapunov(n, -push @ push.T)
        spread = spread + problem.t2 @ noise @ noise @ problem.t2.T
        sigma = np.maximum(sigma, np.sqrt(np.diag(spread)[4:]))
    return sigma


def _controller(arm: ArmParameters, requirement: Requirement) -> tuple[ControllerGains, str]:
    return _tracking(
        arm.to_json(),
        requirement.controller,
        requirement.controller_method,
        requirement.controller_sinc_min,
    )


@lru_cache(maxsize=4)
def _tracking(
    arm_json: str, wanted: ControllerRequirement, method: str, sinc_min: float
) -> tuple[ControllerGains, str]:
    """Kept: a search for observers asks for the same controller again and again."""
    arm = arm_from_json(arm_json)
    loop = controller_loop(arm, method, sinc_min)
    m, q, status = solve_loop(arm, loop, wanted)
    margin = np.inf if m is None else check_loop(loop, m, q, wanted.alpha)
    if not margin < 0.0:
        raise InfeasibleError(
            f'controller: LMI (67) with alpha = {wanted.alpha:g} and poles up to '
            f'{wanted.fastest:g}/s has no solution (solver: {status}, largest eigenvalue '
            f'{margin:.3g})'
        )
    poles = np.concatenate([np.linalg.eigvals(a + b @ m) for a, b in zip(*loop)])
    fastest = float(np.abs(poles).max())
    if fastest * arm.sample_time > SAMPLED_POLE_LIMIT:
        raise InfeasibleError(
            f'controller: pole {fastest:.1f}/s times the sample time '
            f'{arm.sample_time:g} s exceeds {SAMPLED_POLE_LIMIT}'
        )
    p = np.linalg.inv(q)
    return ControllerGains(
        method, m[:, :4], m[:, 4:], 0.5 * (p + p.T), wanted.alpha, sinc_min
    ), status
