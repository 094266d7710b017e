"""From an arm and a requirement to gains that were checked."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import clarabel
import cvxpy
import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.inequalities import Check
from lpv.core.uio.certificate.conditions import ControllerGains
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.joints import J_INVERSE, JointMap
from lpv.core.uio.observer.sampled_observer import ObserverGains
from lpv.core.uio.planar import planar_model
from lpv_design.controller import design_controller
from lpv_design.exact_observer import ExactRequirement, design_exact, torque_gains
from lpv_design.guarantee import Guarantee, guarantee
from lpv_design.paper_observer import design_paper
from lpv_design.requirement import Requirement
from lpv_design.solve import SOLVER, InfeasibleError, NotDetectableError, check_lines

_POLE_LIMIT = 0.45
"""Largest abs(pole) Ts that requirements are limited to: nine tenths of half of that at which an
integrator oscillates in a sampled loop with one sample of delay."""
_NOISY = 0.5
"""Standard deviation of torques by noise, in units of their limits, from which tracking suffers:
one value in twenty reaches the limit."""
_SLOWER_LOOPS = ((_POLE_LIMIT, 1.0), (0.8, 2.0), (0.8, 4.0))
"""What is tried for the controller where the sample time limits it: fastest pole times sample time,
and the divisor of alpha.  The certificate's sampled loop with delay decides."""
_HINTS = {
    'arms at the corners': 'the loop does not carry the stated model error and payload; '
    'state less of both, or ask for a smaller alpha',
    'sampled': 'ask for a smaller fastest pole, or sample faster',
    'real poles': 'ask for a slower decay or a larger fastest pole',
}
"""What helps where an inequality of such a name fails."""


@dataclass
class DesignResult:
    """Gains and how they were checked."""

    gains: Gains  # ready to be written
    lines: list  # what the designer should read: margins, poles, bounds
    guarantee: Guarantee  # thresholds over the region


def design(arm: SerialArm, requirement: Requirement) -> DesignResult:
    """Design observer and controller, and check both in NumPy.

    Raises
    ------
    NotDetectableError
        If the region holds a configuration where a fault cannot be diagnosed.
    InfeasibleError
        If the rebuilt inequalities do not hold.
    ConfigError
        If the arm is not planar, or states no region.
    """
    planar = planar_model(arm)
    _check_gravity(planar)
    for option, notes in within_sampling(planar, requirement):
        try:
            gains, checks = _design_once(arm, option)
            break
        except NotDetectableError:
            raise
        except InfeasibleError as error:
            reason = '; '.join([str(error), *notes])
    else:
        raise InfeasibleError(reason)
    found = guarantee(planar, gains)
    gains.certificate.update(
        note='information: nothing is computed from what is below certificate',
        arm_json=planar.to_json(),
        margins={check.name: float(check.margin) for check in checks},
        guarantee={
            'deviation': found.deviation.tolist(),
            **{f'threshold_{i + 1}': found.threshold[:, :, i].ravel().tolist() for i in range(2)},
        },
        solver=SOLVER,
        **{f'{one.__name__}_version': one.__version__ for one in (clarabel, cvxpy, np)},
    )
    return DesignResult(
        gains, [*notes, *check_lines(checks), *_bound_lines(planar, gains, found)], found
    )


def _check_gravity(arm: ArmParameters) -> None:
    """NotDetectableError for a joint whose load has no weight in front of it."""
    for name, torque in zip(arm.joint_names, arm.numbers().gravity):
        if not torque > 0.0:
            raise NotDetectableError(
                f'lpv: the centre of mass of what {name!r} carries is not in front of the joint '
                f'(gravity torque {torque:.3g} N m), by which alone designed gains tell an angle '
                'from an error; leave lpv out: diagnosis and computed torque do without it'
            )


def _design_once(arm: SerialArm, requirement: Requirement) -> tuple[Gains, list[Check]]:
    """Gains for a requirement as it is, with the solver's words, and their checks."""
    planar = planar_model(arm)
    observer: ObserverGains
    if isinstance(requirement.observer, ExactRequirement):
        observer, status = design_exact(planar, requirement.observer)
    else:
        observer, status = design_paper(planar, requirement.observer)
    controller, controller_status = design_controller(planar, requirement.controller)
    words = {'observer_status': status, 'controller_status': controller_status}
    gains = Gains(arm.name, planar.sha256(), observer, controller, words)
    checks = gains.verify(arm)
    for check in checks:
        if not check.holds:
            raise InfeasibleError(_reason(check, status, controller_status))
    return gains, checks


def within_sampling(
    arm: ArmParameters, requirement: Requirement
) -> list[tuple[Requirement, list[str]]]:
    """Limit poles to what the sample time can carry.

    Returns requirements to be tried in turn, each with a line for each figure that was limited: one
    alone where the sample time carries what is asked for.  InfeasibleError if the slowest pole that
    is asked for is faster than that.
    """
    notes: list[str] = []
    limit = _POLE_LIMIT / arm.sample_time
    controller, observer = requirement.controller, requirement.observer
    if isinstance(observer, ExactRequirement) and observer.fastest > limit:
        notes.append(_limited('observer', 'decay', observer.decay, observer.fastest, limit, arm))
        requirement = replace(requirement, observer=replace(observer, fastest=limit))
    if controller.fastest <= limit:
        return [(requirement, notes)]
    options, asked = [], controller.fastest
    for share, slower in _SLOWER_LOOPS:
        fastest, alpha = min(share / arm.sample_time, asked), controller.alpha / slower
        lines = list(notes)
        if fastest < asked:
            lines.append(_limited('controller', 'alpha', alpha, asked, fastest, arm))
        if slower > 1.0:
            lines.append(f'controller: alpha {alpha:g}/s instead of {controller.alpha:g}/s')
        limited = replace(controller, fastest=fastest, alpha=alpha)
        options.append((replace(requirement, controller=limited), lines))
    return options


def _limited(
    part: str, name: str, slowest: float, asked: float, limit: float, arm: ArmParameters
) -> str:
    """What is said of a limited pole; InfeasibleError if the slowest one is faster."""
    if slowest >= limit:
        raise InfeasibleError(
            f'{part}: {name} = {slowest:g}/s is faster than the sample time {arm.sample_time:g} s '
            f'can carry, {limit:.3g}/s'
        )
    return (
        f'{part}: poles up to {limit:.3g}/s instead of {asked:g}/s, '
        f'which the sample time {arm.sample_time:g} s cannot carry'
    )


def _reason(check: Check, observer_status: str, controller_status: str) -> str:
    """Why a rebuilt inequality fails, and what helps."""
    status = observer_status if check.name.startswith('observer') else controller_status
    text = f'{check.name}: {check.margin:.3g} is not negative'
    for name, hint in _HINTS.items():
        if name in check.name:
            return f'{text}: {hint}'
    return (
        f'{text} although the solver says {status!r}: its accuracy does not suffice; ask for a '
        'slower decay or alpha, a smaller region or a larger fastest pole'
    )


def noise_of_torques(arm: ArmParameters, controller: ControllerGains) -> np.ndarray:
    """Standard deviation of the joint torques that noise of the readings makes, in units of their
    limits, shape (2,)."""
    position, rate = arm.position_noise, arm.velocity_noise
    if arm.rates != 'independent':  # differences of the positions
        rate = max(rate, math.sqrt(2.0) * position / arm.sample_time)
    angles = np.kron(np.eye(2), np.linalg.inv(JointMap(arm).sensor_matrix))
    torques = J_INVERSE.T @ controller.m1 @ angles * np.repeat([position, rate], 2)
    return np.linalg.norm(torques, axis=1) / arm.torque_limit


def _bound_lines(arm: ArmParameters, gains: Gains, found: Guarantee) -> list[str]:
    sigma = gains.observer.fault_sigma
    middle = len(found.deviation) // 2
    finite = np.isfinite(found.bound).all(axis=2).mean()

    def pair(values: Iterable[float]) -> str:
        return ', '.join(f'{v:.3f}' for v in values) + ' rad'

    shares = noise_of_torques(arm, gains.controller)
    told = ' and '.join(f'{share:.2g}' for share in shares)
    slower = (
        ': ask for a smaller fastest pole, or for rates with less noise'
        if max(shares) > _NOISY
        else ''
    )
    return [
        f'torques move by {told} of their limits (standard deviation) with the noise of the '
        f'readings{slower}',
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
