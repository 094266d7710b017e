"""One way to call the SDP solver."""

import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.support.inequalities import Check

SOLVER = 'CLARABEL'
RESERVE = 0.02
"""Relative tightening of pole regions in the solver, against what is checked."""


class InfeasibleError(RuntimeError):
    """No gains satisfy the inequalities, as rebuilt in NumPy."""


class NotDetectableError(InfeasibleError):
    """A fault cannot be told from the state somewhere in the requested region."""


def check_lines(checks: list[Check]) -> list[str]:
    """What the designer reads of checks that hold."""
    return [f'holds ({check.margin:.3g} < 0): {check.name}' for check in checks]


def solve(objective: Any, constraints: list[Any]) -> str:
    """Minimise with Clarabel and say what it said."""
    return run(cp.Problem(cp.Minimize(objective), constraints))


def run(problem: Any) -> str:
    """Solve a problem, for the first time or with other values of its parameters.

    Clarabel often says ``optimal_inaccurate`` on points that satisfy every inequality, and a first
    order solver may say ``optimal`` on points that violate them.  Callers rebuild the
    inequalities; the returned word is for the record.
    """
    for variable in problem.variables():
        variable.value = None  # a failed solution must not leave that of the time before
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # "may be inaccurate": decided by the rebuilt matrices
        try:
            problem.solve(solver=SOLVER)
        except cp.error.SolverError:
            return 'solver_error'
    return problem.status


def symmetric_below(matrix: Any, margin: Any = 0.0) -> Any:
    """Constraint M <= -margin I for an expression that is symmetric by construction."""
    return 0.5 * (matrix + matrix.T) << -margin * np.eye(matrix.shape[0])


def bisect(works: Callable[[float], bool], top: float, accuracy: float) -> float:
    """Largest number up to ``top`` that works, by bisection; 0 if none does."""
    if works(top):
        return top
    low, high = 0.0, top
    while high - low > accuracy * top:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if works(middle) else (low, middle)
    return low
