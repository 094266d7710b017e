"""Changes of a sensor's residual that no healthy arm can make: several windows at once.

The residual r of a sensor (`lpv_core.residual.dead_reckoning`) changes over a window by no more than noise
and the stated errors of the rates; this holds in every configuration, even where gravity says
nothing.  Short windows see abrupt faults in milliseconds, long ones see drifts before their size
does: a generalised likelihood ratio over the time of onset, on a grid.

A slow change may also be the fault of a rate sensor (`lpv_core.residual.rate_sensor_test`).
"""

import math
from statistics import NormalDist
from typing import Any

from lpv_core.residual.sample_buffer import ALLOWANCE, RESIDUAL, index_at, median_before
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

WINDOWS = (0.01, 0.05, 0.2, 1.0, 2.5)
"""Lengths of the windows [s]."""
_MEDIAN_OF = 5

CHANGE_TEST = record_type(
    ('noise', 'f8', (len(WINDOWS),)), ('walk', 'f8'), ('smallest', 'f8'), ('sample_time', 'f8')
)
"""Constants: limit by noise alone for each window [rad]; growth of the limit by noise of the rates
[rad/sqrt(s)]; smallest limit [rad]; sample time [s]."""


def sigmas_for(hours: float, sample_time: float) -> float:
    """Multiple of the standard deviation for a mean time between false alarms by noise.

    Every window of both sensors counts as an independent test at every sample, which is on the
    safe side: neighbouring tests are correlated, and an alarm needs a dwell, too.

    Parameters
    ----------
    hours : float
        Mean time between false alarms [h].
    sample_time : float
        [s].

    Returns
    -------
    float
        Two-sided normal quantile.
    """
    tests = 2 * len(WINDOWS) * hours * 3600.0 / sample_time
    return -NormalDist().inv_cdf(0.5 / tests)


def change_test(arm, hours: float, smallest: float = 0.0):
    """Limits of healthy changes for one arm.

    Parameters
    ----------
    arm : ArmParameters
        Noise of its sensors.
    hours : float
        Mean time between false alarms [h].
    smallest : float, optional
        Changes below are of no interest [rad].

    Returns
    -------
    numpy.record
        Of type `CHANGE_TEST`.
    """
    z = sigmas_for(hours, arm.sample_time)
    walk = z * arm.velocity_noise * math.sqrt(arm.sample_time)
    noise = [
        math.hypot(z * math.sqrt(2.0) * arm.position_noise, walk * math.sqrt(window))
        for window in WINDOWS
    ]
    return new_record(
        CHANGE_TEST, noise=noise, walk=walk, smallest=smallest, sample_time=arm.sample_time
    )


@njit
def change_limit(params, window: int, error: float) -> float:
    """Largest healthy change over a window.

    Parameters
    ----------
    params : numpy.record
        `change_test`.
    window : int
        Index into `WINDOWS`.
    error : float
        What errors of the rates can add up to over the window, beside noise [rad].

    Returns
    -------
    float
        [rad].
    """
    return max(params.smallest, params.noise[window] + error)


@njit
def least_change(params) -> float:
    """Change from one sample to the next that noise does not make.

    Parameters
    ----------
    params : numpy.record
        `change_test`.

    Returns
    -------
    float
        [rad].
    """
    return change_limit(params, 0, 0.0)


@njit
def find_change(params, stamps, values, end, sample) -> tuple[Any, ...]:
    """The shortest window over which the residual changed too much.

    Parameters
    ----------
    params : numpy.record
        `change_test`.
    stamps, values, end
        The sensor's past, see `lpv_core.residual.sample_buffer`.
    sample : numpy.record
        The present, of type `lpv_core.decision.sensor_state.SAMPLE`.

    Returns
    -------
    tuple
        Index of the window, -1 if there is none; its row; r before the change [rad].
    """
    for window in range(len(WINDOWS)):
        then = sample.stamp - round(WINDOWS[window] * 1e9)
        # Without gaps the present sample would be row ``end``.
        row = index_at(stamps, end, then, end - round(WINDOWS[window] / params.sample_time))
        if row < 0:
            continue
        limit = change_limit(params, window, sample.allowance - values[row, ALLOWANCE])
        if abs(sample.residual - values[row, RESIDUAL]) <= limit:
            continue
        median = median_before(values, row, _MEDIAN_OF)
        if abs(sample.residual - median) > limit:
            return window, row, median
    return -1, -1, 0.0
