"""Matrix inequalities of the computed-torque loop, the same for every arm and number of joints.

With e = q_r - q, eps' = e, K = (w^3, 3 w^2, 3 w) and the model's M^, h^ the loop is

    e'' = -M^-1 (M^ K (eps, e, e') + F_v e' - delta),
    delta = M q_r'' + h(q, v) - M^ q_r'' - h^(q, v) + dry friction that is not compensated,

F_v the viscous friction.  Written in xi = (w^2 eps, w e, e'), time in units of 1/w, every block
multiplied by M^^(1/2), it is

    xi_3' = -Gamma (xi_1 + 3 xi_2 + 3 xi_3 + Phi xi_3 - omega),

with symmetric Gamma = M^^(1/2) M^-1 M^^(1/2) and Phi = M^^(-1/2) F_v M^^(-1/2) / w.  For the
Lyapunov function V = sum_ij P_ij xi_i^T xi_j, that is with P and M^(q) as weights, the eigenvalues
of Gamma, of Phi and of M^^(-1/2) M^' M^^(-1/2) are all that counts: each lies in an interval, and
sector multipliers leave matrices of five rows, for every arm.
"""

from typing import Any, NamedTuple

import numpy as np

_INTEGRATORS = np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]])
_GAIN = np.array([[1, 3, 3]])
"""K in units of the bandwidth."""


class LoopNumbers(NamedTuple):
    """Intervals that the loop's eigenvalues lie in, floats or fractions."""

    growth: Any  # of M^' relative to M^, over w
    damping: Any  # largest of Phi
    low: Any  # smallest of Gamma
    high: Any  # largest of Gamma
    step: Any  # sample time times w


def _rows(*first: int) -> list[np.ndarray]:
    """Selections of 1 row of a vector of 6."""
    return [np.eye(1, 6, k, dtype=int) for k in first]


def _sector(inside: np.ndarray, outside: np.ndarray, low: Any, high: Any) -> np.ndarray:
    """Form that is not negative where ``inside`` is a symmetric matrix in [low, high] times
    ``outside``."""
    product = (inside - low * outside).T @ (high * outside - inside)
    return product + product.T


def motion_matrix(
    p: Any, multipliers: Any, numbers: LoopNumbers, decay: Any, level: Any = None
) -> Any:
    """Must be negative definite: V' <= -2 decay V, while M^ changes.

    Parameters
    ----------
    p : matrix
        P, (3, 3).
    multipliers : sequence
        Of the sectors of Gamma and Phi, not negative.
    numbers : LoopNumbers
        Intervals.
    decay : number
        alpha over w.
    level : number, optional
        mu; with it V' <= -2 decay (V - mu abs(omega)^2), so that V ends below mu sup abs(omega)^2.

    Returns
    -------
    matrix
        Shape (5, 5), or (6, 6) with a level.
    """
    state, (damped, driven, missed) = np.eye(3, 6, dtype=int), _rows(3, 4, 5)
    inside = _GAIN @ state + damped - missed
    change = state.T @ p @ (_INTEGRATORS @ state - np.eye(3, dtype=int)[:, 2:] @ driven)
    total = change + change.T + (numbers.growth + 2 * decay) * (state.T @ p @ state)
    total = total + multipliers[0] * _sector(driven, inside, numbers.low, numbers.high)
    total = total + multipliers[1] * _sector(damped, state[2:], 0, numbers.damping)
    if level is None:
        return total[:5, :5]
    return total - 2 * decay * level * (missed.T @ missed)


def sampled_matrix(p: Any, multipliers: Any, numbers: LoopNumbers, decay: Any) -> Any:
    """Must be negative definite: V falls by 1 - 2 decay step a sample, with one sample of delay.

    The torque of sample k acts from k + 1 to k + 2, when M^ has changed by 2 samples of motion;
    over a sample the arm is taken as it is at its start.

    Parameters
    ----------
    p : matrix
        P of (xi_1, xi_2, xi_3, command), (4, 4).
    multipliers, numbers, decay
        As of `motion_matrix`.

    Returns
    -------
    matrix
        Shape (6, 6).
    """
    h = numbers.step
    later = 1 - 2 * h * numbers.growth  # at most exp(-2 h growth)
    state = np.eye(4, 6, dtype=int)
    integral, error, rate, command, damped, driven = _rows(0, 1, 2, 3, 4, 5)
    next_error = error + h * rate - h * h / 2 * driven
    following = np.vstack(
        [integral + h * next_error, next_error, rate - h * driven, _GAIN @ state[:3]]
    )
    # exp(h growth) <= 1 / (1 - h growth)
    total = following.T @ p @ following / (1 - h * numbers.growth)
    total = total - (1 - 2 * decay * h) * (state.T @ p @ state)
    total = total + multipliers[0] * _sector(
        driven, command + damped, numbers.low * later, numbers.high / later
    )
    return total + multipliers[1] * _sector(damped, rate, 0, numbers.damping)
