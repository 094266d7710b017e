"""The matrix inequalities, written once for the solver and for the check of what it returns.

Every function takes ``block``: ``cvxpy.bmat`` builds the constraint, ``numpy.block`` rebuilds the
same inequality from numbers.  P is a Lyapunov matrix; products with it (``pn`` = P N, ``pb`` = P B)
are one argument, because the solver's unknown is the product.  A design is accepted on the
eigenvalues of the rebuilt matrix alone; the solver's word is recorded but never trusted.
"""

from collections.abc import Callable
from typing import Any

import numpy as np


def _eye(n: int) -> np.ndarray:
    """Identity of integers, which no kind of number is rounded by."""
    return np.eye(n, dtype=int)


def _zeros(shape: tuple[int, int]) -> np.ndarray:
    return np.zeros(shape, dtype=int)


def symmetric_part(matrix: np.ndarray) -> np.ndarray:
    """(M + M^T)/2: what an inequality on a numerically unsymmetric matrix is about."""
    return 0.5 * (matrix + matrix.T)


def largest_eigenvalue(matrix: np.ndarray) -> float:
    """Largest eigenvalue of a symmetric matrix; negative if M < 0 holds, NaN if M is not finite."""
    if not np.isfinite(matrix).all():
        return np.nan
    return float(np.linalg.eigvalsh(symmetric_part(np.asarray(matrix)))[-1])


def bounded_real(
    p: Any, pn: Any, pbd: Any, pbf: Any, gamma_squared: Any, block: Callable[..., Any] = np.block
) -> Any:
    """LMI (54): stability and attenuation of d and f in the estimation error."""
    eye = _eye(6)
    z = _zeros
    return block(
        [
            [pn + pn.T, pbd, pbf, eye],
            [pbd.T, -gamma_squared * _eye(1), z((1, 2)), z((1, 6))],
            [pbf.T, z((2, 1)), -gamma_squared * _eye(2), z((2, 6))],
            [eye, z((6, 1)), z((6, 2)), -eye],
        ]
    )


def bounded_real_disc(
    p: Any,
    pn: Any,
    pbd: Any,
    pbf: Any,
    gamma_squared: Any,
    q: Any,
    r: Any,
    block: Callable[..., Any] = np.block,
) -> Any:
    """LMI (55): as (54) with the poles in the disc of centre -q and radius r, in one matrix."""
    eye = _eye(6)
    z = _zeros
    sigma = q * p + pn
    return block(
        [
            [-r * p, sigma, pbd, pbf, z((6, 6))],
            [sigma.T, -r * p, z((6, 1)), z((6, 2)), eye],
            [pbd.T, z((1, 6)), -gamma_squared * _eye(1), z((1, 2)), z((1, 6))],
            [pbf.T, z((2, 6)), z((2, 1)), -gamma_squared * _eye(2), z((2, 6))],
            [z((6, 6)), eye, z((6, 1)), z((6, 2)), -eye],
        ]
    )


def disc(p: Any, pn: Any, q: Any, r: Any, block: Callable[..., Any] = np.block) -> Any:
    """Poles of N in the disc of centre -q and radius r (D-stability with the same P)."""
    sigma = q * p + pn
    return block([[-r * p, sigma], [sigma.T, -r * p]])


def covariance(pn: Any, pb: Any, block: Callable[..., Any] = np.block) -> Any:
    """H2 inequality: sym(P N) + P B B^T P < 0, so that P^-1 bounds the error covariance."""
    m = pb.shape[1]
    return block([[pn + pn.T, pb], [pb.T, -_eye(m)]])


def integral_feedback(q: Any, x: Any, a: Any, b: Any, alpha: Any) -> Any:
    """LMI (67): sym(A_c Q + B_c X) + 2 alpha Q, for both solver and check."""
    closed = a @ q + b @ x
    return closed + closed.T + 2.0 * alpha * q
