"""The design's own inequalities in four SDP solvers: time, what each says, and what is true.

The problems are those that `lpv design` solves for the paper's arm (both links of method exact,
LMI (55) on the box phi2, phi3 >= 0.96, LMI (67) with guaranteed cost on 16 vertices); only the
solver's name is exchanged, every solver keeps its default settings.  Margins are the largest
eigenvalues of the inequalities rebuilt in NumPy from the returned numbers: negative means that they
hold, whatever the solver says.  ``certified`` are P > 0, (55), (67) and the observer's pole region,
which the certificate asks of gains; ``others`` are H2 and cost inequalities and the pole region of
the controller, on whose border an optimum lies.  Statuses and the worst margin are of all rounds,
ratios to Clarabel are of whole calls, in this very run.

Before that, 50 variants of the arm, masses and inertias drawn within +-10 % (seeded), are designed
with Clarabel, beside the first design of the process: gains of both links, controller, bounds, and
the check of every inequality in NumPy, which decides whether a variant counts as verified.  The
time is split into cvxpy's canonicalisation, the solver, and the rest.
"""

import os
import time
from contextlib import contextmanager
from dataclasses import dataclass
from unittest import mock

import cvxpy as cp
import numpy as np
from rich.console import Console

from lpv import load_arm
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.support.inequalities import largest_eigenvalue
from lpv.core.uio.certificate.conditions import controller_loop, decay_margin, observer_inequalities
from lpv.core.uio.certificate.error_system import link_errors
from lpv.core.uio.certificate.lmi import covariance, disc
from lpv.core.uio.planar import planar_model
from lpv.report.table import print_grid
from lpv_design.controller import solve_loop
from lpv_design.design_flow import design
from lpv_design.exact_observer import solve_link
from lpv_design.paper_observer import PaperRequirement, solve_paper
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

SOLVERS = ('CLARABEL', 'SCS', 'CVXOPT', 'SDPA')
ROUNDS = 5
BUDGET = 5.0
"""No further round of a problem once this much time has gone into it [s]."""
VARIANTS, SPREAD, SEED = 50, 0.1, 20240


@dataclass
class Outcome:
    """What one solver made of one problem."""

    status: str
    total: float = np.nan
    inside: float = np.nan
    certified: float = np.nan
    others: float = np.nan


@contextmanager
def recorded():
    """Collect (total, canonicalisation) [s] of every cvxpy problem solved within."""
    found, solve = [], cp.Problem.solve

    def timed(problem, *args, **kwargs):
        start = time.perf_counter()
        try:
            return solve(problem, *args, **kwargs)
        finally:
            found.append((time.perf_counter() - start, problem.compilation_time or 0.0))

    with mock.patch.object(cp.Problem, 'solve', timed):
        yield found


@contextmanager
def quiet():
    """Keep away what compiled solvers print past Python."""
    kept, sink = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(sink)


def exact_link(link, requirement):
    """Gains of one link: status, margin of the pole region, margin of the H2 inequality."""
    kappa, mu, p, status = solve_link(link, requirement)
    if kappa is None:
        return status, np.nan, np.nan
    q, r = (0.5 * (requirement.fastest + s * requirement.decay) for s in (1.0, -1.0))
    injection = -np.array([[kappa * link.inertia], [mu]])
    certified, others = [largest_eigenvalue(-p)], []
    for slope in link.slopes:
        pn = p @ link.closed(slope, kappa, mu)
        certified.append(largest_eigenvalue(disc(p, pn, q, r)))
        for noise in link.noises(requirement.acceleration_noise, requirement.rate_noise):
            pb = p @ (noise[:2] + injection @ noise[2:]) / link.unit
            others.append(largest_eigenvalue(covariance(pn, pb)))
    return status, max(certified), max(others)


def paper_55(arm, gamma):
    """LMI (55) on the shipped box, for a given gamma or (None) the least one."""
    wanted = PaperRequirement(gamma=gamma or 1.0)
    found, status = solve_paper(arm, wanted, minimise=gamma is None)
    if found is None:
        return status, np.nan, np.nan
    claims = dict(observer_inequalities(arm, found))
    del claims['observer: decoupling (41)']  # of T1 and T2, no matter of the solver
    return status, max(largest_eigenvalue(m) for some in claims.values() for m in some), np.nan


def controller_67(arm, requirement):
    """Controller: status, margin of LMI (67), margin of cost and poles; all balanced by P."""
    loop = controller_loop(arm, 'exact')
    m, p, status = solve_loop(arm, loop, requirement)
    if m is None:
        return status, np.nan, np.nan
    certified = max(largest_eigenvalue(-p), decay_margin(loop, m, p, requirement.alpha))
    if largest_eigenvalue(-p) >= 0.0:
        return status, certified, np.nan
    q = np.linalg.inv(p)
    factor = np.linalg.inv(np.linalg.cholesky(q))
    others, root = [], np.diag(np.sqrt(np.repeat(requirement.state_weight, 2)))
    x = np.sqrt(requirement.torque_weight) * m / arm.constants().gravity[:, None] @ q
    center, radius = (0.5 * (requirement.fastest + s * requirement.alpha) for s in (1.0, -1.0))
    for a, b in zip(*loop):
        closed = (a + b @ m) @ q
        cost = closed + closed.T + q @ root @ root @ q + x.T @ x
        balanced = factor @ closed @ factor.T
        others.append(largest_eigenvalue(factor @ cost @ factor.T))
        others.append(largest_eigenvalue(disc(np.eye(6), balanced, center, radius)))
    return status, certified, max(others)


def problems(arm):
    """Name and solving function of every problem."""
    wanted = load_requirement('paper')
    links = link_errors(arm)
    return {
        'observer, link 1': lambda: exact_link(links[0], wanted.observer),
        'observer, link 2': lambda: exact_link(links[1], wanted.observer),
        'LMI (55), gamma = 1': lambda: paper_55(arm, 1.0),
        'LMI (55), least gamma': lambda: paper_55(arm, None),
        'LMI (67)': lambda: controller_67(arm, wanted.controller),
    }


def run(problem, solver):
    """Median times over the rounds that fit the budget, every status, the worst margins."""
    answers = []
    with mock.patch('lpv_design.solve.SOLVER', solver), recorded() as times, quiet():
        for _ in range(ROUNDS):
            try:
                answers.append(problem())
            except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
                answers.append((type(error).__name__, np.nan, np.nan))
            if sum(total for total, _ in times) > BUDGET:
                break
    total, compiled = np.array(times).T
    status = ', '.join(dict.fromkeys(answer[0] for answer in answers))
    worst = np.fmax.reduce([answer[1:] for answer in answers])
    return Outcome(status, float(np.median(total)), float(np.median(total - compiled)), *worst)


def cells(outcome, unit):
    """Numbers of one row."""

    def margin(value):
        if np.isnan(value):
            return '-'
        return f'{value:.1e}' if value < 0.0 else f'{value:+.1e} !'

    if np.isnan(outcome.total):
        return ['-'] * 5
    return [
        f'{outcome.total:.3f}',
        f'{outcome.total / unit:.2f}',
        f'{outcome.inside:.3f}',
        margin(outcome.certified),
        margin(outcome.others),
    ]


def show(console, results):
    """One row for each problem and solver."""
    rows = []
    for name, outcomes in results.items():
        unit = outcomes[SOLVERS[0]].total
        for solver, outcome in outcomes.items():
            label = name if solver == SOLVERS[0] else ''
            rows.append((label, solver, outcome.status, *cells(outcome, unit)))
    heads = '>call, s', '>/ Clarabel', '>solver, s', '>certified', '>others'
    title = 'times: medians; margins: largest eigenvalue, negative = holds'
    print_grid(console, ('problem', 'solver', 'status', *heads), rows, title)


def variants(arm):
    """Arms with other masses and inertias."""
    rng = np.random.default_rng(SEED)
    return [arm.scaled(*rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, (2, 2))) for _ in range(VARIANTS)]


def timed_design(arm, requirement):
    """Whole time, canonicalisation, solver [s], and whether the gains verify."""
    with recorded() as solved:
        start = time.perf_counter()
        try:
            gains = design(arm, requirement).gains
        except InfeasibleError as error:
            print(f'not designed: {error}')
            gains = None
        total = time.perf_counter() - start
    calls, compiled = np.sum(solved, axis=0)
    verified = gains is not None and all(check.holds for check in gains.verify(arm))
    return total, compiled, calls - compiled, verified


def show_variants(arm, requirement):
    """Design them all, and print times and shares."""
    first = timed_design(two_link_arm(arm), requirement)[0]
    rows = np.array([timed_design(two_link_arm(other), requirement) for other in variants(arm)])
    total, compiled, solver, verified = rows.T
    print(
        f'first design of the process: {first:.2f} s; {VARIANTS} variants: median '
        f'{np.median(total):.2f} s, max {total.max():.2f} s, ratio to the first '
        f'{np.median(total) / first:.2f}'
    )
    print(f'verified: {int(verified.sum())} of {VARIANTS}')
    spent = total.sum()
    print(
        f'share of time: canonicalisation {compiled.sum() / spent:.0%}, solver '
        f'{solver.sum() / spent:.0%}, checks and bounds '
        f'{1.0 - (compiled + solver).sum() / spent:.0%}'
    )


def main():
    """Design the variants, and solve every problem with every solver that is installed."""
    arm = planar_model(load_arm('paper'))
    show_variants(arm, load_requirement('paper'))
    installed = cp.installed_solvers()
    results = {
        name: {
            solver: run(problem, solver) if solver in installed else Outcome('not installed')
            for solver in SOLVERS
        }
        for name, problem in problems(arm).items()
    }
    console = Console()
    show(console if console.is_terminal else Console(width=115), results)


if __name__ == '__main__':
    main()
