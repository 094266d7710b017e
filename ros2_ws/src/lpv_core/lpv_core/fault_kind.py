"""Which kind of fault a confirmed one is, from its course since the onset."""

import numpy as np

from lpv_core.history import EXPECTED, FAULT, READING
from lpv_core.jit import njit

KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout', 'inconsistent',
         'unclassified')
"""What an alarm may be called; ``inconsistent``: rates, torques and model contradict each other."""

BIAS, DRIFT, SCALE, STUCK, NOISE, SPIKE, DROPOUT, INCONSISTENT, UNCLASSIFIED = range(len(KINDS))

_SETTLED = 0.1
"""Shortest time since the onset for a judgement of the course [s]."""
_STUCK_SAMPLES = 20
_TELLING = 50.0
"""A scale error shows in motion that changes it by so many standard deviations of a reading: the
error of a healthy estimate changes, too."""
_CLEARLY = 4.0
"""Ratio of residuals at which one course fits clearly better than another."""


@njit
def span(values, column, first):
    """Largest minus smallest value of a column from a row on.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        Samples of a history.
    column, first : int
        Column and row.

    Returns
    -------
    float
        [rad].
    """
    low = high = values[first, column]
    for k in range(first + 1, len(values)):
        low, high = min(low, values[k, column]), max(high, values[k, column])
    return high - low


@njit
def is_stuck(values, position_noise):
    """Whether a reading stands still while the arm moves.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        Samples of a history.
    position_noise : float
        Standard deviation of a healthy reading [rad].

    Returns
    -------
    bool
        False without enough motion to tell.
    """
    first = len(values) - _STUCK_SAMPLES
    # Noise alone moves a healthy reading from sample to sample.
    return (first >= 0 and span(values, READING, first) < 0.2 * position_noise
            and span(values, EXPECTED, first) > 3.0 * position_noise)


@njit
def noise_level(values):
    """Standard deviation of white noise in a fault estimate, by second differences.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        At least 10 samples.

    Returns
    -------
    float
        [rad]; the median ignores single spikes and steps.
    """
    count = len(values) - 2
    second = np.empty(count)
    for k in range(count):
        second[k] = abs(values[k + 2, FAULT] - 2.0 * values[k + 1, FAULT] + values[k, FAULT])
    second.sort()
    median = 0.5 * (second[count // 2] + second[(count - 1) // 2])
    return median / (0.6745 * np.sqrt(6.0))


@njit
def classify(stamps, values, onset, baseline, position_noise):
    """Name the kind of a fault that still acts.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        Samples since the onset [ns].
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ [rad].
    onset : int
        [ns].
    baseline : float
        f^ before the onset [rad].
    position_noise : float
        Standard deviation of a healthy reading [rad].

    Returns
    -------
    int
        Index into `KINDS`; ``UNCLASSIFIED`` while there is too little to tell.
    """
    count = len(values)
    if is_stuck(values, position_noise):
        return STUCK
    if count >= 25 and noise_level(values[max(0, count - 50):]) > 3.0 * position_noise:
        return NOISE
    if count < 10 or (stamps[count - 1] - onset) / 1e9 < _SETTLED:
        return UNCLASSIFIED
    time = (stamps - onset) / 1e9
    return _course(time, values[:, FAULT] - baseline, values[:, EXPECTED], values, position_noise)


@njit
def fits_better(kind, than, values, baseline):
    """Whether a bias fits clearly better than a scale error, or the other way round.

    Parameters
    ----------
    kind, than : int
        ``BIAS`` and ``SCALE``, in either order.
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ [rad].
    baseline : float
        f^ before the onset [rad].

    Returns
    -------
    bool
        Also false of other kinds.
    """
    if kind + than != BIAS + SCALE or kind == than:
        return False
    fault = values[:, FAULT] - baseline
    bias, scale = _residual(np.ones(len(fault)), fault), _residual(values[:, EXPECTED], fault)
    return _CLEARLY * bias < scale if kind == BIAS else _CLEARLY * scale < bias


@njit
def _course(time, fault, expected, values, position_noise):
    """Bias, drift or scale: the model that leaves the smallest residual, simplest first."""
    floor = len(time) * position_noise**2
    bias = _residual(np.ones(len(time)), fault)
    drift, scale = _residual(time, fault), _residual(expected, fault)
    best, left = BIAS, bias
    if drift < left:
        best, left = DRIFT, drift
    if scale < left and (abs(_weight(expected, fault)) * span(values, EXPECTED, 0)
                         > _TELLING * position_noise):
        best, left = SCALE, scale
    if best != BIAS and bias < left + 2.0 * floor:
        best, left = BIAS, bias
    if left > 4.0 * (_residual_of_ramp(time, fault) + floor):
        # Neither fits alone, a ramp from an offset does: it grows, whatever it started from.
        return DRIFT
    return best


@njit
def _weight(basis, values):
    """Multiple of ``basis`` that comes closest to ``values``."""
    power = cross = 0.0
    for k in range(len(basis)):
        power += basis[k] * basis[k]
        cross += basis[k] * values[k]
    return cross / power if power > 0.0 else 0.0


@njit
def _residual(basis, values):
    """Sum of squares that a multiple of ``basis`` leaves of ``values``."""
    weight = _weight(basis, values)
    total = 0.0
    for k in range(len(basis)):
        rest = values[k] - weight * basis[k]
        total += rest * rest
    return total


@njit
def _residual_of_ramp(time, values):
    """Sum of squares that a straight line leaves."""
    mean_time = mean = 0.0
    for k in range(len(time)):
        mean_time += time[k] / len(time)
        mean += values[k] / len(time)
    return _residual(time - mean_time, values - mean)
