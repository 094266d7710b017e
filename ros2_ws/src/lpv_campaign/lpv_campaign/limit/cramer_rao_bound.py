"""The best that any estimator could do on one run: posterior Cramer-Rao bounds.

The Fisher information of states given readings obeys, for a system with Gaussian noise, the
recursion of a Kalman filter's inverse covariance with the Jacobians of the true sampled dynamics
and sensors.  It is evaluated along the run's true trajectory and kept in covariance form, because
the disturbance drives one direction only.
"""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.kalman_smoother import both_passes
from lpv_campaign.limit.linearisation import linearise
from lpv_campaign.limit.problem import Problem


@dataclass(frozen=True)
class Limit:
    """Least standard deviations of errors: of causal estimators, and of smoothers."""

    fault: np.ndarray  # (n, 2) Faults of the position sensors, from data up to each sample [rad]
    angle: np.ndarray  # (n, 2) Absolute angles, likewise [rad]
    smoothed_fault: np.ndarray  # (n, 2) The same from all data of the run [rad]
    smoothed_angle: np.ndarray  # (n, 2) [rad]


def accuracy_limit(problem: Problem) -> Limit:
    """Posterior Cramer-Rao bounds of faults and angles along a run.

    Parameters
    ----------
    problem : Problem
        The run and what is known.

    Returns
    -------
    Limit
        Standard deviations.

    Raises
    ------
    ConfigError
        If the plant is no rigid-body arm.
    """
    passes = both_passes(linearise(problem, problem.true_states()))
    now, later = np.sqrt(passes.filtered_variances), np.sqrt(passes.smoothed_variances)
    return Limit(now[:, :2], now[:, 2:], later[:, :2], later[:, 2:])
