"""Kalman filter and fixed-interval smoother of a linearised run."""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.kalman_kernels import filter_forward, smooth_backward
from lpv_campaign.limit.linearisation import LinearSystem


@dataclass(frozen=True)
class Passes:
    """Results of both passes over n samples."""

    means: np.ndarray  # (n, N) Deviations given the readings up to each sample
    smoothed: np.ndarray  # (n, N) Deviations given all readings
    covariances: np.ndarray  # (n, N, N) Given the readings up to each sample
    filtered_variances: np.ndarray  # (n, 4) Of both faults and both absolute angles [rad2]
    smoothed_variances: np.ndarray  # (n, 4) The same given all readings [rad2]


def both_passes(
    system: LinearSystem,
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
    filtered = filter_forward(
        system.f, system.g, system.noise, residual, defect, start, system.deviation
    )
    rows = np.concatenate([system.fault, np.broadcast_to(np.eye(2, size), (n, 2, size))], axis=1)
    smoothed, variances = smooth_backward(system.f, system.noise, rows, filtered)
    known = np.einsum('kqi,kij,kqj->kq', rows, filtered.covariances, rows, optimize=True)
    return Passes(filtered.means, smoothed, filtered.covariances, np.maximum(known, 0.0), variances)
