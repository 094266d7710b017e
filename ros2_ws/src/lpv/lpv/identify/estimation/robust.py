"""Huber's estimates of linear models by normal equations, and their scale."""

from collections.abc import Callable

import numpy as np

from lpv.identify.model.prior import Prior

HUBER = 3.0
"""Residuals beyond this many scales weigh less (contacts, outliers)."""


def robust_scale(
    residual: np.ndarray, counts: np.ndarray, least: np.ndarray | float = 0.0
) -> np.ndarray:
    """Standard deviation of each column by the median magnitude of those that count."""
    pairs = zip(np.abs(residual.T), counts.T)
    median = np.array([np.median(r[one]) if one.any() else 0.0 for r, one in pairs])
    return np.maximum(median / 0.6745, least)


def huber(ratio: np.ndarray, bound: float) -> np.ndarray:
    """Weights of residuals in units of their scale."""
    return bound / np.maximum(np.abs(ratio), bound)


def bounded_squares(error: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Sum over the samples that count of each column's squares, in which no contact decides."""
    bound = 4.0 * robust_scale(error, counts)
    return np.sum(np.clip(error, -bound, bound) ** 2 * counts, axis=0)


def predicted(design: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """A design, shape (rows, n, parameters), times parameters, shape (rows, n)."""
    # In one product: NumPy would make one for every row.
    return (design.reshape(-1, len(parameters)) @ parameters).reshape(design.shape[:2])


def normal_matrix(design: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Normal matrix of a design, shape (rows, n, parameters), with weights, shape (rows, n)."""
    flat = (design * np.sqrt(weight)[:, :, None]).reshape(-1, design.shape[2])
    return flat.T @ flat


def normal_equations(
    design: np.ndarray, target: np.ndarray, weight: np.ndarray, prior: Prior | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right-hand side; the prior is of the first parameters."""
    matrix = normal_matrix(design, weight)
    right = design.reshape(-1, design.shape[2]).T @ (weight * target).ravel()
    if prior is not None:
        size = len(prior.mean)
        matrix[:size, :size] += prior.information
        right[:size] += prior.information @ prior.mean
    return matrix, right


def roots(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R, W with R^T R a normal matrix, W^T W its inverse, without directions that no row shows."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    kept = values > 1e-11 * values[-1]
    length, turn = np.sqrt(values[kept])[:, None], vectors[:, kept].T
    return length * turn * size, turn / length / size


def invert_normal(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; directions that the rows do not show are left out."""
    _, root = roots(matrix)
    return root.T @ root


def solve_normal(
    matrix: np.ndarray, right: np.ndarray, positive: np.ndarray | bool = False
) -> np.ndarray:
    """Solution of normal equations; those of ``positive`` parameters that were negative are 0."""
    active = np.ones(len(right), bool)
    while True:
        solution = np.zeros(len(right))
        solution[active] = invert_normal(matrix[np.ix_(active, active)]) @ right[active]
        negative = positive & (solution < 0.0)
        if not negative.any():
            return solution
        active &= ~negative


def robust_fit(
    design: np.ndarray,  # shape (rows, n, parameters)
    target: np.ndarray,  # shape (rows, n)
    weight: np.ndarray,  # of the residuals, to begin with; 0 where they do not count; (rows, n)
    scale: np.ndarray,  # to begin with, of each column, shape (n,)
    prior: Prior | None = None,  # of the first parameters
    bound: float = HUBER,  # scales beyond which residuals weigh less
    rounds: int = 8,
    share: float = 1.0,  # of the rows that is independent of the others
    least: np.ndarray | float = 1e-9,  # scale
    solve: Callable[[np.ndarray, np.ndarray], np.ndarray] = solve_normal,  # normal equations
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Huber's estimate of target = design @ parameters; these, residuals, their weights, scales."""
    counts = weight > 0.0
    for _ in range(rounds):
        solution = solve(*normal_equations(design, target, share * weight / scale**2, prior))
        residual = target - predicted(design, solution)
        scale = robust_scale(residual, counts, least)
        scale = np.maximum(scale, 1e-6 * np.max(scale))
        weight = counts * huber(residual / scale, bound)
    return solution, residual, weight, scale
