"""The best that any estimator could do on one run: posterior Cramer-Rao bounds.

The Fisher information of states given readings obeys, for a system with Gaussian noise, the
recursion of a Kalman filter's inverse covariance with the Jacobians of the true sampled dynamics
and sensors.  It is evaluated along the run's true trajectory and kept in covariance form, because
the disturbance drives one direction only.
"""

from dataclasses import dataclass

import numpy as np

from lpv_campaign.limit.arm_prior import ArmKnowledge
from lpv_campaign.limit.fault_prior import FaultModel
from lpv_campaign.limit.kalman_smoother import both_passes
from lpv_campaign.limit.linearisation import linearise, true_states
from lpv_core.model.arm import ArmParameters
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.scenario import Scenario


@dataclass(frozen=True)
class Limit:
    """Least standard deviations of errors: of causal estimators, and of smoothers."""

    fault: np.ndarray  # (n, 2) Faults of the position sensors, from data up to each sample [rad]
    angle: np.ndarray  # (n, 2) Absolute angles, likewise [rad]
    smoothed_fault: np.ndarray  # (n, 2) The same from all data of the run [rad]
    smoothed_angle: np.ndarray  # (n, 2) [rad]


def accuracy_limit(
    arm: ArmParameters,
    scenario: Scenario,
    run: Run,
    knowledge: ArmKnowledge,
    faults: list[FaultModel],
    substeps: int = 2,
) -> Limit:
    """Posterior Cramer-Rao bounds of faults and angles along a run.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    scenario : Scenario
        What happened: plant, noise, disturbance, faults.
    run : Run
        Its signals.
    knowledge : ArmKnowledge
        `lpv_campaign.limit.arm_prior.known_exactly` or ``known_within_priors``.
    faults : list of FaultModel
        What is known of the faults, see `lpv_campaign.limit.fault_prior`.
    substeps : int, optional
        Runge-Kutta steps per sample, as in the run.

    Returns
    -------
    Limit
        Standard deviations.

    Raises
    ------
    ConfigError
        If the plant is no rigid-body arm.
    """
    states = true_states(arm, run, knowledge, faults)
    passes = both_passes(linearise(arm, scenario, run, knowledge, faults, states, substeps))
    now, later = np.sqrt(passes.filtered_variances), np.sqrt(passes.smoothed_variances)
    return Limit(now[:, :2], now[:, 2:], later[:, :2], later[:, 2:])
