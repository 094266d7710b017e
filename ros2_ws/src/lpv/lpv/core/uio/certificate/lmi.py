"""The matrix inequalities, written once for the solver and for the check of what it returns.

Every function takes ``block``: ``cvxpy.bmat`` builds the constraint, ``numpy.block`` rebuilds the
same inequality from numbers.  P is a Lyapunov matrix; products with it (``pn`` = P N, ``pb`` = P B)
are one argument, because the solver's unknown is the product.  A design is accepted on the
eigenvalues of the rebuilt matrix alone; the solver's word is recorded but never trusted.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from lpv.core.uio.model.polytope import Descriptor


def _eye(n: int) -> np.ndarray:
    """Identity of integers, which no kind of number is rounded by."""
    return np.eye(n, dtype=int)


def bounded_real(inner: Any, pb: Any, gamma_squared: Any, block: Any = np.block) -> Any:
    """Attenuation from inputs to the estimation error, in LMIs (54) and (55).

    The inner matrix is sym(P N) in (54), and that of `disc` in (55), whose last rows are the error.
    """
    error, zeros = _eye(inner.shape[0])[:, -6:], np.zeros((3, 6), dtype=int)
    return block(
        [[inner, pb, error], [pb.T, -gamma_squared * _eye(3), zeros], [error.T, zeros.T, -_eye(6)]]
    )


def disc(p: Any, pn: Any, q: Any, r: Any, block: Callable[..., Any] = np.block) -> Any:
    """Poles of N in the disc of centre -q and radius r (D-stability with the same P)."""
    sigma = q * p + pn
    return block([[-r * p, sigma], [sigma.T, -r * p]])


def paper_inequalities(
    descriptor: Descriptor,
    p: Any,
    pt: Any,
    y: Any,
    gamma_squared: Any,
    q: Any,
    r: Any,
    lmi: str,
    block: Callable[..., Any] = np.block,
) -> list[Any]:
    """Negative matrices of the observer (38) at all vertices, with one P.

    Parameters
    ----------
    descriptor : Descriptor
        Augmented vertices, eqs. (36), (37).
    p, pt : array_like, shape (6, 6)
        P and P T1.
    y : sequence of array_like, shape (6, 4)
        P K_i, eq. (56).
    gamma_squared, q, r : number
        Square of the attenuation level, centre and radius of the disc.
    lmi : {'55', '54+disc'}
        LMI (55), or LMI (54) and the disc as inequalities of their own.
    """
    d, matrices = descriptor, []
    pb = pt @ np.hstack([d.bd, d.bf])
    for a_i, y_i in zip(d.a, y):
        pn = pt @ a_i + y_i @ d.c
        poles = disc(p, pn, q, r, block)
        if lmi == '55':
            inputs = block([[pb], [np.zeros((6, 3), dtype=int)]])
            matrices.append(bounded_real(poles, inputs, gamma_squared, block))
        else:
            matrices += [bounded_real(pn + pn.T, pb, gamma_squared, block), poles]
    return matrices


def covariance(pn: Any, pb: Any, block: Callable[..., Any] = np.block) -> Any:
    """H2 inequality: sym(P N) + P B B^T P < 0, so that P^-1 bounds the error covariance."""
    m = pb.shape[1]
    return block([[pn + pn.T, pb], [pb.T, -_eye(m)]])
