"""Kalman filter and fixed-interval smoother of a linearised run."""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.kalman_kernels import filter_forward, smooth_backward


@dataclass(frozen=True)
class Passes:
    """Results of both passes over n samples.

    Attributes
    ----------
    means, smoothed : ndarray, shape (n, N)
        Deviations given the readings up to each sample, and given all.
    covariances : ndarray, shape (n, N, N)
        Given the readings up to each sample.
    filtered_variances, smoothed_variances : ndarray, shape (n, 4)
        Of the faults of both position sensors and of both absolute angles [rad2].
    """

    means: np.ndarray
    smoothed: np.ndarray
    covariances: np.ndarray
    filtered_variances: np.ndarray
    smoothed_variances: np.ndarray


def both_passes(
    system,
    residual: np.ndarray | None = None,
    defect: np.ndarray | None = None,
    start: np.ndarray | None = None,
) -> Passes:
    """Filter and smooth deviations from the trajectory along which a run was linearised.

    Parameters
    ----------
    system : LinearSystem
        The run.
    residual, defect, start : ndarray, optional
        As `filter_forward`; zero, which leaves covariances alone.

    Returns
    -------
    Passes
        Deviations and variances.
    """
    n, _, size = system.h.shape
    residual = np.zeros((n, system.h.shape[1])) if residual is None else residual
    defect = np.zeros((n, size)) if defect is None else defect
    start = np.zeros(size) if start is None else start
    means, covariances = np.empty((n, size)), np.empty((n, size, size))
    gains, innovations = np.empty(system.h.shape), np.empty(residual.shape)
    spreads = np.empty(residual.shape)
    filter_forward(
        system.f,
        system.g,
        system.push,
        system.memory,
        system.growth,
        system.h,
        system.r,
        residual,
        defect,
        start,
        system.deviation,
        means,
        covariances,
        gains,
        innovations,
        spreads,
    )
    rows = np.concatenate([system.fault, np.broadcast_to(np.eye(2, size), (n, 2, size))], axis=1)
    smoothed, variances = np.empty((n, size)), np.empty((n, 4))
    smooth_backward(
        system.f,
        system.memory,
        system.h,
        rows,
        means,
        covariances,
        gains,
        innovations,
        spreads,
        smoothed,
        variances,
    )
    filtered = np.einsum('kqi,kij,kqj->kq', rows, covariances, rows, optimize=True)
    return Passes(means, smoothed, covariances, np.maximum(filtered, 0.0), variances)
