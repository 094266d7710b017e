"""Accuracy of one run and its limit: ours, Kalman filters, smoother, Cramer-Rao bounds.

All figures are root mean squares over one window [rad]: over a run with faults, from `SETTLED`
after each onset to the fault's end, of the faulty sensors; over a healthy run, from twice
`SETTLED` on, of both sensors; samples that were lost do not count.  A single run is one draw: its
root mean square may be below a limit, the root of the mean square over many runs is not.
"""

import math
from dataclasses import replace

import numpy as np

from lpv_campaign.limit.arm_prior import known_exactly, known_within_priors
from lpv_campaign.limit.cramer_rao_bound import accuracy_limit
from lpv_campaign.limit.fault_prior import FaultModel, acting, anything, biases_since, known_shape
from lpv_campaign.limit.kalman import filter_run, make_ekf, make_ukf
from lpv_campaign.limit.problem import Problem
from lpv_campaign.limit.smoother import filter_adaptively, smooth
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import Run
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.errors import LpvError

SETTLED = 1.0
"""Time after an onset, or after the start, that is left out [s]."""
ESTIMATORS = ('ours', 'confirmed', 'ekf', 'ukf', 'adaptive', 'smoother')
"""Fault estimate of the observer and its angles; confirmed fault and the angles without it, which
the loop closes on; FilterPy's filters; extended filter that learns the arm from rates and torques
alone, and assumes nothing of the faults; iterated smoother that knows onset and shape of the faults
and the arm within priors."""
LIMITS = (
    'limit_arm_known',
    'limit_within_priors',
    'limit_any_fault_arm_known',
    'limit_any_fault_within_priors',
    'smoothed_limit_arm_known',
    'smoothed_limit_within_priors',
)
"""Of causal estimators that know onset and shape of each fault (in a healthy run: that both sensors
may have a constant bias from `SETTLED` on), or nothing of the faults (``any_fault``), with the arm
known exactly or within what its file states; and of the smoother."""
RATIOS = ('ratio', 'ratio_any_fault')
"""Ours over the limits within priors."""
NAMES = tuple(
    f'{quantity}_{name}'
    for quantity in ('fault', 'angle')
    for name in (*ESTIMATORS, *LIMITS, *RATIOS)
)
"""Keys of `limit_figures`; all root mean squares in rad, ratios without unit."""


def limit_figures(
    arm: ArmParameters,
    scenario: Scenario,
    run: Run,
    peers: bool = True,
    smoother: bool = True,
    substeps: int = 2,
) -> dict[str, float]:
    """Accuracy of the fault estimates and of the joint angles of one run, and its limits.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    scenario : Scenario
        What was simulated; it makes the true arm.
    run : lpv_core.simulation.closed_loop.Run
        What came out.
    peers, smoother : bool, optional
        Whether to run the Kalman filters and the smoother, which take most of the time.
    substeps : int, optional
        Runge-Kutta steps per sample, as in the run.

    Returns
    -------
    dict of str to float
        By `NAMES`; NaN where there is nothing to be measured (a dropout has no size), where an
        estimator broke down, or was left out.

    Raises
    ------
    ConfigError
        If the plant is no rigid-body arm.
    LpvError
        If the run is not finite.
    """
    if not (np.isfinite(run.position).all() and np.isfinite(run.torque).all()):
        raise LpvError('a run that is not finite has no limit of accuracy')
    joints = JointMap(arm)
    truth = run.fault, joints.absolute_position(run.position)
    masks = windows(arm, scenario, run)
    pairs = _estimates(arm, scenario, run, joints, peers, smoother, substeps)
    errors: dict[str, tuple[np.ndarray, ...]] = {
        name: (pair[0] - truth[0], pair[1] - truth[1]) for name, pair in pairs.items()
    }
    errors.update(_limits(arm, scenario, run, substeps))
    result = dict.fromkeys(NAMES, math.nan)
    for q, quantity in enumerate(('fault', 'angle')):
        for name, pair in errors.items():
            result[f'{quantity}_{name}'] = _rms(
                pair[q], masks[q] & np.isfinite(run.fault) if q == 0 else masks[q]
            )
        for name, limit in zip(RATIOS, ('limit_within_priors', 'limit_any_fault_within_priors')):
            least = result[f'{quantity}_{limit}']
            if least > 0.0:
                result[f'{quantity}_{name}'] = result[f'{quantity}_ours'] / least
    return result


def windows(arm: ArmParameters, scenario: Scenario, run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Where errors count.

    Returns tuple of ndarray of bool of shape (n, 2): For the faults of both sensors and for
    both angles.
    """
    n = len(run.time)
    if not scenario.faults:
        both = np.repeat((run.time >= 2.0 * SETTLED)[:, None], 2, axis=1)
        return both & ~run.lost[:, None], both & ~run.lost[:, None]
    faults, angles = np.zeros((n, 2), bool), np.zeros((n, 2), bool)
    for fault in scenario.faults:
        settled = acting(fault, run.time, SETTLED)
        angles |= settled[:, None]
        if fault.kind != 'rate_bias':
            faults[:, arm.sensor_names.index(fault.sensor)] |= settled
    return faults & ~run.lost[:, None], angles & ~run.lost[:, None]


def fault_models(arm: ArmParameters, scenario: Scenario, run: Run) -> list[FaultModel]:
    """What the best estimator knows of the faults of a run."""
    return known_shape(arm, scenario, run) if scenario.faults else biases_since(run, SETTLED)


def _estimates(
    arm: ArmParameters,
    scenario: Scenario,
    run: Run,
    joints: JointMap,
    peers: bool,
    smoother: bool,
    substeps: int,
) -> dict[str, tuple[np.ndarray, ...]]:
    """Faults and absolute angles by estimator; those that broke down are left out."""
    compensated = joints.sensor_position(run.compensated)
    found: dict[str, tuple[np.ndarray, ...]] = {
        'ours': (run.fault_estimate, joints.absolute_position(run.estimate)),
        'confirmed': (
            joints.sensor_position(run.measured) - compensated,
            joints.absolute_position(run.compensated),
        ),
    }
    tasks = {}
    if peers:
        tasks['ekf'] = lambda: filter_run(make_ekf, arm, run)
        tasks['ukf'] = lambda: filter_run(make_ukf, arm, run)
        tasks['adaptive'] = lambda: filter_adaptively(
            Problem(arm, scenario, run, known_within_priors(arm, scenario), anything(run), substeps)
        )
    if smoother:
        tasks['smoother'] = lambda: _smoothed(arm, scenario, run, substeps)
    for name, task in tasks.items():
        try:
            found[name] = task()
        except LpvError:
            continue
    return found


def _smoothed(
    arm: ArmParameters, scenario: Scenario, run: Run, substeps: int
) -> tuple[np.ndarray, ...]:
    knowledge, faults = known_within_priors(arm, scenario), fault_models(arm, scenario, run)
    best = smooth(Problem(arm, scenario, run, knowledge, faults, substeps))
    if not best.converged:
        raise LpvError('the smoother did not converge')
    return best.fault, best.angle


def _limits(
    arm: ArmParameters, scenario: Scenario, run: Run, substeps: int
) -> dict[str, tuple[np.ndarray, ...]]:
    found: dict[str, tuple[np.ndarray, ...]] = {}
    for arm_known, knowledge in (
        ('arm_known', known_exactly(arm, scenario)),
        ('within_priors', known_within_priors(arm, scenario)),
    ):
        problem = Problem(arm, scenario, run, knowledge, fault_models(arm, scenario, run), substeps)
        best = accuracy_limit(problem)
        found[f'limit_{arm_known}'] = best.fault, best.angle
        found[f'smoothed_limit_{arm_known}'] = best.smoothed_fault, best.smoothed_angle
        any_fault = accuracy_limit(replace(problem, faults=anything(run)))
        found[f'limit_any_fault_{arm_known}'] = any_fault.fault, any_fault.angle
    return found


def _rms(values: np.ndarray, mask: np.ndarray) -> float:
    values = values[mask]
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan
