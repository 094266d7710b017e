"""From an arm and a requirement to gains that were checked."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache

import clarabel
import cvxpy
import numpy as np

from lpv.core.support.inequalities import Check
from lpv.core.uio.certificate.conditions import controller_loop, verify
from lpv.core.uio.certificate.gains import (
    ControllerGains,
    ExactObserverGains,
    Gains,
    PaperObserverGains,
)
from lpv.core.uio.certificate.noise import exact_fault_sigma, paper_fault_sigma
from lpv.core.uio.model.arm import ArmParameters
from lpv_design.controller import ControllerRequirement, check_loop, solve_loop
from lpv_design.exact_observer import ExactRequirement, solve_exact, torque_gains
from lpv_design.guarantee import Guarantee, guarantee
from lpv_design.motion import certify_motion
from lpv_design.paper_observer import check_paper, paper_problem, solve_paper, undetectable_point
from lpv_design.requirement import PaperRequirement, Requirement
from lpv_design.solve import SOLVER, InfeasibleError, check_lines

SAMPLED_POLE_LIMIT = 0.5
"""Largest abs(pole) Ts that a sampled loop with one sample of delay is asked to carry: half of that
at which an integrator in it oscillates."""
_POLE_SHARE = 0.9
"""Part of that which requirements are limited to."""
_SLOWER_LOOPS = ((_POLE_SHARE * SAMPLED_POLE_LIMIT, 1.0), (0.8, 2.0), (0.8, 4.0))
"""What is tried for the controller where the sample time limits it: fastest pole times sample time,
and the divisor of alpha.  The certificate's sampled loop with delay decides."""


class NotDetectableError(InfeasibleError):
    """A fault cannot be told from the state somewhere in the requested region."""


@dataclass
class DesignResult:
    """Gains and how they were checked."""

    gains: Gains  # ready to be written
    lines: list  # what the designer should read: margins, poles, bounds
    guarantee: Guarantee  # thresholds over the region


def design(arm: ArmParameters, requirement: Requirement) -> DesignResult:
    """Design observer and controller, and check both in NumPy.

    Raises
    ------
    NotDetectableError
        If the region holds a configuration where a fault cannot be diagnosed.
    InfeasibleError
        If the rebuilt inequalities do not hold.
    """
    options = within_sampling(arm, requirement)
    for number, (option, limited) in enumerate(options):
        notes = limited
        try:
            gains, checks, statuses = _design_once(arm, option)
            break
        except NotDetectableError:
            raise
        except InfeasibleError as error:
            if number + 1 == len(options):
                raise InfeasibleError('; '.join([str(error), *limited])) from None
    found = guarantee(arm, gains)
    gains.certificate.update(
        note='information: nothing is computed from what is below certificate',
        arm_json=arm.to_json(),
        margins={check.name: float(check.margin) for check in checks},
        guarantee=found.to_dict(),
        solver=SOLVER,
        observer_status=statuses[0],
        controller_status=statuses[1],
        **{f'{one.__name__}_version': one.__version__ for one in (clarabel, cvxpy, np)},
    )
    return DesignResult(
        gains, [*notes, *check_lines(checks), *_bound_lines(arm, gains, found)], found
    )


def _design_once(
    arm: ArmParameters, requirement: Requirement
) -> tuple[Gains, list[Check], tuple[str, str]]:
    """Gains for a requirement as it is, their checks, and the solver's words."""
    observer: ExactObserverGains | PaperObserverGains
    if isinstance(requirement.observer, ExactRequirement):
        observer, status = _exact_observer(arm, requirement.observer)
    else:
        observer, status = _paper_observer(arm, requirement.observer)
    controller, controller_status = _controller(arm, requirement.controller)
    gains = Gains(arm.name, arm.sha256(), observer, controller)
    checks = verify(arm, gains)
    for check in checks:
        if not check.holds:
            raise InfeasibleError(_reason(check, status, controller_status))
    return gains, checks, (status, controller_status)


def within_sampling(
    arm: ArmParameters, requirement: Requirement
) -> list[tuple[Requirement, list[str]]]:
    """Limit poles to what the sample time can carry.

    Returns requirements to be tried in turn, each with a line for each figure that was limited: one
    alone where the sample time carries what is asked for.  InfeasibleError if the slowest pole that
    is asked for is faster than that.
    """
    notes: list[str] = []
    limit = _POLE_SHARE * SAMPLED_POLE_LIMIT / arm.sample_time
    controller, observer = requirement.controller, requirement.observer
    if isinstance(observer, ExactRequirement) and observer.fastest > limit:
        _check_slowest('observer', 'decay', observer.decay, limit, arm)
        notes.append(_limited('observer', observer.fastest, limit, arm))
        requirement = replace(requirement, observer=replace(observer, fastest=limit))
    if controller.fastest <= limit:
        return [(requirement, notes)]
    _check_slowest('controller', 'alpha', controller.alpha, limit, arm)
    options = []
    for share, slower in _SLOWER_LOOPS:
        fastest, alpha = min(share / arm.sample_time, controller.fastest), controller.alpha / slower
        lines = [*notes, _limited('controller', controller.fastest, fastest, arm)]
        if slower > 1.0:
            lines.append(f'controller: alpha {alpha:g}/s instead of {controller.alpha:g}/s')
        limited = replace(controller, fastest=fastest, alpha=alpha)
        options.append((replace(requirement, controller=limited), lines))
    return options


def _check_slowest(part: str, name: str, slowest: float, limit: float, arm: ArmParameters) -> None:
    if slowest >= limit:
        raise InfeasibleError(
            f'{part}: {name} = {slowest:g}/s is faster than the sample time {arm.sample_time:g} s '
            f'can carry, {limit:.3g}/s'
        )


def _limited(part: str, asked: float, limit: float, arm: ArmParameters) -> str:
    return (
        f'{part}: poles up to {limit:.3g}/s instead of {asked:g}/s, '
        f'which the sample time {arm.sample_time:g} s cannot carry'
    )


def _reason(check: Check, observer_status: str, controller_status: str) -> str:
    """Why a rebuilt inequality fails, and what helps."""
    part = 'observer' if check.name.startswith('observer,') else 'controller'
    status = observer_status if part == 'observer' else controller_status
    text = f'{check.name}: {check.margin:.3g} is not negative'
    if 'sampled' in check.name:
        return f'{text}: ask for a smaller fastest pole, or sample faster'
    if 'arms at the corners' in check.name:
        return (
            f'{text}: the loop does not carry the stated model error and payload; '
            'ask for a smaller alpha, or state a smaller error'
        )
    if 'real poles' in check.name:
        return f'{text}: ask for a slower decay or a larger fastest pole'
    return (
        f'{text} although the solver says {status!r}: its accuracy does not suffice; ask for a '
        'slower decay or alpha, a smaller region or a larger fastest pole'
    )


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
            f'(solver: {", ".join(statuses)}); ask for a slower decay, a larger fastest pole or a '
            'smaller region'
        )
    return ExactObserverGains(
        kappa, mu, p, requirement.decay, requirement.fastest, exact_fault_sigma(arm, p)
    ), ', '.join(statuses)


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
    observer = PaperObserverGains(
        problem.box, problem.t1, problem.t2, k, p, requirement.lmi, requirement.gamma,
        requirement.q, requirement.r, np.zeros(2),
    )  # fmt: skip
    return replace(observer, fault_sigma=paper_fault_sigma(arm, observer)), status


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


@lru_cache(maxsize=4)
def _controller(arm: ArmParameters, wanted: ControllerRequirement) -> tuple[ControllerGains, str]:
    """Kept: a search for observers asks for the same controller again and again."""
    method, sinc_min = wanted.method, wanted.sinc_min
    loop = controller_loop(arm, method, sinc_min)
    m, q, status = solve_loop(arm, loop, wanted)
    margin = np.inf if m is None else check_loop(loop, m, q, wanted.alpha)
    if not margin < 0.0:
        away = max(float(np.linalg.eigvals(a).real.max()) for a in loop[0])
        raise InfeasibleError(
            f'controller: LMI (67) with alpha = {wanted.alpha:g}/s and poles up to '
            f'{wanted.fastest:g}/s has no solution (solver: {status}, largest eigenvalue '
            f'{margin:.3g}); without torques the arm leaves a pose by up to {away:.2g}/s: ask for '
            'a smaller alpha, a larger fastest pole or a smaller region'
        )
    p = np.linalg.inv(q)
    motion = certify_motion(arm, loop, m, wanted.alpha) if method == 'exact' else None
    return ControllerGains(
        method, m[:, :4], m[:, 4:], 0.5 * (p + p.T), wanted.alpha, sinc_min, motion
    ), status
