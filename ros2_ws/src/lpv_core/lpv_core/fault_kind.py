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
_TELLING = 30.0
"""Drifts and scale errors show in a change of so many standard deviations of a reading: the error
of a healthy estimate changes, too."""
_EXPLAINED = 0.1
"""Part of the change that a scale error may leave unexplained."""
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
    return _course(time, values, baseline, position_noise)


@njit
def fits_better(kind, than, values, baseline):
    """Whether one course of a fault is to replace another one that was named before.

    Parameters
    ----------
    kind, than : int
        ``BIAS``, ``DRIFT`` or ``SCALE``; what `classify` says now, and what was said.
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ [rad].
    baseline : float
        f^ before the onset [rad].

    Returns
    -------
    bool
        A scale error shows late, in motion; it does not turn into a bias by standing still.
    """
    if kind == SCALE:
        return True
    if kind != BIAS or than != SCALE:
        return False
    fault = values[:, FAULT] - baseline
    return _CLEARLY * _residual(np.ones(len(fault)), fault) < _residual(values[:, EXPECTED], fault)


@njit
def _course(time, values, baseline, position_noise):
    """Bias, drift or scale: the model that leaves the smallest residual, simplest first."""
    fault, expected = values[:, FAULT] - baseline, values[:, EXPECTED]
    floor = len(time) * position_noise**2
    bias = _residual(np.ones(len(time)), fault)
    drift, scale = _residual(time, fault), _residual(expected, fault)
    if (shows_scale(values, baseline, position_noise) and scale < _EXPLAINED * bias
            and scale < drift):
        return SCALE
    best, left = BIAS, bias
    if drift < left and bias >= drift + 2.0 * floor:
        best, left = DRIFT, drift
    middle = time - _mean(time, 0, len(time))
    growth = _weight(middle, fault) * (time[-1] - time[0])
    if abs(growth) > _TELLING * position_noise and left > 4.0 * (
            _residual(middle, fault - _mean(fault, 0, len(fault))) + floor):
        # Neither fits alone, a ramp from an offset does: it grows, whatever it started from.
        return DRIFT
    return best


@njit
def shows_scale(values, baseline, position_noise):
    """Whether the arm has moved so far that a scale error would have shown itself.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ since the onset [rad].
    baseline : float
        f^ before the onset [rad].
    position_noise : float
        Standard deviation of a healthy reading [rad].

    Returns
    -------
    bool
        Also where the fault is no scale error.
    """
    scale = _weight(values[:, EXPECTED], values[:, FAULT] - baseline)
    return abs(scale) * span(values, EXPECTED, 0) > _TELLING * position_noise


@njit
def _mean(values, first, last):
    # In one fixed order of additions, which NumPy's own does not promise.
    total = 0.0
    for k in range(first, last):
        total += values[k]
    return total / (last - first)


@njit
def step_of(stamps, values, row):
    """Height of a step: two levels with one common slope, by least squares.

    The slope is that of the healthy estimate's error, which goes on beside the fault.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        Samples before and after the step [ns].
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ [rad].
    row : int
        First sample after the step, with some on either side.

    Returns
    -------
    float
        [rad].
    """
    time, fault = (stamps - stamps[row]) / 1e9, values[:, FAULT]
    square = cross = height = middle = 0.0
    for first, last, sign in ((0, row, -1.0), (row, len(time), 1.0)):
        mean_time, mean = _mean(time, first, last), _mean(fault, first, last)
        for k in range(first, last):
            square += (time[k] - mean_time) * (time[k] - mean_time)
            cross += (time[k] - mean_time) * (fault[k] - mean)
        height += sign * mean
        middle += sign * mean_time
    return height - middle * cross / square


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
