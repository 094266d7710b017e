"""Changes of a sensor's residual that no healthy arm can make: several windows at once.

The residual r of a sensor (`lpv_core.residual.dead_reckoning`) changes over a window by no more
than noise and the stated errors of the rates; this holds in every configuration, even where gravity
says nothing.  Short windows see abrupt faults in milliseconds, long ones see drifts before their
size does: a generalised likelihood ratio over the time of onset, on a grid.

A slow change may also be the fault of a rate sensor (`lpv_core.residual.rate_sensor_test`).
"""

import math
from statistics import NormalDist

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.residual.sample_buffer import (
    ALLOWANCE,
    RESIDUAL,
    SampleBuffer,
    index_at,
    median_before,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

WINDOWS = (0.01, 0.05, 0.2, 1.0, 2.5)
"""Lengths of the windows [s]."""
_MEDIAN_OF = 5

CHANGE_TEST = record_type(
    ('noise', 'f8', (len(WINDOWS),)),  # limit by noise alone for each window [rad]
    ('reading', 'f8'),  # its part by noise of readings [rad]
    ('walk', 'f8'),  # growth of the limit by noise of the rates [rad/sqrt(s)]
    ('smallest', 'f8'),  # smallest limit [rad]
    ('sample_time', 'f8'),  # [s]
)


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


def change_test(arm: ArmParameters, hours: float, smallest: float = 0.0) -> np.record:
    """`CHANGE_TEST` for an arm's noise, a mean time between false alarms [h], and the smallest
    change of interest [rad]."""
    z = sigmas_for(hours, arm.sample_time)
    walk = z * arm.velocity_noise * math.sqrt(arm.sample_time)
    reading = z * math.sqrt(2.0) * arm.position_noise
    return new_record(
        CHANGE_TEST,
        noise=[math.hypot(reading, walk * math.sqrt(window)) for window in WINDOWS],
        reading=reading,
        walk=walk,
        smallest=smallest,
        sample_time=arm.sample_time,
    )


@njit
def scale_limits(stated: np.record, reading: float, rate: float, limits: np.record) -> None:
    """Limits for noise of readings and rates that is so many times what is stated."""
    limits.smallest, limits.sample_time = stated.smallest, stated.sample_time
    by_reading, by_rate = reading * stated.reading, rate * stated.walk
    limits.reading, limits.walk = by_reading, by_rate
    for k in range(len(WINDOWS)):
        limits.noise[k] = stated.noise[k]
        if reading > 1.0 or rate > 1.0:
            limits.noise[k] = math.hypot(by_reading, by_rate * math.sqrt(WINDOWS[k]))


@njit
def change_limit(params: np.record, window: int, error: float) -> float:
    """Largest healthy change over a window, if errors of the rates add up to ``error`` [rad]."""
    return max(params.smallest, params.noise[window] + error)


@njit
def least_change(params: np.record) -> float:
    """Change from one sample to the next that noise does not make [rad]."""
    return change_limit(params, 0, 0.0)


@njit
def find_change(
    params: np.record, buffer: SampleBuffer, sample: np.record
) -> tuple[int, int, float]:
    """The shortest window over which the residual changed too much.

    Parameters
    ----------
    params : numpy.record
        Of type `CHANGE_TEST`.
    buffer : SampleBuffer
        The sensor's past.
    sample : numpy.record
        The present, of type `lpv_core.decision.sensor_state.SAMPLE`.

    Returns
    -------
    tuple
        Index of the window, -1 if there is none; its row; r before the change [rad].
    """
    for window in range(len(WINDOWS)):
        then = sample.stamp - round(WINDOWS[window] * 1e9)
        # Without gaps the present sample would be the next row.
        guess = buffer.used[0] - round(WINDOWS[window] / params.sample_time)
        row = index_at(buffer, then, guess)
        if row < 0:
            continue
        limit = change_limit(params, window, sample.allowance - buffer.values[row, ALLOWANCE])
        if abs(sample.residual - buffer.values[row, RESIDUAL]) <= limit:
            continue
        median = median_before(buffer, row, _MEDIAN_OF)
        if abs(sample.residual - median) > limit:
            return window, row, median
    return -1, -1, 0.0
