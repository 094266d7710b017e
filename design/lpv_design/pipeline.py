"""From an arm and a requirement to gains that were checked."""

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from lpv_core.gains import ControllerGains, Gains, ObserverGains
from lpv_core.polytope import sinc_box
from lpv_design.controller import check_loop, exact_loop, paper_loop, solve_loop
from lpv_design.detectability import undetectable_point
from lpv_design.exact_observer import ExactProblem, ExactRequirement
from lpv_design.paper_observer import check_paper, paper_problem, solve_paper
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
    """

    gains: Gains
    lines: list


def design(arm, requirement):
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
    if isinstance(requirement.observer, ExactRequirement):
        observer, certificate, lines = _exact_observer(arm, requirement.observer)
    else:
        observer, certificate, lines = _paper_observer(arm, requirement.observer)
    controller, margin, more = _controller(arm, requirement)
    certificate.update(controller_margin=margin, solver=SOLVER, **_versions())
    gains = Gains(arm.name, arm.sha256(), observer, controller, certificate)
    return DesignResult(gains, lines + more)


def _versions():
    found = {}
    for name in ('clarabel', 'cvxpy', 'numpy'):
        try:
            found[f'{name}_version'] = version(name)
        except PackageNotFoundError:
            found[f'{name}_version'] = 'unknown'
    return found


def _exact_observer(arm, requirement):
    problem = ExactProblem(arm, requirement)
    k_x, p, status = problem.solve()
    margin = np.inf if k_x is None else problem.check(k_x, p)
    if not margin < 0.0:
        raise InfeasibleError(
            f'observer: no gains with decay {requirement.decay}/s and poles up to '
            f'{requirement.fastest}/s down to abs(cos theta) = {min(arm.cos_min)} '
            f'(solver: {status}, largest eigenvalue {margin:.3g}); ask for a slower decay or a '
            'smaller region')
    k, p_full = problem.lift(k_x, p)
    lifted, radius = problem.check_lifted(k, p_full), problem.spectral_radius(k)
    if not (lifted < 0.0 and radius < 1.0):
        raise InfeasibleError(f'observer: full inequality {lifted:.3g} (must be negative), '
                              f'spectral radius {radius:.6f} (must be below 1)')
    sigma = problem.fault_sigma(p)
    gains = ObserverGains('exact', problem.t1, problem.t2, k, p_full, sinc_box(-0.2),
                          requirement.decay, sigma)
    certificate = {'observer_margin': lifted, 'observer_status': status,
                   'observer_spectral_radius': radius}
    lines = [
        f'observer exact: 16 vertices, largest eigenvalue {lifted:.3g} (negative: holds), '
        f'solver said {status}',
        f'  decay {requirement.decay:g}/s, poles up to {requirement.fastest:g}/s, '
        f'spectral radius at Ts {radius:.5f}',
        f'  standard deviation of fault estimates at most {sigma[0]:.4f}, {sigma[1]:.4f} rad']
    return gains, certificate, lines


def _paper_observer(arm, requirement):
    problem = paper_problem(arm, requirement.sinc_min, requirement.q, requirement.r)
    lost = undetectable_point(problem)
    if lost is not None:
        phi, eigenvalue, vector = lost
        shown = np.round(np.real(vector / vector[np.argmax(np.abs(vector))]), 6) + 0.0
        raise NotDetectableError(
            f'observer: at phi = {np.round(phi, 3).tolist()}, inside the box, the mode '
            f'{eigenvalue.real:+.2g} with vector {shown.tolist()} is not observable: without '
            'gravity torque a joint angle and a bias of its sensor cannot be told apart')
    k, p, _, status = solve_paper(problem, requirement.lmi, requirement.gamma)
    margin = np.inf if k is None else check_paper(problem, k, p, requirement.gamma,
                                                  requirement.lmi)
    if not margin < 0.0:
        raise InfeasibleError(
            f'observer: LMI ({requirement.lmi}) with gamma = {requirement.gamma:g} has no '
            f'solution for phi2, phi3 in [{requirement.sinc_min:g}, 1] (solver: {status}, '
            f'largest eigenvalue {margin:.3g})')
    sigma = _paper_sigma(arm, problem, k)
    gains = ObserverGains('paper', problem.t1, problem.t2, k, p, problem.box,
                          requirement.q - requirement.r, sigma)
    certificate = {'observer_margin': margin, 'observer_status': status,
                   'observer_gamma': requirement.gamma}
    lines = [f'observer paper: LMI ({requirement.lmi}), 8 vertices, phi2, phi3 in '
             f'[{requirement.sinc_min:g}, 1], gamma {requirement.gamma:g}, largest eigenvalue '
             f'{margin:.3g} (negative: holds), solver said {status}',
             f'  standard deviation of fault estimates {sigma[0]:.4f}, {sigma[1]:.4f} rad']
    return gains, certificate, lines


def _paper_sigma(arm, problem, k):
    """Largest standard deviation of f^ over the vertices for white noise and disturbance."""
    d, root = problem.descriptor, np.sqrt(arm.sample_time)
    noise = np.diag([arm.position_noise] * 2 + [arm.velocity_noise] * 2)
    sigma = np.zeros(2)
    for a_i, k_i in zip(d.a, k):
        n = problem.t1 @ a_i + k_i @ d.c
        push = np.hstack([problem.t1 @ d.bd * np.sqrt(arm.disturbance_variance),
                          (n @ problem.t2 - k_i) @ noise]) * root
        spread = solve_continuous_lyapunov(n, -push @ push.T)
        spread = spread + problem.t2 @ noise @ noise @ problem.t2.T
        sigma = np.maximum(sigma, np.sqrt(np.diag(spread)[4:]))
    return sigma


def _controller(arm, requirement):
    wanted = requirement.controller
    if requirement.controller_method == 'exact':
        loop = exact_loop(arm)
    else:
        loop = paper_loop(arm, requirement.controller_sinc_min)
    m, q, status = solve_loop(arm, loop, wanted)
    margin = np.inf if m is None else check_loop(loop, m, q, wanted.alpha)
    if not margin < 0.0:
        raise InfeasibleError(
            f'controller: LMI (67) with alpha = {wanted.alpha:g} and poles up to '
            f'{wanted.fastest:g}/s has no solution (solver: {status}, largest eigenvalue '
            f'{margin:.3g})')
    poles = np.concatenate([np.linalg.eigvals(a + b @ m) for a, b in zip(*loop)])
    fastest = float(np.abs(poles).max())
    if fastest * arm.sample_time > SAMPLED_POLE_LIMIT:
        raise InfeasibleError(f'controller: pole {fastest:.1f}/s times the sample time '
                              f'{arm.sample_time:g} s exceeds {SAMPLED_POLE_LIMIT}')
    gains = ControllerGains(requirement.controller_method, m[:, :4], m[:, 4:],
                            np.linalg.inv(q), wanted.alpha)
    lines = [f'controller {requirement.controller_method}: LMI (67), alpha {wanted.alpha:g}/s, '
             f'{len(loop[0])} vertices, largest eigenvalue {margin:.3g} (negative: holds), '
             f'solver said {status}',
             f'  fastest pole {fastest:.1f}/s = {fastest * arm.sample_time:.2f} of a sample']
    return gains, margin, lines
