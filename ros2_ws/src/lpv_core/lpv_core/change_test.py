"""Changes of a fault estimate that no healthy arm can make: several windows at once.

A position fault enters f^ = y_p - S theta^ undelayed, while theta^ moves by the measured rates and
by a correction whose speed is bounded.  Over a window the estimate of a healthy sensor therefore
changes by no more than noise and that speed times the window; this holds in every configuration,
even where gravity says nothing.  Short windows see abrupt faults in milliseconds, long ones see
drifts before their size does: a generalised likelihood ratio over the time of onset, on a grid.
"""

import math
from statistics import NormalDist

from lpv_core.history import FAULT, index_at, median_before
from lpv_core.jit import njit
from lpv_core.records import new_record, record_type

WINDOWS = (0.01, 0.05, 0.2, 1.0)
"""Lengths of the windows [s]."""

_ONSET_RESERVE = 1.5
"""Rates' noise also acts through the observer's correction; over that of the rates alone."""

CHANGE_TEST = record_type(('noise', 'f8', (len(WINDOWS),)), ('smallest', 'f8'),
                          ('sample_time', 'f8'))
"""Constants: limit by noise alone for each window, smallest limit [rad]; sample time [s]."""


def sigmas_for(hours, sample_time):
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


def change_test(arm, hours, smallest=0.0):
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
    noise = [z * math.sqrt(2.0 * arm.position_noise**2
                           + (_ONSET_RESERVE * arm.velocity_noise) ** 2 * arm.sample_time * window)
             for window in WINDOWS]
    return new_record(CHANGE_TEST, noise=noise, smallest=smallest, sample_time=arm.sample_time)


@njit
def change_limit(c, window, speed):
    """Largest healthy change over a window.

    Parameters
    ----------
    c : numpy.record
        `change_test`.
    window : int
        Index into `WINDOWS`.
    speed : float
        Bound on the speed of the estimate's error [rad/s].

    Returns
    -------
    float
        [rad].
    """
    return max(c.smallest, c.noise[window] + speed * WINDOWS[window])


@njit
def find_change(c, stamps, values, end, stamp, fault, speed):
    """The shortest window over which the estimate changed too much.

    Parameters
    ----------
    c : numpy.record
        `change_test`.
    stamps, values, end
        The sensor's past, see `lpv_core.history`.
    stamp : int
        Present [ns].
    fault : float
        Present f^ [rad].
    speed : float
        Bound on the speed of the error [rad/s].

    Returns
    -------
    tuple
        Index of the window, -1 if there is none, and f^ before the change [rad].
    """
    for window in range(len(WINDOWS)):
        limit = change_limit(c, window, speed)
        then = stamp - round(WINDOWS[window] * 1e9)
        # Without gaps the present sample would be row ``end``.
        row = index_at(stamps, end, then, end - round(WINDOWS[window] / c.sample_time))
        if row < 0 or abs(fault - values[row, FAULT]) <= limit:
            continue
        before = median_before(values, row)
        if abs(fault - before) > limit:
            return window, before
    return -1, 0.0
