"""The matrix inequalities, written once for the solver and for the check of what it returns.

Every function takes ``block``: ``cvxpy.bmat`` builds the constraint, ``numpy.block`` rebuilds the
same inequality from numbers.  A design is accepted on the eigenvalues of the rebuilt matrix alone;
the solver's word is recorded but never trusted.
"""

from collections.abc import Callable
from typing import Any

import numpy as np


def _eye(n):
    """Identity of integers, which no kind of number is rounded by."""
    return np.eye(n, dtype=int)


def _zeros(shape):
    return np.zeros(shape, dtype=int)


def symmetric_part(matrix):
    """(M + M^T)/2: what an inequality on a numerically unsymmetric matrix is about."""
    return 0.5 * (matrix + matrix.T)


def largest_eigenvalue(matrix):
    """Largest eigenvalue of a symmetric matrix; negative if M < 0 holds, NaN if M is not finite."""
    if not np.isfinite(matrix).all():
        return np.nan
    return float(np.linalg.eigvalsh(symmetric_part(np.asarray(matrix)))[-1])


def bounded_real(p, pn, pbd, pbf, gamma_squared, block: Callable[..., Any] = np.block):
    """LMI (54): stability and attenuation of d and f in the estimation error.

    Parameters
    ----------
    p : (6, 6)
        Lyapunov matrix P.
    pn : (6, 6)
        P N_i = P T1 A~_i + y_i C~.
    pbd, pbf : (6, 1), (6, 2)
        P T1 Bd~ and P T1 Bf~.
    gamma_squared : scalar
        gamma^2.
    block : callable, optional
        ``numpy.block`` or ``cvxpy.bmat``.

    Returns
    -------
    (15, 15)
        Must be negative definite.
    """
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
    p, pn, pbd, pbf, gamma_squared, q: float, r: float, block: Callable[..., Any] = np.block
):
    """LMI (55): as (54) with the poles in the disc of centre -q and radius r, in one matrix.

    Parameters
    ----------
    p, pn, pbd, pbf, gamma_squared
        As `bounded_real`.
    q, r : float
        Disc [1/s].
    block : callable, optional
        ``numpy.block`` or ``cvxpy.bmat``.

    Returns
    -------
    (21, 21)
        Must be negative definite.
    """
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


def disc(p, pn, q: float, r: float, block: Callable[..., Any] = np.block):
    """Poles of N in the disc of centre -q and radius r (D-stability with the same P).

    Parameters
    ----------
    p, pn : (n, n)
        P and P N.
    q, r : float
        Disc [1/s]; the decay rate is q - r, the fastest pole q + r.
    block : callable, optional
        ``numpy.block`` or ``cvxpy.bmat``.

    Returns
    -------
    (2n, 2n)
        Must be negative definite.
    """
    sigma = q * p + pn
    return block([[-r * p, sigma], [sigma.T, -r * p]])


def covariance(pn, pb, block: Callable[..., Any] = np.block):
    """H2 inequality: sym(P N) + P B B^T P < 0, so that P^-1 bounds the error covariance.

    Parameters
    ----------
    pn : (n, n)
        P N.
    pb : (n, m)
        P B of all unit-intensity white inputs.
    block : callable, optional
        ``numpy.block`` or ``cvxpy.bmat``.

    Returns
    -------
    (n+m, n+m)
        Must be negative definite.
    """
    m = pb.shape[1]
    return block([[pn + pn.T, pb], [pb.T, -_eye(m)]])


def integral_feedback(q, x, a, b, alpha: float):
    """LMI (67): sym(A_c Q + B_c X) + 2 alpha Q, for both solver and check.

    Parameters
    ----------
    q : (6, 6)
        Q = P^-1.
    x : (2, 6)
        X = M Q.
    a, b : (6, 6), (6, 2)
        Augmented vertex, eq. (64).
    alpha : float
        Decay rate [1/s].

    Returns
    -------
    (6, 6)
        Must be negative definite.
    """
    closed = a @ q + b @ x
    return closed + closed.T + 2.0 * alpha * q
